"""Frames to a file: MP4 (H.264) through PyAV, GIF and animated WebP through Pillow."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

from PIL import Image

from skysweep.arrays import U8
from skysweep.errors import MissingExtraError, UserError

SUFFIXES = (".mp4", ".gif", ".webp")

_COLOURS = "colorprim=bt709:transfer=iec61966-2-1:colormatrix=smpte170m"  # sRGB, converted as in BT.601
_QUALITY = {"crf": "24", "preset": "veryfast", "x264-params": _COLOURS}
_WEBP_QUALITY = 55


def refuse_unwritable(path: Path) -> None:
    """Raises UserError for another suffix, MissingExtraError for an MP4 without PyAV."""
    if path.suffix not in SUFFIXES:
        raise UserError(f"--out {path}: is no video file; end it with {', '.join(SUFFIXES)}")
    if path.suffix == ".mp4":
        _av()


def encode(frames: Iterable[U8], path: Path, fps: int, width_px: int, height_px: int) -> None:
    """Write frames (H, W, 3) RGB in the format of the path's suffix."""
    if path.suffix == ".mp4":
        _encode_mp4(frames, path, fps, width_px, height_px)
        return
    images: Iterator[Image.Image] = (Image.fromarray(frame) for frame in frames)
    first = next(images)
    if path.suffix == ".gif":
        palette = first.quantize(255)
        images = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
        first = first.quantize(palette=palette, dither=Image.Dither.NONE)
    how: dict[str, Any] = {} if path.suffix == ".gif" else {"quality": _WEBP_QUALITY, "method": 4}
    first.save(path, save_all=True, append_images=images, duration=round(1000 / fps), loop=0, **how)


def _encode_mp4(frames: Iterable[U8], path: Path, fps: int, width_px: int, height_px: int) -> None:
    """As browsers play it: 4:2:0, the index in front."""
    av = _av()
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=Fraction(fps), options=_QUALITY)
        stream.width, stream.height, stream.pix_fmt = width_px, height_px, "yuv420p"
        for image in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def _av() -> Any:
    try:
        import av
    except ImportError:
        raise MissingExtraError("An MP4", "video") from None
    return av
