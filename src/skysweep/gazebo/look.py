"""Converts our light to Gazebo, whose shading is linear and has no film response.

Our renderer shows albedo ``a`` in light ``L`` as ``film(a^2 L)``. Gazebo shows ``texture * tint * (ambient +
diffuse * cos)``. So textures and tints are exported as they look on level ground in the sun, where Gazebo's
light is set to 1; the ambient light is the share that level ground in the shade keeps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from skysweep.types import F64, U8
from skysweep.worlds.rendering.gl import film
from skysweep.worlds.scene import Sun
from skysweep.worlds.textures import DETAIL_M, GroundTextures

TILE_M = 20.0  # of a ground texture that holds every scale
TILE_PX = 2048
WATER_TILE_M = 47.0  # the longest of the waves that the water is made of


@dataclass(frozen=True, slots=True)
class GazeboLook:
    """Gazebo's light, and the film response that goes into its textures."""

    level_rgb: F64  # (3,) our light on level ground in the sun
    ambient_rgb: F64  # (3,) Gazebo's
    diffuse_rgb: F64  # (3,) of Gazebo's sun
    sky_rgb: F64  # (3,) background

    @classmethod
    def of(cls, sun: Sun) -> GazeboLook:
        level = sun.sky_rgb + sun.sun_rgb * sun.direction_enu[2]
        ambient = np.sqrt(sun.sky_rgb / level)
        return cls(level, ambient, (1.0 - ambient) / sun.direction_enu[2], film(sun.haze_rgb))

    def shown(self, albedo: ArrayLike) -> F64:
        """Colours (..., 3) in 0..1 of albedos (..., 3) on level ground in the sun."""
        a = np.asarray(albedo, dtype=float)
        return np.minimum(film(a * a * self.level_rgb), 1.0)

    def texture(self, image: U8) -> U8:
        """A texture (H, W, 3) as it looks on level ground in the sun."""
        return _bytes(self.shown(image / 255.0))

    def tint(self, colour: ArrayLike, image: U8) -> F64:
        """The colour (..., 3) to multiply ``texture(image)`` with; exact for its mean tone."""
        mean = np.maximum(image.reshape(-1, 3).mean(axis=0) / 255.0, 1e-3)
        return np.clip(self.shown(np.asarray(colour) * mean) / self.shown(mean), 0.0, 1.0)


def ground_tile(textures: GroundTextures, look: GazeboLook) -> U8:
    """One texture over ``TILE_M`` with the detail and the middle scale of the ground."""
    detail = _repeated(textures.detail, round(TILE_M / DETAIL_M)) / 255.0
    return _bytes(look.shown(detail * _repeated(textures.middle, 1) / 127.5))


def water_tile(textures: GroundTextures, sun: Sun) -> U8:
    """Still water from above over ``WATER_TILE_M``: three waves, tint, the sky's reflection and foam."""
    waves = [_repeated(textures.detail, count) / 255.0 for count in (16, 4, 1)]
    strengths = (0.32, 0.42, 0.40)
    slope = np.sum([(w[..., :2] - 0.5) * s for w, s in zip(waves, strengths, strict=True)], axis=0)
    crest = (waves[1] + waves[2])[..., 2:]
    normal = np.concatenate([-slope, np.ones_like(crest)], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    tint = _repeated(textures.macro, 1) / 127.5
    lit = np.maximum(normal @ sun.direction_enu, 0.0)[..., None]
    body = np.array([0.012, 0.052, 0.062]) * tint**2 * (0.6 + 0.7 * crest)
    body = body * (1.6 * sun.sky_rgb + sun.sun_rgb * (0.35 + 0.65 * lit))
    fresnel = 0.02 + 0.98 * (1.0 - normal[..., 2:]) ** 5
    rgb = body * (1.0 - fresnel) + sun.sky_rgb * np.array([0.45, 0.62, 0.9]) * fresnel
    foam = _repeated(textures.middle, 2)[..., :1] / 255.0 * np.clip((crest - 1.0) / 0.3, 0.0, 1.0)
    rgb = rgb * (1.0 - foam) + 0.75 * (sun.sky_rgb + 0.7 * sun.sun_rgb) * foam
    return _bytes(film(rgb))


def _repeated(image: U8, count: int) -> F64:
    """``count`` x ``count`` copies of a texture in TILE_PX pixels."""
    n = TILE_PX // count
    how = cv2.INTER_AREA if n < len(image) else cv2.INTER_CUBIC
    return np.tile(cv2.resize(image, (n, n), interpolation=how), (count, count, 1)).astype(float)


def _bytes(colours: F64) -> U8:
    return np.asarray(np.clip(colours * 255.0, 0, 255).round(), dtype=np.uint8)
