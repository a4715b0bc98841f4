"""How the cost of plans and missions grows with the area: ``skysweep bench --scale``.

One kind of place at four sizes: hills from an elevation model with a post every 10 m, 20 trees on a hectare,
persons and rocks, a 4K camera. Every measurement has a process of its own, so that its memory is its own.
"""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Callable
from contextlib import closing
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import shapely

from skysweep.errors import MissingExtraError
from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_in_memory
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import SEARCHING

HECTARES = (2, 20, 200, 2000)
PARTS = ("plan", "statistical", "rendered")
_POST_M, _HILLS_M, _WAVELENGTHS_M = 10.0, 60.0, (700.0, 310.0)
_MARGIN_M = 200.0  # of elevations around the area
_UTM = "EPSG:32634"  # the zone of the default home
_LOOKS_HZ, _SCAN_MPS = 0.5, 7.5
_WARM_UP_LOOKS = 3


def scale(
    hectares: tuple[float, ...] = HECTARES,
    report: Callable[[str], None] = lambda doing: None,
    looks: int = 10,
) -> dict[str, Any]:
    """Measure each part at each size, in seconds and megabytes.

    ``rows`` has one mapping for each size: ``planned_km`` and ``plan_s``; ``flown_km`` and ``statistical_s``
    of a whole mission; ``rendered_look_s``, the mean of a look with a picture and all around it, in
    ``looks`` of the scan, ``rendered_ready_s``, the time from the scenario to the first of them, and
    ``rendered_s``, that with all looks of the scan taking so long; ``..._mb``, the peak memory of each.
    ``slopes`` are those of the logarithm of the time over that of the path. Raises MissingExtraError without
    the extra ``geo``.
    """
    rows = []
    for size in hectares:
        row: dict[str, Any] = {"hectares": size}
        for part in PARTS:
            report(f"{part}, {size} ha")
            with multiprocessing.get_context("spawn").Pool(1) as own:
                row |= own.apply(_measure, (part, size, looks))
        scan_looks = row["planned_km"] * 1000.0 / _SCAN_MPS * _LOOKS_HZ
        row["rendered_s"] = float(f"{row['rendered_ready_s'] + scan_looks * row['rendered_look_s']:.4g}")
        rows.append(row)
    planned_km = [row["planned_km"] for row in rows]
    slopes = {
        "plan": _slope(planned_km, [row["plan_s"] for row in rows]),
        "statistical": _slope([row["flown_km"] for row in rows], [row["statistical_s"] for row in rows]),
        "rendered": _slope(planned_km, [row["rendered_s"] for row in rows]),
    }
    return {"rows": rows, "slopes": slopes}


def place(hectares: float, folder: Path) -> Scenario:
    """The scenario of that size, twice as long as wide; its elevation model is written to ``folder``."""
    width_m = math.sqrt(hectares * 1e4 / 2.0)
    area = [[0.0, 0.0], [2.0 * width_m, 0.0], [2.0 * width_m, width_m], [0.0, width_m]]
    scenario = Scenario.model_validate(
        {
            "name": f"{hectares:g} ha",
            "area": {"polygon_enu_m": area},
            "home": {"position_enu_m": [-20.0, -20.0]},
            "forests": [{"trees_per_hectare": 20.0}],
            "generators": [
                {"class": "person", "pattern": "uniform", "count": max(1, round(0.03 * hectares))},
                {"class": "rock", "pattern": "uniform", "count": max(1, round(0.5 * hectares))},
            ],
            "camera": {"width_px": 3840, "height_px": 2160, "hfov_rad": 1.2, "rate_hz": 2.0},
            "detector": {"rate_hz": _LOOKS_HZ},
            "vehicle": {"cruise_speed_mps": 10.0, "battery_wh": 400.0, "batteries": 100},
            "search": {
                "n_c": 3,
                "scan_altitude_agl_m": 60.0,
                "check_altitude_agl_m": 20.0,
                "scan_speed_mps": _SCAN_MPS,
                "check_speed_mps": 4.0,
            },
        }
    )
    dem = _write_elevations(scenario, folder / "elevations.tif")
    data = scenario.model_dump(by_alias=True)
    data["terrain"]["dem"] = str(dem)
    return Scenario.model_validate(data)


def _write_elevations(scenario: Scenario, path: Path) -> Path:
    try:
        import rasterio
        from rasterio.warp import transform
    except ImportError:
        raise MissingExtraError("bench --scale", "geo") from None
    home = scenario.home
    (east_m,), (north_m,) = transform("EPSG:4326", _UTM, [home.longitude_deg], [home.latitude_deg])
    west, south, east, north = scenario.area_enu_m.union(shapely.Point(home.position_enu_m)).bounds
    x = np.arange(west - _MARGIN_M, east + _MARGIN_M, _POST_M)
    y = np.arange(north + _MARGIN_M, south - _MARGIN_M, -_POST_M)
    height_m = np.full((len(y), len(x)), _HILLS_M / 2.0 + home.altitude_amsl_m)
    for k, wavelength_m in enumerate(_WAVELENGTHS_M):
        waves = np.sin(2.0 * np.pi * x / wavelength_m + k) * np.sin(2.0 * np.pi * y[:, None] / wavelength_m)
        height_m += _HILLS_M / 4.0 * waves
    where = rasterio.Affine(_POST_M, 0.0, east_m + x[0], 0.0, -_POST_M, north_m + y[0])
    fields = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": _UTM, "transform": where}
    with rasterio.open(path, "w", width=len(x), height=len(y), compress="deflate", **fields) as file:
        file.write(height_m.astype(np.float32), 1)
    return path


def _measure(part: str, hectares: float, looks: int) -> dict[str, float]:
    with TemporaryDirectory(prefix="skysweep-") as name:
        if part != "rendered":  # its looks warm up themselves
            _of_part(part, place(min(HECTARES), Path(name)), looks)  # loads and compiles
        scenario = place(hectares, Path(name))
        started = time.perf_counter()
        found = _of_part(part, scenario, looks)
        if part != "rendered":
            found[f"{part}_s"] = time.perf_counter() - started
    status = Path("/proc/self/status").read_text("utf-8")
    found[f"{part}_mb"] = int(status.split("VmHWM:")[1].split()[0]) / 1024.0
    return {key: float(f"{value:.4g}") for key, value in found.items()}


def _of_part(part: str, scenario: Scenario, looks: int) -> dict[str, float]:
    if part == "plan":
        return {"planned_km": plan_scenario(scenario)[0].length_m / 1000.0}
    if part == "statistical":
        return {"flown_km": fly_in_memory(scenario, 0)["path_length_m"] / 1000.0}
    return _looks_s(scenario, looks)


def _looks_s(scenario: Scenario, count: int) -> dict[str, float]:
    """Wall seconds until the first look of the scan, and of a look: picture, detector, all until the next."""
    begun = time.perf_counter()
    mission = build_mission(scenario, 0, Rig("imaging", threads=2))
    with closing(mission.sensor), Flight(mission, MemoryJournal()) as flight:
        looks = (tick for tick in flight if tick.mode in SEARCHING and tick.detections is not None)
        next(looks)
        ready_s = time.perf_counter() - begun
        for _ in islice(looks, _WARM_UP_LOOKS):
            pass
        started = time.perf_counter()
        for _ in islice(looks, count):
            pass
        look_s = (time.perf_counter() - started) / count
        return {"rendered_ready_s": ready_s, "rendered_look_s": look_s}


def _slope(path_km: list[float], seconds: list[float]) -> float:
    return float(f"{np.polyfit(np.log(path_km), np.log(seconds), 1)[0]:.3g}")
