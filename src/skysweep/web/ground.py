"""The ground from above, as the renderer of a scenario draws it: the map's picture."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress

import cv2

from skysweep import __version__
from skysweep.arrays import U8
from skysweep.caching import cache_folder
from skysweep.files.writing import replace_file
from skysweep.scenarios.model import Scenario
from skysweep.worlds.ground_files import ground_digest
from skysweep.worlds.rendering.from_above import ground_from_above
from skysweep.worlds.world import build_world

_LONG_SIDE_PX = 2048
_FINEST_M = 0.08  # a pixel
_QUALITY = 85
_SHOWN = ("terrain", "trees", "forests", "buildings", "light", "area", "home")  # of a scenario


def ground_picture(scenario: Scenario, seed: int) -> bytes:
    """A JPEG of the scene's bounds, north up, without targets and other small things; cached.

    Raises UserError if no renderer runs here.
    """
    told = scenario.model_dump_json(include=set(_SHOWN))
    name = hashlib.sha256(
        json.dumps([told, ground_digest(scenario), seed, __version__]).encode()
    ).hexdigest()[:32]
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
    """The picture (H, W, 3) RGB."""
    world = build_world(scenario, seed)
    west, south, east, north = bounds = world.terrain.bounds_enu_m
    pixel_m = max(max(east - west, north - south) / _LONG_SIDE_PX, _FINEST_M)
    size_px = max(1, round((east - west) / pixel_m)), max(1, round((north - south) / pixel_m))
    return ground_from_above(world, bounds, size_px)
