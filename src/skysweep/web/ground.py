"""The ground from above, as the renderer of a scenario draws it: the map's picture."""

from __future__ import annotations

import hashlib
import json
import math
from contextlib import suppress
from dataclasses import replace

import cv2
import numpy as np

from skysweep import __version__
from skysweep.arrays import U8
from skysweep.caching import cache_folder
from skysweep.files.writing import replace_file
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import Scenario
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.world import build_world

_LONG_SIDE_PX = 2048
_FINEST_M = 0.08  # a pixel
_TILE_M = 150.0  # a renderer's shadows reach about this far
_MOST_TILES = 16  # a side
_FROM_ABOVE = 8.0  # widths of a tile: trees hardly lean
_QUALITY = 85
_CLEAR_AIR_M = 1e7
_SHOWN = ("terrain", "trees", "forests", "buildings", "light", "area", "home")  # of a scenario


def ground_picture(scenario: Scenario, seed: int) -> bytes:
    """A JPEG of the scene's bounds, north up, without targets and other small things; cached.

    Raises UserError if no renderer runs here.
    """
    told = scenario.model_dump_json(include=set(_SHOWN))
    name = hashlib.sha256(json.dumps([told, seed, __version__]).encode()).hexdigest()[:32]
    path = cache_folder() / "ground" / f"{name}.jpg"
    with suppress(OSError):
        return path.read_bytes()
    _, jpeg = cv2.imencode(".jpg", _draw(scenario, seed)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    picture = jpeg.tobytes()
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, picture)
    return picture


def _draw(scenario: Scenario, seed: int) -> U8:
    """The picture (H, W, 3) RGB, in tiles each seen from straight above."""
    clear = scenario.light.model_copy(update={"visibility_m": _CLEAR_AIR_M})
    world = replace(build_world(scenario, seed), objects=(), light=clear)
    west, south, east, north = world.terrain.bounds_enu_m
    width_m, height_m = east - west, north - south
    pixel_m = max(max(width_m, height_m) / _LONG_SIDE_PX, _FINEST_M)
    tile_m = max(_TILE_M, max(width_m, height_m) / _MOST_TILES)
    size_px = max(1, round(width_m / pixel_m)), max(1, round(height_m / pixel_m))
    tile_px = math.ceil(tile_m / pixel_m)
    above_m = _FROM_ABOVE * tile_m
    lens = Lens(tile_px, tile_px, 2.0 * math.atan(tile_px * pixel_m / 2.0 / above_m))
    looks_down = rotation_camera_to_enu(math.pi / 2, -math.pi / 2)
    picture = np.zeros((size_px[1] + tile_px, size_px[0] + tile_px, 3), np.uint8)
    renderer = make_renderer(world)
    try:
        for top in range(0, size_px[1], tile_px):
            for left in range(0, size_px[0], tile_px):
                x, y = west + (left + tile_px / 2) * pixel_m, north - (top + tile_px / 2) * pixel_m
                z = world.terrain.height_at_m(x, y) + above_m
                pose = CameraPose(np.array([x, y, z]), looks_down)
                picture[top : top + tile_px, left : left + tile_px] = renderer.render(lens, pose)
    finally:
        renderer.close()
    return picture[: size_px[1], : size_px[0]]
