"""The one mission loop: sense, track, decide, fly. The same for every vehicle, sensor and strategy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skysweep.mission.journal import Journal
from skysweep.scenarios.model import Scenario
from skysweep.types import (
    Detections,
    Event,
    Observation,
    Sensor,
    Setpoint,
    Strategy,
    Tracker,
    Vehicle,
    VehicleState,
    Waypoint,
)

F64 = NDArray[np.float64]
Watch = Callable[[VehicleState, str, Detections | None], None]
Operator = Callable[[], str | None]

STATE_PERIOD_S = 0.5  # between journal lines of the state
LOW_BATTERY = 0.15  # PX4 BAT_LOW_THR: the search ends and the vehicle returns
_LOOK_AHEAD_S = 2.0  # of terrain
_HOME_ACCEPTANCE_M = 1.0


@dataclass(frozen=True, slots=True)
class Mission:
    """Everything that a mission is made of."""

    scenario: Scenario
    seed: int
    sensor_name: str
    vehicle: Vehicle
    sensor: Sensor
    tracker: Tracker
    strategy: Strategy
    waypoints_xy_enu_m: F64  # (N, 2), F
    cover_altitude_agl_m: float
    yaw_rad: float
    ground_height_m: Callable[[F64], F64]


def fly(
    mission: Mission,
    journal: Journal,
    watch: Watch = lambda _state, _mode, _new: None,
    operator: Operator = lambda: None,
) -> str:
    """Fly the mission from take-off to landing. Returns why the search ended: completed or low battery.

    ``watch`` sees every step (state, mode, new detections) for progress displays and recordings.
    ``operator`` is asked at every step and answers None, "hold", "continue" or "return".
    Mission time 0 is the take-off command. Whatever ends it early, the vehicle is told to hold.
    """
    try:
        return _Flight(mission, journal, watch, operator).fly()
    except BaseException:
        mission.vehicle.hold()
        raise


class _Flight:
    def __init__(
        self,
        mission: Mission,
        journal: Journal,
        watch: Watch,
        operator: Operator,
    ) -> None:
        self._m, self._journal, self._watch, self._operator = mission, journal, watch, operator
        self._tick_s = 1.0 / mission.scenario.camera.rate_hz
        self._next_state_s = 0.0

    def fly(self) -> str:
        mission, journal = self._m, self._journal
        altitude = mission.cover_altitude_agl_m
        search = mission.scenario.search
        journal.write(
            0.0,
            "start",
            scenario=mission.scenario.name,
            strategy=search.strategy,
            n_c=search.n_c,
            d_c_m=search.d_c_m,
            seed=mission.seed,
            sensor=mission.sensor_name,
        )
        xy = mission.waypoints_xy_enu_m
        z = mission.ground_height_m(xy) + altitude
        journal.write(0.0, "plan", waypoints_enu_m=np.column_stack([xy, z]))
        mission.vehicle.takeoff(altitude)
        self._wait(lambda state: self._altitude_agl_m(state) >= altitude - 1.0, "TAKEOFF")
        reason = self._search()
        self._return(max(altitude, search.scan_altitude_agl_m))
        journal.write(mission.vehicle.state().time_s, "landed")
        journal.write(mission.vehicle.state().time_s, "end", reason=reason)
        return reason

    def _search(self) -> str:
        m = self._m
        state = m.vehicle.state()
        while True:
            detections = m.sensor.sense(state)
            sightings = m.tracker.update(detections) if detections is not None else ()
            observation = Observation(state, self._altitude_agl_m(state), sightings, m.tracker.candidates())
            command = m.strategy.step(observation)
            self._note_decisions(observation, command.events)
            self._note_state(state, command.mode)
            self._watch(state, command.mode, detections)
            if command.waypoint is None:
                return "completed"
            if state.battery_remaining < LOW_BATTERY:
                return "low battery"
            if not self._operator_lets_go_on():
                return "operator"
            m.vehicle.command(self._setpoint(state, command.waypoint))
            m.vehicle.advance(self._tick_s)
            state = m.vehicle.state()

    def _operator_lets_go_on(self) -> bool:
        """Hovers from "hold" to "continue"; False after "return"."""
        word = self._operator()
        if word == "hold":
            self._m.vehicle.hold()

            def released(_: VehicleState) -> bool:
                nonlocal word
                word = self._operator()
                return word in ("continue", "return")

            self._wait(released, "HOLD")
        return word != "return"

    def _note_decisions(self, seen: Observation, events: tuple[Event, ...]) -> None:
        for s in seen.sightings:
            self._journal.write(
                s.time_s,
                "sighting",
                candidate=s.candidate_id,
                class_name=seen.candidates[s.candidate_id].class_name,
                new=s.is_new,
                p=s.position_enu_m,
                confidence=s.confidence,
                altitude_agl_m=s.camera_altitude_agl_m,
            )
        for event in events:
            fields: dict[str, object] = {}
            if event.candidate_id is not None:
                fields["candidate"] = event.candidate_id
                fields["p"] = event.position_enu_m
                fields["covariance_m2"] = seen.candidates[event.candidate_id].covariance_m2
            self._journal.write(seen.time_s, event.kind, **fields)

    def _setpoint(self, state: VehicleState, waypoint: Waypoint) -> Setpoint:
        """Terrain following: the height above the highest of the ground here and soon."""
        x, y, _ = state.position_enu_m.tolist()
        to_x, to_y = waypoint.xy_enu_m
        distance = math.hypot(to_x - x, to_y - y)
        share = min(1.0, waypoint.speed_mps * _LOOK_AHEAD_S / max(distance, 1e-6))
        here_and_soon = np.array((x, y, x + (to_x - x) * share, y + (to_y - y) * share))
        ground = max(self._m.ground_height_m(here_and_soon.reshape(2, 2)).tolist())
        return Setpoint(
            np.array([to_x, to_y, ground + waypoint.altitude_agl_m]), waypoint.speed_mps, self._m.yaw_rad
        )

    def _return(self, altitude_agl_m: float) -> None:
        m = self._m
        home = np.array(m.scenario.home.position_enu_m, dtype=float)
        back = Waypoint((float(home[0]), float(home[1])), altitude_agl_m, m.scenario.vehicle.cruise_speed_mps)

        def near_home(state: VehicleState) -> bool:
            m.vehicle.command(self._setpoint(state, back))
            return bool(np.linalg.norm(state.position_enu_m[:2] - home) <= _HOME_ACCEPTANCE_M)

        self._wait(near_home, "RETURN")
        m.vehicle.land()
        self._wait(lambda state: not state.airborne, "LAND")

    def _wait(self, until: Callable[[VehicleState], bool], mode: str) -> None:
        vehicle = self._m.vehicle
        while not until(state := vehicle.state()):
            self._note_state(state, mode)
            self._watch(state, mode, None)
            vehicle.advance(self._tick_s)

    def _altitude_agl_m(self, state: VehicleState) -> float:
        position = state.position_enu_m
        return position.item(2) - self._m.ground_height_m(position[None, :2]).item()

    def _note_state(self, state: VehicleState, mode: str) -> None:
        if state.time_s < self._next_state_s - 1e-6:
            return
        self._next_state_s = state.time_s + STATE_PERIOD_S
        self._journal.write(
            state.time_s,
            "state",
            p=state.position_enu_m,
            v=state.velocity_enu_mps,
            mode=mode,
            battery=state.battery_remaining,
            energy_wh=state.energy_used_wh,
            cam={"p": state.camera.position_enu_m, "R": state.camera.R_camera_to_enu.ravel()},
        )
