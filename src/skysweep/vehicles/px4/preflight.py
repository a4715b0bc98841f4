"""The checks before a PX4 is armed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skysweep.planning.flight_plan import CHARGED, FlightEstimate
from skysweep.planning.qgc import QgcPlan
from skysweep.planning.surroundings import fence_words
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.px4.authority import is_free
from skysweep.vehicles.px4.fence import upload_fence_and_rally
from skysweep.vehicles.px4.telemetry import mode_name
from skysweep.vehicles.px4.vehicle import Px4Vehicle

GIMBAL_S = 5.0  # on the wall, until it has turned
READY_S = 30.0  # on the wall, for the estimator and PX4's own checks
RESERVE = 0.2  # of a battery that is still there after the plan
_MAX_STD_M = 5.0
_FIXES = {2: "2D", 3: "3D", 4: "DGPS", 5: "RTK float", 6: "RTK fixed"}
_OFFBOARD_LOST = {0: "Position", 1: "Altitude", 2: "Stabilized", 3: "Return", 4: "Land", 5: "Hold"}
_OFFBOARD_LOST |= {6: "Terminate", 7: "Disarm"}
_WITHOUT_PILOT = (3, 4, 5)
_FALLS = (6, 7)
_STICKS_LOST = {0: "nothing", 1: "Hold", 2: "Return", 3: "Land", 5: "Terminate", 6: "Disarm"}
_STICKS_LOST_FALLS = (5, 6)
_LOW_BATTERY = {0: "a warning", 1: "Return", 2: "Land", 3: "Return, then Land"}
_NO_FENCE = (0, 1)  # GF_ACTION without effect
_FENCE_SLACK_M = 3.0  # deviation from the path
_FENCE_ACTIONS = {0: "nothing", 1: "a warning", 2: "Hold", 3: "Return", 4: "Terminate", 5: "Land"}


Verdict = tuple[bool | None, str]  # as in ``Check``


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the list. ``passed`` is None for a warning that does not block the flight."""

    name: str
    passed: bool | None
    said: str


@dataclass(frozen=True, slots=True)
class Demands:
    """The requirements of a flight. Heights are above home."""

    plan: QgcPlan
    estimate: FlightEstimate  # of the plan without checks
    farthest_m: float  # from home, horizontally
    highest_m: float
    return_clear_m: float  # a Return at this height is clear of the ground and known obstacles


def preflight(
    vehicle: Px4Vehicle, demands: Demands, upload: bool, ready_s: float = READY_S
) -> tuple[Check, ...]:
    """The list for a flight. Waits up to ``ready_s`` for the vehicle.

    With ``upload`` the vehicle stands by in Hold, and gets the plan's fence and rally points if no check
    fails. Without, only the gimbal moves. A vehicle that answers nothing has the first check alone.
    """
    told = vehicle.telemetry
    if upload:
        vehicle.stand_by()
    vehicle.link.wait(lambda: _is_ready(vehicle) and told.position_std_m < _MAX_STD_M, ready_s)
    first = Check("vehicle", *_vehicle(vehicle))
    if first.passed is False:
        return (first,)
    checks = [
        first,
        Check("position", *_position(vehicle)),
        Check("home", True, _home(vehicle)),
        Check("battery", *_battery(vehicle, demands.estimate)),
        *_sorties(vehicle, demands.estimate),
        Check("low battery", *_low_battery(vehicle)),
        Check("mode", *_mode(vehicle)),
        Check("control", *_control(vehicle)),
        Check("ready", *_ready(vehicle)),
        Check("link lost", *_link_lost(vehicle)),
        Check("pilot", *_pilot(vehicle)),
        Check("return altitude", *_return_altitude(vehicle, demands.return_clear_m)),
        Check("own fence", *_own_fence(vehicle, demands)),
        Check("kept within", True, fence_words(vehicle.scenario)),
        Check("speed", *_speed(vehicle)),
        Check("gimbal", *_gimbal(vehicle)),
    ]
    blocked = any(check.passed is False for check in checks)
    return (*checks, *_fence_and_rally(vehicle, demands.plan, upload and not blocked))


def _gimbal(vehicle: Px4Vehicle) -> Verdict:
    if not vehicle.gimbal:
        return True, "none: the camera is assumed to look as told"
    if not vehicle.is_free:
        return None, "left alone while somebody flies the vehicle"
    told, ours = vehicle.telemetry, vehicle.link.own_ids
    obeys = vehicle.gimbal_obeys
    if obeys not in (None, ours):
        whose = "{}/{}".format(*obeys) if obeys != (0, 0) else "nobody"
        return False, f"obeys {whose}, not us ({ours[0]}/{ours[1]}): release it there"
    vehicle.look(told.gimbal_pitch_rad)
    vehicle.link.wait(lambda: not told.gimbal_is_off, GIMBAL_S)
    told_deg, looks_rad = math.degrees(told.gimbal_pitch_rad), told.reported_gimbal_pitch_rad
    if looks_rad is None:
        return None, f"ours, told {told_deg:.0f} degrees; does not report where it looks"
    said = f"looks to {math.degrees(looks_rad):.0f} degrees, told {told_deg:.0f}"
    if told.gimbal_is_off:
        return False, f"{said}: free it, or write a camera.gimbal.pitch_deg that it reaches"
    if obeys is None:
        return None, f"{said}; does not report whom it obeys"
    return True, f"ours, {said}"


def _vehicle(vehicle: Px4Vehicle) -> Verdict:
    said = vehicle.link.ask("AUTOPILOT_VERSION", 3.0)
    if said is None and not vehicle.link.is_answered:
        return False, "answers nothing: it does not hear us, or takes signed frames alone (--signing-key)"
    v = (said or {}).get("flight_sw_version")
    version = "PX4" if v is None else f"PX4 {v >> 24 & 0xFF}.{v >> 16 & 0xFF}.{v >> 8 & 0xFF}"
    return True, f"{version}, {vehicle.kind}"


def _is_ready(vehicle: Px4Vehicle) -> bool:
    health = (vehicle.link.newest("SYS_STATUS") or {}).get("onboard_control_sensors_health", 0)
    return bool(health & m.MAV_SYS_STATUS_PREARM_CHECK)


def _ready(vehicle: Px4Vehicle) -> Verdict:
    if _is_ready(vehicle):
        return True, "PX4 would arm"
    reasons = "; ".join(vehicle.arming_checks())
    return False, f"PX4 would not arm: {reasons or 'no reason given'}"


def _position(vehicle: Px4Vehicle) -> Verdict:
    std = vehicle.telemetry.position_std_m
    gps = vehicle.link.newest("GPS_RAW_INT") or {}
    fix = _FIXES.get(gps.get("fix_type", 0), "no")
    said = f"{fix} fix, {gps.get('satellites_visible', 0)} satellites, "
    said += f"within {std:.1f} m" if math.isfinite(std) else "the estimator has no position"
    return std < _MAX_STD_M, said


def _home(vehicle: Px4Vehicle) -> str:
    home = vehicle.telemetry.home or {}
    latitude, longitude = home["latitude"] * 1e-7, home["longitude"] * 1e-7
    away_m = math.dist(vehicle.home_enu_m[:2], vehicle.scenario.home.position_enu_m)
    return f"{latitude:.6f}, {longitude:.6f}, {away_m:.1f} m from the scenario's"


def _battery(vehicle: Px4Vehicle, estimate: FlightEstimate) -> Verdict:
    """One battery lasts for the plan, or the first of several is full."""
    full, limits = vehicle.telemetry.battery_remaining, vehicle.scenario.vehicle
    needed_share = estimate.energy_wh / limits.battery_wh
    needs = f"the plan without checks takes {needed_share:.0%}, {RESERVE:.0%} stay"
    if limits.batteries > 1 and needed_share > CHARGED - RESERVE:
        needed_share = CHARGED - RESERVE
        needs = f"a sortie begins with at least {CHARGED:.0%}"
    if math.isnan(full):
        estimated = vehicle.scenario.safety.battery_estimated
        cure = "write safety.battery_estimated: true to fly"
        if estimated:
            cure = "assumed to be full and estimated from then on"
        return None if estimated else False, f"does not say how full it is; {cure}; {needs}"
    return full >= needed_share + RESERVE, f"{full:.0%}; {needs}"


def _sorties(vehicle: Px4Vehicle, estimate: FlightEstimate) -> tuple[Check, ...]:
    """How many, where the plan takes more than one battery."""
    given = vehicle.scenario.vehicle.batteries
    if max(given, estimate.batteries) == 1:
        return ()
    minutes = f"{estimate.time_s / 60:.0f} min with the swaps"
    said = f"the plan without checks takes {estimate.batteries}, in {minutes}"
    disarms_s = vehicle.link.parameter("COM_DISARM_LAND") if given > 1 else None
    if disarms_s is not None and disarms_s <= 0.0:
        spin = "the motors run on after landing, while a person changes the battery; set COM_DISARM_LAND to 2"
        return (Check("sorties", False, spin),)
    if estimate.batteries > given:
        lasts = f"vehicle.batteries ({given}) last for {estimate.shares_flown[given - 1]:.0%}"
        return (Check("sorties", None, f"{said}; {lasts}: write {estimate.batteries}"),)
    return (Check("sorties", True, f"{said}; there are {given}"),)


def _mode(vehicle: Px4Vehicle) -> Verdict:
    told = vehicle.telemetry
    where = "in the air" if told.airborne else "on the ground"
    armed = "armed" if told.armed else "disarmed"
    return not (told.armed or told.airborne), f"{mode_name(told.flown)}, {armed}, {where}"


def _control(vehicle: Px4Vehicle) -> Verdict:
    """A flight continues from Hold, or if PX4 lost its program; otherwise the vehicle is somebody else's."""
    told = vehicle.telemetry
    vehicle.begins_in_air = told.airborne
    if not told.airborne:
        return True, "nobody flies it"
    if is_free(told):
        return True, f"free: in {mode_name(told.flown)}"
    return False, f"somebody flies it in {mode_name(told.flown)}; let them choose Hold"


def _low_battery(vehicle: Px4Vehicle) -> Verdict:
    action = vehicle.link.parameter("COM_LOW_BAT_ACT")
    if action is None:
        return None, "unknown: PX4 does not report COM_LOW_BAT_ACT"
    said = f"PX4 answers with {_LOW_BATTERY.get(int(action), '?')}"
    if int(action) == 0:
        return None, f"{said}: if this program ends, nothing brings it home"
    return True, said


def _link_lost(vehicle: Px4Vehicle) -> Verdict:
    action = vehicle.link.parameter("COM_OBL_RC_ACT")
    after_s = vehicle.link.parameter("COM_OF_LOSS_T")
    if action is None or after_s is None:
        return None, "unknown: PX4 does not report COM_OBL_RC_ACT"
    said = f"{_OFFBOARD_LOST.get(int(action), '?')} after {after_s:g} s"
    if int(action) in _FALLS:
        return False, f"{said}: the motors stop in the air; set COM_OBL_RC_ACT to 5 (Hold)"
    if int(action) in _WITHOUT_PILOT:
        return True, said
    pilot = "a pilot with sticks keeps it, without one it sinks and lands"
    return None, f"{said}: {pilot}; COM_OBL_RC_ACT 5 is Hold"


def _pilot(vehicle: Px4Vehicle) -> Verdict:
    if not vehicle.telemetry.manual_control:
        return None, "no sticks are heard: nobody can take over by hand"
    action = int(vehicle.link.parameter("NAV_RCL_ACT") or 0)
    said = f"sticks are heard; when they are lost: {_STICKS_LOST.get(action, '?')}"
    if action in _STICKS_LOST_FALLS:
        return False, f"{said}: the motors stop in the air; set NAV_RCL_ACT to 2 (Return)"
    return True, said


def _return_altitude(vehicle: Px4Vehicle, clear_m: float) -> Verdict:
    altitude_m = vehicle.link.parameter("RTL_RETURN_ALT")
    if altitude_m is None:
        return None, "unknown: PX4 does not report RTL_RETURN_ALT"
    said = f"PX4 returns {altitude_m:g} m above home"
    if altitude_m < clear_m:
        return False, f"{said}, too low for the way home; set RTL_RETURN_ALT to {math.ceil(clear_m)}"
    return True, said


def _own_fence(vehicle: Px4Vehicle, demands: Demands) -> Verdict:
    """The vehicle's own limits around home (GF_MAX_*), which apply besides the uploaded fence."""
    limits = {
        "GF_MAX_HOR_DIST": demands.farthest_m + _FENCE_SLACK_M,
        "GF_MAX_VER_DIST": demands.highest_m + _FENCE_SLACK_M,
    }
    said = []
    for name, needed_m in limits.items():
        limit_m = vehicle.link.parameter(name)
        if limit_m is not None and 0.0 < limit_m < needed_m:
            text = f"{name} is {limit_m:g} m, the flight needs {math.ceil(needed_m)}"
            return False, f"{text}; raise it, or search a smaller area"
        said.append(f"{name} " + {None: "unknown", 0.0: "off"}.get(limit_m, f"{limit_m or 0.0:g} m"))
    return True, ", ".join(said)


def _speed(vehicle: Px4Vehicle) -> Verdict:
    limit, wanted = vehicle.link.parameter("MPC_XY_VEL_MAX"), vehicle.scenario.search.scan_speed_mps
    if limit is None or limit >= wanted:
        return True, f"scan at {wanted:g} m/s"
    return None, f"MPC_XY_VEL_MAX is {limit:g} m/s, the scan wants {wanted:g}"


def _fence_and_rally(vehicle: Px4Vehicle, plan: QgcPlan, upload: bool) -> tuple[Check, Check]:
    has_fence = bool(plan.geoFence.polygons or plan.geoFence.circles)
    action = vehicle.link.parameter("GF_ACTION")
    then = "" if action is None else f"; crossing it: {_FENCE_ACTIONS.get(int(action), '?')}"
    n_fence, n_rally = upload_fence_and_rally(vehicle.link, plan) if upload else (0, 0)
    if not has_fence:
        fence = Check("fence", None, "none in the plan; the vehicle keeps its own")
    else:
        said = f"{n_fence} corners uploaded and read back" if n_fence else "not uploaded"
        fence = Check("fence", None if action in _NO_FENCE else True, said + then)
    n = len(plan.rallyPoints.points)
    said = f"{n_rally} uploaded" if n_rally else f"{n or 'none'} in the plan"
    return fence, Check("rally points", True, said)
