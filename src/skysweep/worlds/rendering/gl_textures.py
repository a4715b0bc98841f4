"""Textures of the OpenGL renderer, with mipmaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import cv2
import moderngl
import numpy as np

from skysweep.arrays import U8


def filtered(gl: moderngl.Context, image: U8) -> moderngl.Texture:
    """A picture (H, W, 3) or (H, W, 4) that repeats."""
    return _mipmapped(gl.texture(image.shape[1::-1], 4, _rgba(image).tobytes()))


def filtered_array(gl: moderngl.Context, images: Sequence[U8]) -> moderngl.TextureArray:
    """Pictures (H, W, 3) of one size that repeat, as layers."""
    size = (*images[0].shape[1::-1], len(images))
    return _mipmapped(gl.texture_array(size, 4, np.stack([_rgba(i) for i in images]).tobytes()))


_Any = TypeVar("_Any", moderngl.Texture, moderngl.TextureArray)


def _mipmapped(texture: _Any) -> _Any:
    texture.build_mipmaps()
    texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    return texture


def _rgba(image: U8) -> U8:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2RGBA)) if image.shape[2] == 3 else image
