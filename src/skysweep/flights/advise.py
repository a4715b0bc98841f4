"""From how high, how fast and with how much overlap to scan: flights compared before any is flown.

The expected probability of detection (POD) is that of the target that is hardest to see, at a random place
of flat, open ground between two transects: of the better of the passes beside it, as what one pass misses the
next one misses more often than by chance. It is from the calibrated sensor
(``sensing/statistical/sweep_width.py``). Trees, slopes and light take from it; time and batteries are those
of the plan over the scenario's terrain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from skysweep.errors import UserError
from skysweep.planning.advice import WISHED_AT_SCAN_PX
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import KindModel, model_for
from skysweep.sensing.statistical.sweep_width import lateral_range

_PIXELS = (10.0, 14.0, 20.0, 28.0, 40.0, 56.0, 80.0)  # on the smallest target, of the altitudes tried
_SPEED_SHARES = (0.4, 0.7, 1.0)  # tried, of the speed that is kept against the wind
_SLOWEST_MPS = 0.5
_SIDELAPS = (0.1, 0.3, 0.5)
_LOWEST_M = 10.0
_ACROSS = 40  # places between two transects


@dataclass(frozen=True, slots=True)
class Option:
    """One way to scan the area."""

    altitude_agl_m: float
    speed_mps: float
    sidelap: float
    pixels_on_target: float
    pod: float | None  # None where the sensor is not calibrated for this camera and detector
    time_s: float | None  # None where it cannot be flown
    batteries: int | None
    path_length_m: float | None
    why_not: str = ""

    @property
    def search_fields(self) -> dict[str, float]:
        """The fields of the scenario's ``search`` that make it."""
        return {
            "scan_altitude_agl_m": self.altitude_agl_m,
            "scan_speed_mps": self.speed_mps,
            "sidelap": self.sidelap,
        }


@dataclass(frozen=True, slots=True)
class Advice:
    """All options, highest and slowest first, and the best one."""

    options: tuple[Option, ...]
    best: Option | None
    why: str
    uncalibrated: str  # why no POD is known; empty if it is


def advise(
    scenario: Scenario, wanted_pod: float, on_step: Callable[[int, int], None] = lambda done, of: None
) -> Advice:
    """Compare flights over the scenario's area; the best is the shortest that is expected to find enough.

    ``wanted_pod`` is 0..1. Without a calibrated sensor, enough pixels count instead.
    """
    try:
        kinds = _hardest_kinds(scenario)
        uncalibrated = ""
    except UserError as error:
        kinds, uncalibrated = [], str(error)
    settings = list(_settings(scenario))
    options = []
    for done, (altitude_m, speed_mps) in enumerate(settings):
        options.append(_option(scenario, kinds, altitude_m, speed_mps, wanted_pod))
        on_step(done + 1, len(settings))
    best, why = _best(options, wanted_pod)
    return Advice(tuple(options), best, why, uncalibrated)


def expected_pod(
    scenario: Scenario, kinds: list[tuple[KindModel, float]], altitude_agl_m: float, spacing_m: float
) -> float:
    """Of one coverage with transects ``spacing_m`` apart, for the hardest of some kinds and their sizes."""
    between_m = spacing_m * (np.arange(_ACROSS) + 0.5) / _ACROSS / 2.0  # from a transect to the middle
    half_m = scenario.camera.lens.footprint_m(altitude_agl_m)[0] / 2.0
    in_picture = between_m <= half_m
    pods = []
    for kind, size_m in kinds:
        found = np.zeros(_ACROSS)
        found[in_picture] = lateral_range(scenario, kind, size_m, altitude_agl_m, between_m[in_picture])
        pods.append(float(found.mean()))
    return min(pods)


def _hardest_kinds(scenario: Scenario) -> list[tuple[KindModel, float]]:
    """Kinds of the sensor model that are searched for, each with its smallest size."""
    return [
        (kind, low_m)
        for name, (low_m, _) in scenario.target_sizes_m.items()
        for kind in model_for(scenario, "compare by pixels alone").kinds
        if kind.kind == kind.reported_as == name and kind.pose in scenario.target_poses[name]
    ]


def _settings(scenario: Scenario) -> Iterator[tuple[float, float]]:
    """Altitudes and speeds to try, the scenario's own among them."""
    search, safety = scenario.search, scenario.safety
    pixel_metres = scenario.pixels_on_target(1.0)
    lowest_m = max(_LOWEST_M, search.check_altitude_agl_m + 1.0)
    heights = {float(round(pixel_metres / pixels)) for pixels in _PIXELS}
    heights = {h for h in heights if lowest_m <= h <= safety.altitude_max_agl_m}
    if pixel_metres / safety.altitude_max_agl_m > _PIXELS[0]:
        heights.add(safety.altitude_max_agl_m)
    cruise_mps = scenario.vehicle.cruise_speed_mps
    held_mps = max(safety.air_speed_max_mps - scenario.wind.mean_speed_mps, _SLOWEST_MPS)
    fastest_mps = round(min(cruise_mps, held_mps), 1)  # against the wind
    speeds = {round(share * fastest_mps, 1) for share in _SPEED_SHARES}
    speeds.add(min(search.scan_speed_mps, fastest_mps))
    for height_m in sorted(heights | {search.scan_altitude_agl_m}, reverse=True):
        for speed_mps in sorted(speeds):
            yield height_m, speed_mps


def _option(
    scenario: Scenario,
    kinds: list[tuple[KindModel, float]],
    altitude_m: float,
    speed_mps: float,
    wanted_pod: float,
) -> Option:
    pod, sidelap = None, scenario.search.sidelap
    if kinds:
        swath_m = scenario.camera.lens.footprint_m(altitude_m)[0]
        at_speed = scenario.with_search(scan_speed_mps=speed_mps)
        for sidelap in _SIDELAPS:
            pod = expected_pod(at_speed, kinds, altitude_m, swath_m * (1.0 - sidelap))
            if pod >= wanted_pod:
                break
    pixels = scenario.pixels_on_target(altitude_m)
    option = Option(altitude_m, speed_mps, sidelap, pixels, pod, None, None, None)
    try:
        _, cost = plan_scenario(scenario.with_search(**option.search_fields, plan=None))
    except UserError as error:
        return Option(altitude_m, speed_mps, sidelap, pixels, pod, None, None, None, str(error))
    return Option(
        altitude_m, speed_mps, sidelap, pixels, pod, cost.time_s, cost.batteries, cost.path_length_m
    )


def _best(options: list[Option], wanted_pod: float) -> tuple[Option | None, str]:
    flyable = [o for o in options if o.time_s is not None]
    if not flyable:
        return None, options[0].why_not

    def shortest(among: list[Option]) -> Option:
        return min(among, key=lambda o: (o.time_s or 0.0, -(o.pod or 0.0)))

    if all(o.pod is None for o in flyable):
        enough = [o for o in flyable if o.pixels_on_target >= WISHED_AT_SCAN_PX]
        if enough:
            return shortest(
                enough
            ), f"the shortest flight with {WISHED_AT_SCAN_PX:g} pixels on the smallest target"
        most = max(flyable, key=lambda o: (o.pixels_on_target, -(o.time_s or 0.0)))
        return most, "most pixels on the smallest target; too few for a detector to rely on"
    enough = [o for o in flyable if (o.pod or 0.0) >= wanted_pod]
    if enough:
        return shortest(
            enough
        ), f"the shortest flight that is expected to find {wanted_pod:.0%} of the targets"
    most = max(flyable, key=lambda o: (o.pod or 0.0, -(o.time_s or 0.0)))
    return most, f"no flight is expected to find {wanted_pod:.0%} of the targets; this one finds most"
