"""The rules by which a mission holds, returns or lands by itself (table: docs/safety.md).

Every rule judges the estimated state and may raise an alarm; the most severe action wins. ``mission/loop.py``
carries it out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from itertools import pairwise

import numpy as np

from skysweep.mission.energy import Charge, ReturnEnergy, known_wind_xy, wind_xy
from skysweep.mission.fence import Fence, SearchedArea
from skysweep.mission.looks import Looks
from skysweep.mission.progress import Progress
from skysweep.planning.flight_plan import CHARGED
from skysweep.scenarios.model import GIMBAL_PITCH_DEG, Scenario
from skysweep.types import Setpoint, VehicleState, Waypoint
from skysweep.worlds.obstacles import Obstacles

_XYZ = tuple[float, float, float]

CHECK_PERIOD_S = 1.0
_ENERGY_PERIOD_S = 5.0
_NO_WAY_HOME_S = 60.0  # without progress
_STUCK_SAID_S = 20.0  # without progress towards the setpoint
_ARRIVED_M = 3.0  # close enough to need no progress
_SLOW_M = 3.0  # that a slow vehicle is given time for
_TURNED_AWAY_RAD, _TURNED_SAID_S = 0.35, 10.0
_POINTS_AWAY_RAD = 0.1
_LOWEST_RAD, _HIGHEST_RAD = map(math.radians, GIMBAL_PITCH_DEG)
_GROUND_SAID_S, _GROUND_RETURN_S = 3.0, 10.0
_GROUND_SHARE, _GROUND_NEAR_SHARE = 0.25, 0.5  # of the expected distance
_GROUND_M = 2.0
_SIGMAS = 3.0  # of the position error
_BEAM = 0.05  # half the width of a rangefinder's beam over its length
_LONGEST_STEP_S = 2.0  # over which the mean velocity predicts a movement
_ACCELERATES_MPS2 = 9.81  # at most: at a tilt of 45 degrees
_CLIMBS_MPS = 3.0  # a PX4 on its own way home
_MOVED_M = 3.0  # a waypoint that moves less is the same one
_NO_JUMP = (0.0, 0.0, 0.0)

OUTSIDE = "outside the area"  # cause
_PLACELESS = {"position lost", "position jump"}  # causes
SILENT = "detector silent"  # cause
LOST = "vehicle lost"  # cause: silent for longer than a battery lasts
LOW_BATTERY, RETURN_ENERGY = "low battery", "return energy"  # causes
BATTERY_CHANGE = "battery change"  # cause
OVER = {
    "telemetry silent": "Telemetry is back.",
    "position lost": "The position is known again.",
    "position jump": "The position has jumped back.",
    "camera": "The camera is trusted again.",
    SILENT: "The detector answers again.",
    "detector slow": "The detector keeps its rate again.",
    "scan slowed": "The scan is as fast as planned again.",
    "wind": "The wind has dropped.",
    "battery unknown": "The vehicle reports its battery again.",
    "setpoints ignored": "The vehicle follows its setpoints again.",
    "turned away": "The vehicle keeps the commanded heading again.",
    "gimbal": "The camera points where it is told again.",
    "height": "The rangefinder agrees with the height again.",
    "operator": "The operator's hold is over.",
    "taken over": "The vehicle is the mission's again.",
    BATTERY_CHANGE: "The wait for another battery is over.",
}  # sentences for when a cause has cleared


class Phase(Enum):
    """The parts of a mission."""

    TAKEOFF = auto()
    SEARCH = auto()
    RETURN = auto()
    LAND = auto()
    SWAP = auto()


class Action(IntEnum):
    """What to do, from mild to severe."""

    CONTINUE = 0
    REFUSE_CHECK = 1
    HOLD = 2
    RETURN = 3
    LAND = 4
    KEEP_OUT = 5  # somebody else flies it: command nothing until a person says take back


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something is wrong: the action, its cause, and a sentence for people.

    ``holder`` says who has the vehicle, where somebody else does: ``VehicleState.taken_over``.
    """

    action: Action
    cause: str
    sentence: str
    holder: str | None = None


def not_finite(waypoint: Waypoint) -> str:
    """The first field of a waypoint that is NaN or infinite; empty if none is."""
    values = waypoint._asdict().items()
    return next((field for field, value in values if value is not None and not np.isfinite(value).all()), "")


class Guard:
    """Judges the states of one mission.

    ``begins_in_air`` says that the vehicle was flown before, nobody knows how far or by whom.
    """

    def __init__(
        self,
        scenario: Scenario,
        fence: Fence,
        energy: ReturnEnergy,
        looks: Looks,
        obstacles: Obstacles,
        begins_in_air: bool = False,
    ) -> None:
        self._limits, self._battery_wh = scenario.safety, scenario.vehicle.battery_wh
        self._home, self._noise_m = scenario.home.position_enu_m, scenario.vehicle.position_noise_m
        self._gimbal, self._obstacles = scenario.camera.gimbal, obstacles
        self._fence, self._energy, self._looks = fence, energy, looks
        self._since: dict[str, float] = {}
        self._word: str | None = None
        self._hold, self._waited = _HELD, False  # why it holds; whether the vehicle waited for a word
        self.waits_for_battery = False  # for a person's word that it was changed
        self._last: tuple[float, _XYZ, _XYZ] | None = None  # time, position, velocity
        self._jumped_m = _NO_JUMP
        self._fastest_mps = self._limits.air_speed_max_mps + self._limits.wind_max_mps
        vehicle = scenario.vehicle
        self._fastest_up_mps = max(vehicle.climb_speed_mps, vehicle.descent_speed_mps, _CLIMBS_MPS)
        self._charge = Charge(energy, scenario.vehicle.battery_wh)
        self._endurance_s = 3600.0 * scenario.vehicle.battery_wh / scenario.vehicle.hover_power_w
        self._homeward, self._progress = Progress(), Progress()
        self._disobeys = False
        self._is_fixed = False  # the camera, as the vehicle did not point it
        self._was_elsewhere = False  # when that was said
        self._told_rad = self._left_rad = (
            self._gimbal.pitch_rad
        )  # of the mission, and from where it turns there
        lens = scenario.camera.lens
        half_rad = math.atan(0.5 * min(lens.width_px, lens.height_px) / lens.focal_px)
        self._half_view_rad = max(half_rad, _POINTS_AWAY_RAD)
        self._led_away = begins_in_air  # perhaps beyond the fence, by somebody else
        self._may_estimate = scenario.safety.battery_estimated and not begins_in_air
        self._room = ((math.inf, math.inf), 0.0)  # a place, and how far inside the fence it is
        self._allowed: Waypoint | None = None  # the newest
        self.searched = SearchedArea(scenario)
        self._x = self._y = self._z = math.inf
        self._energy_due_s = 0.0

    def alarms(
        self, state: VehicleState, altitude_agl_m: float, phase: Phase, goal: Setpoint | None = None
    ) -> tuple[Alarm, ...]:
        """All current alarms. A search is judged by all rules, other phases by those that matter then.

        To be called with the states in order. ``goal`` is the current setpoint, if any.
        """
        now_s = state.time_s + state.silent_s
        self._add_up_jumps(state)
        self._note_pitch(state, goal)
        self._wait_for_word(state)
        if phase is Phase.SEARCH and self._is_calm(state, altitude_agl_m):
            return ()
        if phase is Phase.LAND:
            return tuple(self._landing(state, altitude_agl_m, now_s))
        if phase is Phase.SWAP:
            return tuple(self._on_the_ground(state, now_s))
        found = [*self._link(state, now_s), *self._position(state, now_s)]
        found += self._battery(state, phase, now_s)
        lost = any(a.cause in ("position lost", "position jump") for a in found)
        silent = state.silent_s > self._limits.link_hold_s
        self._looks.trust(state.time_s, lost, silent)
        if state.taken_over:
            self._led_away = True
            self._homeward.restart()
            return (_keeps_out(state.taken_over),)
        if self._word == "hold":
            judged = phase is Phase.RETURN and not (lost or silent)
            asks = [*self._low(state), *self._energy_left(state, altitude_agl_m)] if judged else []
            found += self._held(asks)
        if phase is Phase.RETURN:
            waits = silent or any(a.action is Action.HOLD for a in found)
            found += self._progress_home(state, now_s, waits, goal)
        found += self._rate()
        if phase is not Phase.SEARCH:
            return tuple(found)
        if self._word == "return":
            found.append(Alarm(Action.RETURN, "operator", "The operator calls the vehicle home."))
        disobeys = [*self._obedience(state, goal, now_s)]
        self._disobeys = bool(disobeys)
        found += [*disobeys, *self._pointing(state, goal, now_s)]
        if not lost and not silent:
            found += self._place(state, altitude_agl_m)
            found += self._height(state, now_s)
            found += self._energy_left(state, altitude_agl_m)
            found += self._detector(state.time_s)
        return (*found, *self._wind(state, now_s))

    def not_judged(self, state: VehicleState, phase: Phase, goal: Setpoint | None) -> set[str]:
        """Causes of ``OVER`` that ``alarms`` did not judge just now: they may persist."""
        causes: set[str] = set()
        if phase is Phase.LAND:
            causes |= {"telemetry silent", "position lost", "position jump"}
        if phase not in (Phase.SEARCH, Phase.SWAP):
            causes.add("wind")
        if phase is not Phase.SEARCH or goal is None:
            causes |= {"setpoints ignored", "turned away", "gimbal"}
        elif self._may_be_fixed:
            causes.add("gimbal")
        unsure = state.silent_s > self._limits.link_hold_s or self._since.keys() & _PLACELESS
        if phase is not Phase.SEARCH or unsure:
            causes |= {"camera", SILENT, "height"}
        if state.ground_below_m is None:
            causes.add("height")
        return causes

    def is_urgent(self, state: VehicleState) -> bool:
        """Whether link or position demand a check of all rules now. To be asked at every step."""
        x, y, z = state.position_enu_m.tolist()
        step_m = abs(x - self._x) + abs(y - self._y) + abs(z - self._z)
        self._x, self._y, self._z = x, y, z
        limits = self._limits
        return (
            bool(state.taken_over or state.waits)
            or step_m > limits.position_jump_m
            or state.silent_s > limits.link_hold_s
            or not state.position_std_m <= limits.position_std_max_m
            or self._looks_elsewhere(state)
        )

    def heed(self, word: str | None) -> None:
        """Obey the operator: hold, continue, return; None is nothing new."""
        if word is not None:
            self._word, self._hold = None if word == "continue" else word, _HELD
            self.waits_for_battery = self.waits_for_battery and word == "hold"

    @property
    def calls_home(self) -> bool:
        """Whether the operator's newest order is to return."""
        return self._word == "return"

    @property
    def calls_off(self) -> bool:
        """Whether the operator's newest order is against a take-off: to hold, or to return."""
        return self._word is not None

    def wait_for_battery(self) -> None:
        """Stay on the ground until the operator says that the battery was changed, or ends the mission."""
        if not self.calls_home:
            self._word, self.waits_for_battery = "hold", True

    def refuses_take_off(self, state: VehicleState) -> str:
        """Why not to take off now, with the battery that is in; empty if nothing is against it."""
        if state.taken_over or state.airborne:
            return "Somebody else flies the vehicle: take it back first."
        keeps = next(self._keeps_down(state, state.time_s + state.silent_s), None)
        return self._refuses_battery(state) if keeps is None else keeps.sentence

    def _refuses_battery(self, state: VehicleState) -> str:
        left = state.battery_remaining
        if math.isnan(left):
            agreed = self._limits.battery_estimated and not self._charge.was_said
            return "" if agreed else "The vehicle does not report the charge of its battery."
        if left < CHARGED:
            return f"The battery is at {left:.0%}, less than {CHARGED:.0%}: put in a charged one."
        return ""

    def begin_sortie(self) -> None:
        """Forget what belongs to the last flight and its battery."""
        self._charge = Charge(self._energy, self._battery_wh, self._charge.was_said)
        self._homeward.restart()
        self._progress.restart()
        self._may_estimate = self._limits.battery_estimated
        self._since.clear()
        self._jumped_m, self._last = _NO_JUMP, None
        self._disobeys, self._allowed = False, None
        self._energy_due_s = 0.0

    def refusal(
        self, state: VehicleState, altitude_agl_m: float, waypoint: Waypoint, flown_to: Waypoint | None
    ) -> Alarm | None:
        """Why a waypoint must not be flown to; None if it may, which is decided once.

        ``flown_to`` is its lookout, or the waypoint itself; None if there is no lookout.
        """
        field = not_finite(waypoint)
        if field:
            return Alarm(
                Action.REFUSE_CHECK, "waypoint", f"A waypoint is not flown to: its {field} is not finite."
            )
        if waypoint.speed_mps <= 0.0:
            sentence = f"A waypoint is not flown to: its speed_mps is {waypoint.speed_mps:g}, not above 0."
            return Alarm(Action.REFUSE_CHECK, "waypoint", sentence)
        if flown_to is not None and self._was_allowed(flown_to):
            return None
        cause, why = self.objection(state, altitude_agl_m, waypoint, flown_to)
        if not cause:
            self._allowed = flown_to
            return None
        x, y = waypoint.xy_enu_m
        sentence = f"The place {x:.0f} m east, {y:.0f} m north is not flown to: {why}."
        return Alarm(Action.REFUSE_CHECK, cause, sentence)

    def objection(
        self, state: VehicleState, altitude_agl_m: float, waypoint: Waypoint, flown_to: Waypoint | None
    ) -> tuple[str, str]:
        """Cause and reason not to fly to a finite waypoint, as it is now; empty if there is none."""
        if waypoint.to_look and not self.searched.covers(waypoint.xy_enu_m):
            return OUTSIDE, "it lies outside the area that is searched"
        if flown_to is None:
            return "no clear view", "no place clear of trees and buildings has it in view"
        here, limits = (state.position_enu_m.item(0), state.position_enu_m.item(1)), self._limits
        lowest_m = max(limits.altitude_min_agl_m, limits.descent_floor_agl_m)
        if not lowest_m <= flown_to.altitude_agl_m <= limits.altitude_max_agl_m:
            return "altitude", f"{flown_to.altitude_agl_m:.1f} m above ground is not between the limits"
        pitch_rad = flown_to.gimbal_pitch_rad
        if pitch_rad is not None and not _LOWEST_RAD <= pitch_rad <= _HIGHEST_RAD:
            lowest, highest = GIMBAL_PITCH_DEG
            return (
                "gimbal",
                f"a pitch of {math.degrees(pitch_rad):.0f} is not {lowest:g} to {highest:g} degrees",
            )
        if not self._fence.allows(flown_to.xy_enu_m):
            return "geofence", "it lies outside the geofence or in a no-fly area"
        if not self._fence.way(here, flown_to.xy_enu_m):
            return "geofence", "no way leads there inside the geofence"
        left_wh = self._usable_wh(state)
        needed_wh = self._energy.waypoint_wh(state, altitude_agl_m, flown_to)
        if needed_wh > left_wh:
            return RETURN_ENERGY, (
                f"with the way home it takes {needed_wh:.1f} Wh, and {max(left_wh, 0.0):.1f} Wh are left"
            )
        return "", ""

    def _is_calm(self, state: VehicleState, altitude_agl_m: float) -> bool:
        """A quick check that replaces most checks of the rules: nothing is, was or may soon be wrong."""
        limits = self._limits
        energy_due = state.time_s >= self._energy_due_s
        if energy_due:
            self._energy_due_s = state.time_s + _ENERGY_PERIOD_S
        return not (
            energy_due
            or self._since
            or self._word
            or self._disobeys
            or self._jumped_m != _NO_JUMP
            or not self._is_far_inside(state)
            or bool(state.taken_over)
            or state.silent_s > limits.link_hold_s
            or self._is_unsure(state)
            or self._looks_elsewhere(state)
            or not state.battery_remaining >= limits.battery_low
            or state.ground_below_m is not None
            or not limits.altitude_min_agl_m < altitude_agl_m < limits.altitude_max_agl_m
            or self._looks.are_rare
            or self._looks.doubt
            or self._looks.age_s(state.time_s) > self._looks.silent_age_s
            or math.hypot(*wind_xy(state)) > limits.wind_max_mps
        )

    def _is_unsure(self, state: VehicleState) -> bool:
        """Whether place or velocity are not finite, or not accurate enough."""
        sure = state.position_std_m <= self._limits.position_std_max_m
        return not (sure and math.isfinite(sum(state.velocity_enu_mps.tolist())))

    def _is_far_inside(self, state: VehicleState) -> bool:
        """Whether it is inside the fence: measured again once it has moved by the last distance to it."""
        x, y, _ = state.position_enu_m.tolist()
        if math.dist((x, y), self._room[0]) >= self._room[1]:
            self._room = (x, y), self._fence.room_m((x, y))
        return self._room[1] > 0.0

    # ---- the rules -----------------------------------------------------------------------------------

    def _link(self, state: VehicleState, now_s: float) -> Iterator[Alarm]:
        silent_s = state.silent_s
        self._lasting_s("telemetry silent", silent_s > self._limits.link_hold_s, now_s)
        if silent_s > self._endurance_s:
            yield _is_lost(silent_s)
        elif silent_s > self._limits.link_return_s:
            yield Alarm(
                Action.RETURN,
                "telemetry silent",
                f"No telemetry for {silent_s:.0f} s: returning home once the link is back.",
            )
        elif silent_s > self._limits.link_hold_s:
            yield Alarm(Action.HOLD, "telemetry silent", f"No telemetry for {silent_s:.1f} s.")

    def _position(self, state: VehicleState, now_s: float) -> Iterator[Alarm]:
        limits = self._limits
        lost_s = self._lasting_s("position lost", self._is_unsure(state), now_s)
        if lost_s is not None:
            action = Action.HOLD if lost_s < limits.position_hold_s else Action.LAND
            std_m = state.position_std_m
            claim = f"{std_m:.0f} m" if limits.position_std_max_m < std_m < math.inf else "no position"
            yield Alarm(action, "position lost", f"The position is not known well enough ({claim}).")
        offset_m = math.hypot(*self._jumped_m)
        displaced_s = self._lasting_s("position jump", offset_m > limits.position_jump_m, now_s)
        if displaced_s is not None:
            action = Action.HOLD if displaced_s < limits.position_hold_s else Action.RETURN
            yield Alarm(action, "position jump", f"The position jumped by {offset_m:.0f} m.")

    def _battery(self, state: VehicleState, phase: Phase, now_s: float) -> Iterator[Alarm]:
        limits, left, unknown = self._limits, self._charge.left(state), math.isnan(state.battery_remaining)
        unknown_s = self._lasting_s("battery unknown", unknown, now_s)
        if unknown_s is not None:
            agreed = self._may_estimate and not self._charge.was_said
            action = Action.CONTINUE if agreed or unknown_s < limits.battery_unknown_s else Action.RETURN
            sentence = f"The vehicle does not report its battery: at most {left:.0%} by estimate."
            yield Alarm(action, "battery unknown", sentence)
        if not unknown and left < limits.battery_critical:
            yield Alarm(Action.LAND, "battery critical", f"The battery is at {left:.0%}: landing at once.")
        elif phase is Phase.SEARCH:
            yield from self._low(state)

    def _low(self, state: VehicleState) -> Iterator[Alarm]:
        left = self._charge.left(state)
        if left < self._limits.battery_low:
            yield Alarm(Action.RETURN, LOW_BATTERY, f"The battery is at {left:.0%}.")

    def _energy_left(self, state: VehicleState, altitude_agl_m: float) -> Iterator[Alarm]:
        x, y, _ = state.position_enu_m.tolist()
        needed_wh = self._energy.home_wh((x, y), altitude_agl_m, wind_xy(state))
        if self._usable_wh(state) < needed_wh < math.inf:  # in too much wind the wind's own rule decides
            left = f"{self._charge.left(state):.0%}"
            sentence = f"The way home takes {needed_wh:.1f} Wh and the battery is at {left}."
            yield Alarm(Action.RETURN, RETURN_ENERGY, sentence)

    def _usable_wh(self, state: VehicleState) -> float:
        return (self._charge.left(state) - self._limits.landing_reserve) * self._battery_wh

    def _place(self, state: VehicleState, altitude_agl_m: float) -> Iterator[Alarm]:
        limits, tolerance_m = self._limits, self._limits.fence_tolerance_m
        if self._fence.exists:
            x, y, _ = state.position_enu_m.tolist()
            outside_m = self._fence.outside_m((x, y))
            self._led_away = self._led_away and outside_m > 0.0
            if outside_m > tolerance_m and not self._led_away:
                yield Alarm(Action.RETURN, "geofence", f"The vehicle is {outside_m:.0f} m beyond the fence.")
        too_high = altitude_agl_m > limits.altitude_max_agl_m + tolerance_m
        if too_high or altitude_agl_m < limits.altitude_min_agl_m:
            yield Alarm(Action.RETURN, "altitude", f"The vehicle is {altitude_agl_m:.1f} m above the ground.")

    def _detector(self, time_s: float) -> Iterator[Alarm]:
        age_s = self._looks.age_s(time_s)
        dead = age_s > self._looks.dead_age_s
        if self._looks.doubt:
            action = Action.RETURN if dead else Action.CONTINUE
            yield Alarm(action, "camera", f"The camera {self._looks.doubt}.")
        elif age_s > self._looks.silent_age_s:
            sentence = f"The detector's newest answer is {age_s:.0f} s old"
            if self._looks.failure:
                sentence += f" ({self._looks.failure})"
            yield Alarm(Action.RETURN if dead else Action.CONTINUE, SILENT, f"{sentence}.")

    def _rate(self) -> Iterator[Alarm]:
        looks = self._looks
        if looks.are_rare:
            managed = f"{looks.rate_hz:.2g} looks a second of {looks.usual_rate_hz:.2g}"
            yield Alarm(Action.CONTINUE, "detector slow", f"The detector manages {managed}.")
        if looks.scan_is_slowed:
            sentence = f"The scan slows down to {looks.scan_speed_mps:.1f} m/s, to leave nothing unseen."
            yield Alarm(Action.CONTINUE, "scan slowed", sentence)

    def _wind(self, state: VehicleState, now_s: float) -> Iterator[Alarm]:
        wind = known_wind_xy(state)
        if wind is None and "wind" in self._since:
            yield Alarm(Action.CONTINUE, "wind", "The wind is no longer known.")
            return
        speed_mps = math.hypot(*wind) if wind is not None else 0.0
        blown_s = self._lasting_s("wind", speed_mps > self._limits.wind_max_mps, now_s)
        if blown_s is not None:
            action = Action.HOLD if blown_s < self._limits.wind_hold_s else Action.RETURN
            yield Alarm(action, "wind", f"The wind blows at {speed_mps:.0f} m/s.")

    def _progress_home(
        self, state: VehicleState, now_s: float, waits: bool, goal: Setpoint | None
    ) -> Iterator[Alarm]:
        """Land here without progress towards home, as in strong wind; a climb that was asked for is some."""
        if waits:
            self._homeward.restart()
            return
        x, y, z = state.position_enu_m.tolist()
        way = [(x, y), *(self._fence.way((x, y), self._home) or [self._home])]
        distance_m = sum(math.dist(a, b) for a, b in pairwise(way))
        asked_m = -math.inf if goal is None else goal.position_enu_m.item(2)
        if self._homeward.stuck_s(now_s, self._home, distance_m, min(z, asked_m)) > _NO_WAY_HOME_S:
            yield Alarm(Action.LAND, "no way home", f"No way home, {distance_m:.0f} m away: landing here.")

    def _obedience(self, state: VehicleState, goal: Setpoint | None, now_s: float) -> Iterator[Alarm]:
        """Whether it follows the setpoint's place and yaw."""
        if goal is None:
            self._progress.restart()
            self._since.pop("turned away", None)
            return
        x, y, z = goal.position_enu_m.tolist()
        left_m = math.dist((x, y, z), state.position_enu_m.tolist())
        if left_m < _ARRIVED_M:
            self._progress.restart()
        else:
            stuck_s = self._progress.stuck_s(now_s, (x, y), left_m) - _SLOW_M / goal.speed_mps
            if stuck_s > _STUCK_SAID_S:
                sentence = f"The vehicle makes no progress towards its setpoint, {left_m:.0f} m away."
                yield Alarm(self._home_after(stuck_s), "setpoints ignored", sentence)
        R = state.R_body_to_enu
        away_rad = abs(math.remainder(math.atan2(R.item(3), R.item(0)) - goal.yaw_rad, math.tau))
        turned_s = self._lasting_s("turned away", away_rad > _TURNED_AWAY_RAD, now_s)
        if turned_s is not None and turned_s > _TURNED_SAID_S:
            sentence = f"The heading is {math.degrees(away_rad):.0f} degrees off the commanded one."
            yield Alarm(self._home_after(turned_s), "turned away", sentence)

    def _pointing(self, state: VehicleState, goal: Setpoint | None, now_s: float) -> Iterator[Alarm]:
        """Whether the camera takes its pitch; that it does not is said once.

        One that keeps the scenario's pitch covers the ground all the same. What another shows does not count
        where it would look past the middle of its picture.
        """
        if goal is None:
            self._since.pop("gimbal", None)
            return
        looks_rad, turns_s = state.camera.pitch_rad, 180.0 / self._gimbal.max_rate_dps
        elsewhere = self._looks_elsewhere(state)
        self._looks.look_elsewhere(state.time_s, elsewhere)
        away_s = self._lasting_s("gimbal", abs(looks_rad - self._told_rad) > _POINTS_AWAY_RAD, now_s)
        if away_s is None and self._may_be_fixed:
            return
        longest_s = turns_s if elsewhere else turns_s + _TURNED_SAID_S
        self._is_fixed = away_s is not None and (self._is_fixed or away_s > longest_s)
        if self._is_fixed:
            self._was_elsewhere = elsewhere
            told, looks = (f"{math.degrees(rad):.0f}" for rad in (self._told_rad, looks_rad))
            shown = ", and what it shows does not count" if elsewhere else ""
            sentence = (
                f"The camera's pitch is {looks} degrees, not {told}: the vehicle does not point it{shown}."
            )
            yield Alarm(Action.CONTINUE, "gimbal", sentence)

    @property
    def _may_be_fixed(self) -> bool:
        """Whether it is told to look as a camera without a gimbal does: that it does so tells nothing."""
        return self._told_rad == self._gimbal.pitch_rad and not self._was_elsewhere

    def _note_pitch(self, state: VehicleState, goal: Setpoint | None) -> None:
        """What the camera is told, and from where it turns there."""
        if goal is None:
            return
        told_rad = self._gimbal.pitch_rad if goal.gimbal_pitch_rad is None else goal.gimbal_pitch_rad
        looks_rad = state.camera.pitch_rad
        if told_rad != self._told_rad:
            self._told_rad, self._left_rad = told_rad, looks_rad
        if abs(looks_rad - told_rad) <= _POINTS_AWAY_RAD:
            self._left_rad = told_rad

    def _looks_elsewhere(self, state: VehicleState) -> bool:
        """Whether the camera looks past all between the scenario's pitch, the mission's, and its last one."""
        pitches_rad, half_rad = (self._gimbal.pitch_rad, self._told_rad, self._left_rad), self._half_view_rad
        return not min(pitches_rad) - half_rad <= state.camera.pitch_rad <= max(pitches_rad) + half_rad

    def _home_after(self, lasted_s: float) -> Action:
        return Action.RETURN if lasted_s > self._limits.stuck_return_s else Action.CONTINUE

    def _height(self, state: VehicleState, now_s: float) -> Iterator[Alarm]:
        """The estimated height against a rangefinder's, which meets the ground or a known obstacle.

        An unknown obstacle may be as high as half the height above ground.
        """
        below_m = state.ground_below_m
        if below_m is None:
            self._since.pop("height", None)
            return
        near_m, far_m = self._to_be_measured_m(state)
        off = not near_m - _ground_slack_m(near_m) <= below_m <= far_m + _ground_slack_m(far_m)
        off_s = self._lasting_s("height", off, now_s)
        if off_s is not None and off_s >= _GROUND_SAID_S:
            near = below_m < _GROUND_NEAR_SHARE * near_m and off_s >= _GROUND_RETURN_S
            least, most = f"{max(near_m, 0.0):.0f}", f"{far_m:.0f}"
            expected = most if least == most else f"{least} to {most}"
            sentence = f"The rangefinder measures {below_m:.0f} m down, not {expected} m."
            yield Alarm(Action.RETURN if near else Action.CONTINUE, "height", sentence)

    def _to_be_measured_m(self, state: VehicleState) -> tuple[float, float]:
        """The least and the most that a rangefinder should measure, as its beam leans with the vehicle.

        It meets anything between the highest known top and the lowest ground around.
        """
        x, y, z = state.position_enu_m.tolist()
        R = state.R_body_to_enu
        lean = math.hypot(R.item(6), R.item(7)) / max(R.item(8), 0.5)
        length_m = max(0.0, z - self._obstacles.terrain.height_at_m(x, y))
        away_m = _SIGMAS * max(self._noise_m, state.position_std_m) + (lean + _BEAM) * length_m
        lowest_m, highest_m = self._obstacles.heights_within_m((x, y), away_m)
        return z - highest_m, z - lowest_m

    def _landing(self, state: VehicleState, altitude_agl_m: float, now_s: float) -> Iterator[Alarm]:
        """The alarms of a landing."""
        if state.taken_over:
            yield _keeps_out(state.taken_over)
        elif state.silent_s > self._endurance_s:
            yield _is_lost(state.silent_s)
        else:
            yield from self._battery(state, Phase.LAND, now_s)
            yield from self._rate()
            if self._word == "hold" and (state.waits or not self._is_unsure(state)):
                unknown = math.isnan(state.battery_remaining)
                asks = self._low(state) if unknown else self._landing_energy(state, altitude_agl_m)
                yield from self._held([*asks])

    def _on_the_ground(self, state: VehicleState, now_s: float) -> Iterator[Alarm]:
        """The alarms between two sorties: what keeps it there."""
        if state.taken_over or state.airborne:
            yield _keeps_out(state.taken_over or "it is in the air")
            return
        yield from self._rate()
        if self._word == "return":
            yield Alarm(Action.RETURN, "operator", "The operator ends the mission on the ground.")
        if self.waits_for_battery:
            sentence = "It waits on the ground: change the battery, then say continue."
            yield Alarm(Action.HOLD, BATTERY_CHANGE, sentence)
        elif self._word == "hold":
            yield _HELD
        yield from self._keeps_down(state, now_s)

    def _keeps_down(self, state: VehicleState, now_s: float) -> Iterator[Alarm]:
        """What is against a take-off, whatever the operator says."""
        silent = state.silent_s > self._limits.link_hold_s
        self._lasting_s("telemetry silent", silent, now_s)
        if silent:
            yield Alarm(Action.HOLD, "telemetry silent", f"No telemetry for {state.silent_s:.1f} s.")
        if self._lasting_s("position lost", self._is_unsure(state), now_s) is not None:
            yield Alarm(Action.HOLD, "position lost", "The position is not known well enough to take off.")
        if (wind_mps := math.hypot(*wind_xy(state))) > self._limits.wind_max_mps:
            yield Alarm(Action.HOLD, "wind", f"The wind blows at {wind_mps:.0f} m/s.")

    def _landing_energy(self, state: VehicleState, altitude_agl_m: float) -> Iterator[Alarm]:
        left, needed_wh = self._charge.left(state), self._energy.landing_wh(altitude_agl_m, wind_xy(state))
        if (left - self._limits.battery_critical) * self._battery_wh < needed_wh:
            sentence = f"The landing takes {needed_wh:.1f} Wh and the battery is at {left:.0%}: landing now."
            yield Alarm(Action.LAND, "landing energy", sentence)

    def _wait_for_word(self, state: VehicleState) -> None:
        """A vehicle that is ours again without a word is held as by the operator, who may have said more."""
        if state.waits and not self._waited and self._word is None:
            self._word, self._hold = "hold", Alarm(Action.HOLD, "taken over", state.waits)
        self._waited = bool(state.waits)

    def _held(self, asks: list[Alarm]) -> list[Alarm]:
        """The hold, or the battery's demand, which ends it."""
        if asks:
            self._word = None
        return asks or [self._hold]

    # ---- what it remembers ---------------------------------------------------------------------------

    def _was_allowed(self, waypoint: Waypoint) -> bool:
        allowed = self._allowed
        return (
            allowed is not None
            and allowed.altitude_agl_m == waypoint.altitude_agl_m
            and allowed.gimbal_pitch_rad == waypoint.gimbal_pitch_rad
            and math.dist(allowed.xy_enu_m, waypoint.xy_enu_m) < _MOVED_M
        )

    def _lasting_s(self, cause: str, present: bool, now_s: float) -> float | None:
        """How long a cause has lasted; None while it is absent."""
        if not present:
            self._since.pop(cause, None)
            return None
        return now_s - self._since.setdefault(cause, now_s)

    def _add_up_jumps(self, state: VehicleState) -> None:
        """Sum the jumps of the position, so that one that jumps back is trusted again."""
        x, y, z = state.position_enu_m.tolist()
        vx, vy, vz = state.velocity_enu_mps.tolist()
        if not math.isfinite(x + y + z + vx + vy + vz):
            return  # the next that is known is compared with the last one
        if self._last is not None:
            t0, (x0, y0, z0), (vx0, vy0, vz0) = self._last
            step_s = state.time_s - t0
            u, v, w = 0.5 * (vx + vx0), 0.5 * (vy + vy0), 0.5 * (vz + vz0)
            jump = x - x0 - step_s * u, y - y0 - step_s * v, z - z0 - step_s * w
            aside_m = max(
                0.0, math.hypot(*jump[:2]) - _strays_m(step_s, self._fastest_mps + math.hypot(u, v))
            )
            up_or_down_m = max(0.0, abs(jump[2]) - _strays_m(step_s, self._fastest_up_mps + abs(w)))
            least_m = 0.5 * self._limits.position_jump_m
            if math.hypot(aside_m, up_or_down_m) > least_m:
                east_m, north_m, up_m = self._jumped_m
                jumped = east_m + jump[0], north_m + jump[1], up_m + jump[2]
                self._jumped_m = jumped if math.hypot(*jumped) > least_m else _NO_JUMP
        self._last = (state.time_s, (x, y, z), (vx, vy, vz))


def _strays_m(step_s: float, fastest_mps: float) -> float:
    """How far a vehicle may get, in a gap of the link, from where its mean velocity leads.

    It speeds up and slows down again, up to its top speed, which is ``fastest_mps`` past what moves on at
    that velocity.
    """
    if step_s <= _LONGEST_STEP_S:
        return 0.0
    gains_mps = min(0.5 * _ACCELERATES_MPS2 * step_s, fastest_mps)
    return gains_mps * (step_s - gains_mps / _ACCELERATES_MPS2)


def _ground_slack_m(distance_m: float) -> float:
    return max(_GROUND_M, _GROUND_SHARE * distance_m)


def _keeps_out(why: str) -> Alarm:
    sentence = f"Somebody else flies the vehicle ({why}): no commands until a person says take back."
    return Alarm(Action.KEEP_OUT, "taken over", sentence, why)


def _is_lost(silent_s: float) -> Alarm:
    sentence = f"No telemetry for {silent_s / 60.0:.0f} minutes, longer than a battery lasts: giving up."
    return Alarm(Action.LAND, LOST, sentence)


_HELD = Alarm(Action.HOLD, "operator", "The operator holds the vehicle.")
