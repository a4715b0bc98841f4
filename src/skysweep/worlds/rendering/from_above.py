"""The ground seen from above: the picture under maps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from skysweep.arrays import U8
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.worlds.rendering.renderer import Backend, make_renderer
from skysweep.worlds.world import World

_TILES_M = 150.0, 1000.0  # a side, as shadows reach: of a small map and of one larger than _SMALL_M
_SMALL_M = 600.0
_FROM_ABOVE = 8.0  # widths of a tile: trees hardly lean
_HIGHEST_M = 5000.0
_CLEAR_AIR_M = 1e7


def ground_from_above(
    world: World,
    bounds_enu_m: tuple[float, float, float, float],
    size_px: tuple[int, int],
    renderer: Backend = "auto",
) -> U8:
    """The ground between west, south, east and north (H, W, 3) RGB, north up, through clear air.

    Targets and other small things are left out. ``size_px`` is width and height. Raises UserError if the
    renderer cannot run here.
    """
    west, south, east, north = bounds_enu_m
    width_px, height_px = size_px
    bare = replace(world, objects=(), light=world.light.model_copy(update={"visibility_m": _CLEAR_AIR_M}))
    pixel_m = (east - west) / width_px
    tile_px = math.ceil(_TILES_M[max(east - west, north - south) > _SMALL_M] / pixel_m)
    tile_px = min(tile_px, max(size_px))
    above_m = min(_FROM_ABOVE * tile_px * pixel_m, _HIGHEST_M)
    lens = Lens(tile_px, tile_px, 2.0 * math.atan(tile_px * pixel_m / 2.0 / above_m))
    looks_down = rotation_camera_to_enu(math.pi / 2, -math.pi / 2)
    picture = np.zeros((height_px, width_px, 3), np.uint8)
    painter = make_renderer(bare, renderer)
    try:
        for top in range(0, height_px, tile_px):
            for left in range(0, width_px, tile_px):
                x, y = west + (left + tile_px / 2) * pixel_m, north - (top + tile_px / 2) * pixel_m
                place = np.array([x, y, world.terrain.height_at_m(x, y) + above_m])
                tile = painter.render(lens, CameraPose(place, looks_down))
                part = picture[top : top + tile_px, left : left + tile_px]
                part[:] = tile[: part.shape[0], : part.shape[1]]
    finally:
        painter.close()
    return picture
