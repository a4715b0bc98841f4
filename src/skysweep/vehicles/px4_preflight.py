"""What is looked at before a PX4 is armed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skysweep.planning.flight_plan import RESERVE
from skysweep.planning.qgc import QgcPlan
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.px4 import Px4Vehicle
from skysweep.vehicles.px4_fence import upload_fence_and_rally

GIMBAL_S = 5.0  # on the wall, until it looks where it was told
READY_S = 30.0  # on the wall, for the estimator and PX4's own checks
_MAX_STD_M = 5.0
_FIXES = {2: "2D", 3: "3D", 4: "DGPS", 5: "RTK float", 6: "RTK fixed"}
_OFFBOARD_LOST = {0: "Position", 1: "Altitude", 2: "Manual", 3: "Return", 4: "Land", 5: "Hold"}
_WITHOUT_PILOT = (3, 4, 5)
_FENCE_ACTIONS = {0: "nothing", 1: "a warning", 2: "Hold", 3: "Return", 4: "Terminate", 5: "Land"}


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the list. ``passed`` is None for what does not hold up the flight but should be known."""

    name: str
    passed: bool | None
    said: str


def preflight(
    vehicle: Px4Vehicle, plan: QgcPlan, needed_share: float, upload: bool, ready_s: float = READY_S
) -> tuple[Check, ...]:
    """The list for a flight that needs a share of a full battery. Waits ``ready_s`` for the vehicle.

    ``upload``: have it stand by in Hold, and send the plan's fence and rally points when nothing else speaks
    against the flight. Without, only the gimbal is moved.
    """
    told = vehicle.telemetry
    if upload:
        vehicle.stand_by()
    vehicle.link.wait(lambda: _is_ready(vehicle) and told.position_std_m < _MAX_STD_M, ready_s)
    checks = [
        Check("vehicle", True, f"{_version(vehicle)}, {vehicle.kind}"),
        _position(vehicle),
        _home(vehicle),
        _battery(vehicle, needed_share),
        _mode(vehicle),
        Check("ready", _is_ready(vehicle), "PX4 would arm" if _is_ready(vehicle) else "PX4 would not arm"),
        _offboard_lost(vehicle),
        _speed(vehicle),
        _gimbal(vehicle),
    ]
    blocked = any(check.passed is False for check in checks)
    return (*checks, *_fence_and_rally(vehicle, plan, upload and not blocked))


def _gimbal(vehicle: Px4Vehicle) -> Check:
    if not vehicle.gimbal:
        return Check("gimbal", True, "none: the camera is taken to look as told")
    told, ours = vehicle.telemetry, vehicle.link.own_ids
    obeys = vehicle.gimbal_obeys
    if obeys not in (None, ours):
        whose = "{}/{}".format(*obeys) if obeys != (0, 0) else "nobody"
        return Check("gimbal", False, f"obeys {whose}, not us ({ours[0]}/{ours[1]}): have that let go of it")
    vehicle.look(told.gimbal_pitch_rad)
    vehicle.link.wait(lambda: not told.gimbal_is_off, GIMBAL_S)
    told_deg, looks_rad = math.degrees(told.gimbal_pitch_rad), told.reported_gimbal_pitch_rad
    if looks_rad is None:
        return Check(
            "gimbal", None, f"ours, told to look to {told_deg:.0f} degrees; does not say where it looks"
        )
    said = f"looks to {math.degrees(looks_rad):.0f} degrees, told {told_deg:.0f}"
    if told.gimbal_is_off:
        return Check("gimbal", False, f"{said}: free it, or write a camera.gimbal.pitch_deg that it reaches")
    if obeys is None:
        return Check("gimbal", None, f"{said}; does not say whom it obeys")
    return Check("gimbal", True, f"ours, {said}")


def _version(vehicle: Px4Vehicle) -> str:
    said = vehicle.link.ask("AUTOPILOT_VERSION", 3.0)
    if said is None:
        return "PX4"
    v = said["flight_sw_version"]
    return f"PX4 {v >> 24 & 0xFF}.{v >> 16 & 0xFF}.{v >> 8 & 0xFF}"


def _is_ready(vehicle: Px4Vehicle) -> bool:
    health = (vehicle.link.newest("SYS_STATUS") or {}).get("onboard_control_sensors_health", 0)
    return bool(health & m.MAV_SYS_STATUS_PREARM_CHECK)


def _position(vehicle: Px4Vehicle) -> Check:
    std = vehicle.telemetry.position_std_m
    gps = vehicle.link.newest("GPS_RAW_INT") or {}
    fix = _FIXES.get(gps.get("fix_type", 0), "no")
    said = f"{fix} fix, {gps.get('satellites_visible', 0)} satellites, "
    said += f"within {std:.1f} m" if math.isfinite(std) else "the estimator has no position"
    return Check("position", std < _MAX_STD_M, said)


def _home(vehicle: Px4Vehicle) -> Check:
    home = vehicle.telemetry.home or {}
    latitude, longitude = home["latitude"] * 1e-7, home["longitude"] * 1e-7
    away_m = math.dist(vehicle.anchor.home_enu_m[:2], vehicle.scenario.home.position_enu_m)
    return Check("home", True, f"{latitude:.6f}, {longitude:.6f}, {away_m:.1f} m from the scenario's")


def _battery(vehicle: Px4Vehicle, needed_share: float) -> Check:
    full = vehicle.telemetry.battery_remaining
    enough = full >= needed_share + RESERVE
    said = f"{full:.0%}; the plan without checks takes {needed_share:.0%}, {RESERVE:.0%} stay"
    return Check("battery", enough, said)


def _mode(vehicle: Px4Vehicle) -> Check:
    told = vehicle.telemetry
    mode = told.mode.name.title() if told.mode else "a mode with sticks"
    where = "in the air" if told.airborne else "on the ground"
    armed = "armed" if told.armed else "disarmed"
    return Check("mode", not (told.armed or told.airborne), f"{mode}, {armed}, {where}")


def _offboard_lost(vehicle: Px4Vehicle) -> Check:
    action, after_s = vehicle.link.parameter("COM_OBL_RC_ACT"), vehicle.link.parameter("COM_OF_LOSS_T")
    if action is None or after_s is None:
        return Check("if we fall silent", None, "unknown: PX4 does not say COM_OBL_RC_ACT")
    said = f"{_OFFBOARD_LOST.get(int(action), '?')} after {after_s:g} s"
    if int(action) in _WITHOUT_PILOT:
        return Check("if we fall silent", True, said)
    return Check("if we fall silent", None, f"{said}: wants a pilot with sticks; COM_OBL_RC_ACT 5 is Hold")


def _speed(vehicle: Px4Vehicle) -> Check:
    limit, wanted = vehicle.link.parameter("MPC_XY_VEL_MAX"), vehicle.scenario.search.scan_speed_mps
    if limit is None or limit >= wanted:
        return Check("speed", True, f"scan at {wanted:g} m/s")
    return Check("speed", None, f"MPC_XY_VEL_MAX is {limit:g} m/s, the scan wants {wanted:g}")


def _fence_and_rally(vehicle: Px4Vehicle, plan: QgcPlan, upload: bool) -> tuple[Check, Check]:
    has_fence = bool(plan.geoFence.polygons or plan.geoFence.circles)
    action = vehicle.link.parameter("GF_ACTION") if has_fence else None
    then = "" if action is None else f"; crossing it: {_FENCE_ACTIONS.get(int(action), '?')}"
    n_fence, n_rally = upload_fence_and_rally(vehicle.link, plan) if upload else (0, 0)
    if not has_fence:
        fence = Check("fence", None, "none in the plan; the vehicle keeps its own")
    else:
        said = f"{n_fence} corners uploaded and read back" if n_fence else "not uploaded"
        fence = Check("fence", True, said + then)
    n = len(plan.rallyPoints.points)
    said = f"{n_rally} uploaded" if n_rally else f"{n or 'none'} in the plan"
    return fence, Check("rally points", True, said)
