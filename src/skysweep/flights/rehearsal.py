"""Gets ready for a flight: compiles what it needs, and measures how often camera and detector look."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache

import numpy as np

from skysweep.flights.build import build_mission
from skysweep.flights.fly import fly_in_memory
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraPose
from skysweep.mission.looks import Looks
from skysweep.mission.mission import Mission
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.camera_watch import OF_ITSELF, REPEATED
from skysweep.types import Detections, Truth, Vehicle, VehicleState
from skysweep.vehicles.px4.preflight import Check
from skysweep.worlds.world import build_terrain

_WARM_UP_S = 20.0  # for the first answer, at most
_MEASURED_S = 5.0
_ENOUGH = 0.8  # of the rate: the first and the last look may lie outside


@cache
def compile_ahead() -> None:
    """Fly a small simulated search, so that everything that is compiled when first used is so on the ground.

    It takes a second or two; once after an installation a minute, in which a vehicle in the air would fly on
    without its mission.
    """
    fly_in_memory(change_scenario(load_scenario("person-wilderness"), {"search.strategy": "belief"}), 0)


def rehearse(scenario: Scenario, rig: Rig) -> Check:
    """Look for some seconds of the vehicle's time, as in flight; the result. Closes the camera.

    A rendered camera shows the middle of the area from the height of the scan.
    """
    assert rig.vehicle is not None
    mission = build_mission(scenario, 0, replace(rig, vehicle=_Above(rig.vehicle, scenario)))
    looks = Looks(scenario, mission.look_period, mission.cover_altitude_agl_m)
    with closing(mission.sensor):
        try:
            answers, rate_hz = _answers(mission)
        except Exception as error:
            return Check("detector", False, f"camera or detector fails: {error}")
    if rate_hz == 0.0:
        return Check("detector", False, "does not answer; look after the camera, or take a smaller model")
    doubted = [a.doubt.why for a in answers if a.doubt is not None and a.doubt.why in OF_ITSELF]
    if doubted:
        blind = len(doubted) > len(answers) // 2 and doubted[-1] != REPEATED
        said = f"the camera {doubted[-1]} ({len(doubted)} of {len(answers)} pictures)"
        return Check("detector", False if blind else None, said)
    if rate_hz >= _ENOUGH * looks.usual_rate_hz:
        return Check("detector", True, f"{looks.usual_rate_hz:.2g} looks a second; {_sees(answers)}")
    mission.look_period.period_s = max(mission.look_period.period_s, 1.0 / rate_hz)
    said = f"this computer manages {looks.rate_hz:.2g} looks a second of {looks.usual_rate_hz:.2g}"
    if looks.scan_is_slowed:
        return Check("detector", None, f"{said}; the scan slows down to {looks.scan_speed_mps:.1f} m/s")
    return Check("detector", None, f"{said}; enough to cover the area, but targets are seen less often")


def _answers(mission: Mission) -> tuple[list[Detections], float]:
    """The first answer, which takes longer, and those of the following ``_MEASURED_S``; the rate of these.

    The rate is by the vehicle's clock: on a busy computer the ticks take longer than they should.
    """
    tick_s = 1.0 / mission.scenario.camera.rate_hz

    def answers(longest_s: float) -> Iterator[Detections]:
        for _ in range(round(longest_s / tick_s)):
            found = mission.sensor.sense(mission.vehicle.state())
            mission.vehicle.advance(tick_s)
            if found is not None:
                yield found

    first = next(answers(_WARM_UP_S), None)
    if first is None:
        return [], 0.0
    begun_s = mission.vehicle.state().time_s
    further = list(answers(_MEASURED_S))
    lasted_s = max(mission.vehicle.state().time_s - begun_s, _MEASURED_S)
    return [first, *further], len(further) / lasted_s


def _sees(answers: Sequence[Detections]) -> str:
    names = sorted({name for found in answers for name in found.class_names})
    return f"it sees {', '.join(names)}" if names else "it sees nothing that is searched for"


class _Above:
    """Places a vehicle above the middle of the area, at the height of the scan."""

    def __init__(self, vehicle: Vehicle, scenario: Scenario) -> None:
        self._vehicle = vehicle
        self.truth: Truth | None = None
        self.command, self.advance, self.hold = vehicle.command, vehicle.advance, vehicle.hold
        self.takeoff, self.land = vehicle.takeoff, vehicle.land
        middle = scenario.area_enu_m.representative_point()
        ground_m = build_terrain(scenario).height_at_m(middle.x, middle.y)
        height_m = ground_m + scenario.search.scan_altitude_agl_m
        self._position_enu_m = np.array([middle.x, middle.y, height_m])

    def state(self) -> VehicleState:
        state, place = self._vehicle.state(), self._position_enu_m
        camera = CameraPose(place, state.camera.R_camera_to_enu)
        return state._replace(position_enu_m=place, velocity_enu_mps=np.zeros(3), camera=camera)
