"""What a mission costs as its area grows: one kind of valley, from a field to a massif."""

from __future__ import annotations

import math
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.scenarios.model import MAX_TREES, Scenario

HECTARES = (2, 20, 200, 2000)
LOOKS = 20
THREADS = 2
_WARM_UP = 5  # looks
_MARGIN_M = 100.0  # around the area, where trees stand too
_TREES, _ROCKS, _CLOTHES = 60.0, 1.6, 0.05  # a hectare
_MOST_ROCKS = 2000  # that a generator takes


def valley(hectares: float) -> Scenario:
    """A square of wooded hills with six persons, searched by a 4K camera from 60 m."""
    side_m = 100.0 * math.sqrt(hectares)
    wooded_ha = (side_m + _MARGIN_M) ** 2 / 1e4
    rocks = min(max(1, round(_ROCKS * hectares)), _MOST_ROCKS)
    stones = {"class": "rock", "count": rocks, "size_m": 0.8, "seed": 5}
    clothes = {"class": "clothing", "count": max(1, round(_CLOTHES * hectares)), "seed": 8}
    persons = {"class": "person", "count": 6, "poses": ["lying", "standing"]}
    return Scenario.model_validate(
        {
            "name": f"valley-{hectares:g}-ha",
            "area": {"polygon_enu_m": [[0, 0], [side_m, 0], [side_m, side_m], [0, side_m]]},
            "home": {"position_enu_m": [-20, -20]},
            "terrain": {
                "surface": "forest floor",
                "hills_height_m": 80,
                "hills_wavelength_m": 700,
                "seed": 3,
            },
            "forests": [
                {
                    "trees_per_hectare": min(_TREES, 0.9 * MAX_TREES / wooded_ha),
                    "height_m": [6, 18],
                    "crown_radius_m": [1.2, 3.0],
                    "conifer_fraction": 0.6,
                    "seed": 1,
                }
            ],
            "generators": [{**g, "pattern": "uniform"} for g in (persons, stones, clothes)],
            "camera": {"width_px": 3840, "height_px": 2160, "hfov_rad": 1.2, "rate_hz": 2},
            "vehicle": {"cruise_speed_mps": 10, "battery_wh": 400, "batteries": 20},
            "detector": {"rate_hz": 1},
            "search": {
                "scan_altitude_agl_m": 60,
                "check_altitude_agl_m": 20,
                "scan_speed_mps": 10,
                "check_speed_mps": 4,
            },
        }
    )


def rendered(hectares: float) -> dict[str, float]:
    """The cost of a mission with pictures of an area: set-up, then ``LOOKS`` looks, in a process of its own.

    ``setup_s`` is processor time until take-off, ``look_s`` that of one look with the flight in between, on
    all cores together; ``rtf`` simulated seconds a wall second; ``memory_mb`` the peak of the process.
    """
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_rendered_here, hectares).result()


def _rendered_here(hectares: float) -> dict[str, float]:
    mission = build_mission(valley(hectares), 0, Rig("imaging", threads=THREADS))
    with closing(mission.sensor), Flight(mission, MemoryJournal()) as flight:
        setup_s = time.process_time()
        looks, newest, flown_s, wall_s, used_s = 0, None, 0.0, 0.0, 0.0
        for _ in flight:
            look: Any = mission.pictures.last_look if mission.pictures else None
            if look is newest:
                continue
            looks, newest = looks + 1, look
            if looks == _WARM_UP:
                flown_s, wall_s, used_s = (
                    mission.vehicle.state().time_s,
                    time.perf_counter(),
                    time.process_time(),
                )
            if looks == _WARM_UP + LOOKS:
                break
        flown_s, wall_s = mission.vehicle.state().time_s - flown_s, time.perf_counter() - wall_s
        used_s = time.process_time() - used_s
    return {
        "hectares": hectares,
        "setup_s": setup_s,
        "look_s": used_s / LOOKS,
        "rtf": flown_s / wall_s,
        "memory_mb": _peak_mb(),
    }


def _peak_mb() -> float:
    """The largest memory of this process so far."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024.0
