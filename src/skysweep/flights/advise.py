"""From how high, how fast and with how much overlap to scan: flights compared before any is flown.

The expected probability of detection (POD) is that of the target that is hardest to see, at a random place
between two transects, on ground that is level and open but covered as the area is: of the better of the
passes beside it, as what one pass misses the next one misses more often than by chance. It is from the
calibrated sensor (``sensing/statistical/sweep_width.py``). Trees, slopes and light take from it; time and
batteries are those of the plan over the scenario's terrain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from skysweep.errors import UserError
from skysweep.planning.advice import WISHED_AT_SCAN_PX
from skysweep.planning.flight_plan import plan_scenario
from skysweep.scenarios.files import NULL, change_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import KindModel, model_for
from skysweep.sensing.statistical.sweep_width import lateral_range, refuse_tilted
from skysweep.strategies import strategy_spec
from skysweep.worlds.world import surfaces_of

_PIXELS = (10.0, 14.0, 20.0, 28.0, 40.0, 56.0, 80.0)  # on the smallest target, of the altitudes tried
_SPEED_SHARES = (0.4, 0.7, 1.0)  # tried, of the speed that is kept against the wind
_SLOWEST_MPS = 0.5  # against the wind
_LEAST_MPS = 0.1  # that a scenario may have
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

    ``wanted_pod`` is 0..1. Without a calibrated sensor, or with a tilted camera, enough pixels count instead.
    Raises UserError where the strategy covers the area from another height than that of the scan.
    """
    search = scenario.search
    covers_from_m = strategy_spec(search.strategy).cover_altitude_of(scenario)
    if covers_from_m != search.scan_altitude_agl_m:
        raise UserError(
            f"search.strategy: {search.strategy} covers the area from {covers_from_m:g} m, whatever the scan "
            "altitude, which is what --advise compares; write scan-only to compare heights"
        )
    try:
        kinds = _hardest_kinds(scenario)
        uncalibrated = ""
    except UserError as error:
        kinds, uncalibrated = [], str(error)
    settings, surfaces = list(_settings(scenario)), surfaces_of(scenario)
    options = []
    for done, (altitude_m, speed_mps) in enumerate(settings):
        options.append(_option(scenario, kinds, surfaces, altitude_m, speed_mps, wanted_pod))
        on_step(done + 1, len(settings))
    best, why = _best(options, wanted_pod, scenario.vehicle.batteries)
    return Advice(tuple(options), best, why, uncalibrated)


def expected_pod(
    scenario: Scenario,
    kinds: list[tuple[KindModel, float]],
    surfaces: Mapping[str, float],
    altitude_agl_m: float,
    spacing_m: float,
) -> float:
    """Of one coverage with transects ``spacing_m`` apart, for the hardest of some kinds and their sizes.

    ``surfaces`` are what covers the ground, with their shares.
    """
    between_m = spacing_m * (np.arange(_ACROSS) + 0.5) / _ACROSS / 2.0  # from a transect to the middle
    half_m = scenario.camera.lens.footprint_m(altitude_agl_m)[0] / 2.0
    in_picture = between_m <= half_m
    pods = []
    for kind, size_m in kinds:
        found = np.zeros(_ACROSS)
        found[in_picture] = lateral_range(
            scenario, kind, size_m, altitude_agl_m, between_m[in_picture], surfaces
        )
        pods.append(float(found.mean()))
    return min(pods)


def _hardest_kinds(scenario: Scenario) -> list[tuple[KindModel, float]]:
    """Kinds of the sensor model that are searched for, each with its smallest size."""
    refuse_tilted(scenario, "the expected POD")
    return [
        (kind, low_m)
        for name, (low_m, _) in scenario.target_sizes_m.items()
        for kind in model_for(scenario, "compare by pixels alone").searched(name, scenario.target_poses[name])
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
    speeds = {max(round(share * fastest_mps, 1), _LEAST_MPS) for share in _SPEED_SHARES}
    speeds.add(min(search.scan_speed_mps, fastest_mps))
    for height_m in sorted(heights | {search.scan_altitude_agl_m}, reverse=True):
        for speed_mps in sorted(speeds):
            yield height_m, speed_mps


def _option(
    scenario: Scenario,
    kinds: list[tuple[KindModel, float]],
    surfaces: Mapping[str, float],
    altitude_m: float,
    speed_mps: float,
    wanted_pod: float,
) -> Option:
    pod, sidelap = None, scenario.search.sidelap
    pixels = scenario.pixels_on_target(altitude_m)
    try:
        flown = {"scan_altitude_agl_m": altitude_m, "scan_speed_mps": speed_mps, "plan": NULL}
        tried = change_scenario(scenario, {f"search.{name}": value for name, value in flown.items()})
        if kinds:
            swath_m = scenario.camera.lens.footprint_m(altitude_m)[0]
            for sidelap in _SIDELAPS:
                pod = expected_pod(tried, kinds, surfaces, altitude_m, swath_m * (1.0 - sidelap))
                if pod >= wanted_pod:
                    break
        _, cost = plan_scenario(tried.with_search(sidelap=sidelap))
    except UserError as error:
        return Option(altitude_m, speed_mps, sidelap, pixels, pod, None, None, None, str(error))
    return Option(
        altitude_m, speed_mps, sidelap, pixels, pod, cost.time_s, cost.batteries, cost.path_length_m
    )


def _best(options: list[Option], wanted_pod: float, batteries: int) -> tuple[Option | None, str]:
    flyable = [o for o in options if o.time_s is not None]
    if not flyable:
        return None, options[0].why_not

    def shortest(among: list[Option]) -> Option:
        """Of those that the batteries last for, else of all."""
        lasting = [o for o in among if (o.batteries or 0) <= batteries]
        return min(lasting or among, key=lambda o: (o.time_s or 0.0, -(o.pod or 0.0)))

    if all(o.pod is None for o in flyable):
        enough = [o for o in flyable if o.pixels_on_target >= WISHED_AT_SCAN_PX]
        if enough:
            return shortest(
                enough
            ), f"the shortest flight with {WISHED_AT_SCAN_PX:g} pixels on the smallest target"
        most = max(flyable, key=lambda o: (o.pixels_on_target, -(o.time_s or 0.0)))
        return most, "most pixels on the smallest target; too few for a detector to rely on"
    enough = [o for o in flyable if (o.pod or 0.0) >= wanted_pod]
    wanted = f"expected to report {wanted_pod:.0%} of the targets at least once"
    if enough:
        return shortest(enough), f"the shortest flight that is {wanted}"
    most = max(flyable, key=lambda o: (o.pod or 0.0, -(o.time_s or 0.0)))
    return most, f"no flight is {wanted}; this one reports most"
