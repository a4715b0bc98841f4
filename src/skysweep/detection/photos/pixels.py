"""The pixels of a picture's file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from skysweep.errors import UserError
from skysweep.types import U8


def read_picture(path: Path, *, upright: bool = True) -> U8:
    """A picture (H, W, 3) RGB, turned as its file says, or as the sensor saw it.

    Raises UserError if the file is missing, no picture or damaged, or its pixels are no bytes.
    """
    if not path.is_file():
        raise UserError(f"{path}: there is no such picture; check the path")
    try:
        picture = Image.open(path)
    except Exception as error:  # Pillow raises whatever its readers do on damaged files
        raise UserError(f"{path}: not a readable picture") from error
    with picture:
        if picture.mode.startswith(("I", "F")):
            raise UserError(f"{path}: has more than 8 bits a channel; save it as JPEG or 8-bit PNG")
        try:
            turned = ImageOps.exif_transpose(picture) if upright else picture
            return np.array(turned.convert("RGB"))
        except Exception as error:  # as above; a part of it is missing, say
            raise UserError(f"{path}: is damaged") from error
