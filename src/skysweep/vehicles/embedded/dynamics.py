"""One compiled 250 Hz step of the multirotor: PX4's control cascade, the airframe, the gimbal, the air.

The simulation consists of the records ``x`` (STATE, variable) and ``q`` (PARAMETERS, constant) and of
``rng`` (1,) uint64. Functions called from outside take the records as arrays of their floats, which pass into
compiled code at a third of the cost. ENU metres and FLU body throughout; quaternions are (w, x, y, z).

Sources. Control: PX4 v1.17 PositionControl and AttitudeControl (user guide, "Controller diagrams"; the
constants carry the parameters' names), after Brescianini, Hehn & D'Andrea, "Nonlinear quadrocopter
attitude control" (ETH 2013). Airframe: PX4 SIH (simulator_sih). Air: MIL-HDBK-1797, low-altitude Dryden
lengths, with first-order spectra.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.types import F64

U64 = NDArray[np.uint64]
Quaternion = tuple[float, float, float, float]
Entries = tuple[float, ...]
Record = Any  # of STATE or PARAMETERS

STEP_S = 0.004
NOISE_STEPS = 5  # gusts and estimation errors change at 50 Hz

# Everything is a float, so that a snapshot is one list.
STATE = np.dtype(
    [
        ("steps", float),  # simulated so far
        ("mode", float),
        ("airborne", float),
        ("position", float, 3),  # true
        ("velocity", float, 3),
        ("attitude", float, 4),  # body -> ENU
        ("rates", float, 3),  # body, rad/s
        ("angular_acceleration", float, 3),  # body, produced by the motors
        ("thrust", float),  # m/s2 along body z
        ("velocity_integral", float, 3),
        ("velocity_slope", float, 3),  # filtered derivative of the estimated velocity
        ("last_velocity", float, 3),  # estimated
        ("gust", float, 3),
        ("position_error", float, 3),  # estimated minus true
        ("velocity_error", float, 3),
        ("attitude_error", float, 3),  # rotation vector in ENU, estimated minus true
        ("camera", float, 4),  # camera optical -> ENU, true
        ("camera_rates", float, 3),  # ENU, rad/s
        ("gimbal_pitch", float),  # rad above the horizon, that the gimbal holds or passes
        ("believed_yaw", float),
        ("energy_wh", float),
        ("target_position", float, 3),
        ("target_velocity", float, 3),  # feed-forward
        ("target_speed", float),
        ("target_yaw", float),
        ("mode_time", float),  # seconds since the mode began
        ("contact_time", float),  # seconds on the ground while landing
        ("ground_height", float),  # below the vehicle
        ("lean_error", float, 2),  # of the up axis, east and north, estimated minus true
    ]
)

PARAMETERS = np.dtype(
    [
        ("drag_per_mass", float),  # 1/s
        ("climb_speed", float),
        ("descent_speed", float),
        ("wind", float, 3),  # mean, ENU
        ("gust_std", float),  # horizontal, per axis
        ("position_std", float),
        ("attitude_std", float),  # rad
        ("gimbal_goal", float),  # commanded pitch, rad above the horizon
        ("gimbal_rate", float),  # rad/s
        ("gimbal_lag", float),  # s
        ("hover_power", float),  # W
    ]
)

# ---- modes -------------------------------------------------------------------------------------------
ON_GROUND, TAKEOFF, OFFBOARD, LAND = 0.0, 1.0, 2.0, 3.0

# ---- PX4 parameters ----------------------------------------------------------------------------------
G = 9.80665
MPC_XY_VEL_MAX = 12.0
MPC_XY_P, MPC_Z_P = 0.95, 1.0
MPC_XY_VEL_P, MPC_XY_VEL_I, MPC_XY_VEL_D = 1.8, 0.4, 0.2
MPC_Z_VEL_P, MPC_Z_VEL_I = 4.0, 2.0
MPC_VELD_LP_S = 1.0 / (2.0 * math.pi * 5.0)
SLOPE_MAX = math.tan(math.radians(45.0))  # MPC_TILTMAX_AIR
MPC_TKO_SPEED, MPC_TKO_RAMP_T, SPOOLUP_S = 1.5, 3.0, 1.0
MPC_LAND_SPEED, MPC_LAND_ALT1, MPC_LAND_ALT2 = 0.7, 10.0, 5.0
TAKEOFF_Z_P = 0.4  # identified: PX4's automatic take-off ends more gently than an offboard climb
THRUST_MIN, THRUST_MAX, THRUST_XY_MARGIN = 0.12 * 20.0, 20.0, 0.3 * 20.0  # m/s2 (SIH: 20 N, 1 kg)
# Identified from six logged steps (docs/vehicle.md); here PX4's default of 6.5 tilts 15 % too far.
TILT_P = 4.5
MC_YAW_P, MC_YAW_WEIGHT = 2.8, 0.4
MC_TILT_RATE_MAX, MC_YAW_RATE_MAX = math.radians(220.0), math.radians(200.0)

# Rate loop: gain x motor torque / inertia of the SIH airframe, 1/s; limits of the motors, rad/s2.
RATE_GAIN_TILT, RATE_GAIN_YAW = 17.0, 2.7
RATE_DAMPING_TILT = 0.34
ANGULAR_ACCELERATION_MAX_TILT, ANGULAR_ACCELERATION_MAX_YAW = 60.0, 6.6
ROTATION_DRAG = 1.0  # SIH_KDW / SIH_IXX, 1/s
MOTOR_BLEND = 1.0 - math.exp(-STEP_S / 0.05)  # SIH_T_TAU
SLOPE_BLEND = 1.0 - math.exp(-STEP_S / MPC_VELD_LP_S)

# ---- other constants ---------------------------------------------------------------------------------
DRAG_PER_MASS = 1.0  # SIH_KDV / SIH_MASS, 1/s
LEG_HEIGHT_M = 0.25  # of the body origin above ground when landed
CAMERA_BELOW_M = 0.1
POINTING_SHARE = 0.5  # of the gimbal's rate
AVIONICS_W = 10.0
LANDED_AFTER_S = 1.0
GIVES_M = 0.05  # how far a slope may fall away below a vehicle that stands on it in the wind
POSITION_ERROR_TIME_S = 30.0
VERTICAL_POSITION_ERROR = 0.5  # of the horizontal one: the barometer helps
ATTITUDE_ERROR_TIME_S = 0.2
FOOT_M = 0.3048


_inlined = njit(cache=True, error_model="numpy", inline="always")  # 5 % faster than calls


@njit(cache=True, inline="always")
def _uniform(rng: U64) -> float:
    """SplitMix64 (Steele, Lea & Flood 2014) in (0, 1]."""
    rng[0] += np.uint64(0x9E3779B97F4A7C15)
    z = rng[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return (float(z >> np.uint64(11)) + 1.0) * 2.0**-53


@njit(cache=True, error_model="numpy")
def _normal(rng: U64) -> float:
    """Standard normal (Box-Muller)."""
    return math.sqrt(-2.0 * math.log(_uniform(rng))) * math.cos(2.0 * math.pi * _uniform(rng))


@_inlined
def _multiply(a: Entries, b: Entries) -> Quaternion:
    """Hamilton product of two quaternions."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@_inlined
def _turn(vx: float, vy: float, vz: float) -> Quaternion:
    """Quaternion of a rotation vector; short ones by Taylor series, exact to the last bit of a double."""
    square = 0.25 * (vx * vx + vy * vy + vz * vz)
    if square < 1e-3:
        cosine = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)))
        k = 0.5 * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)))
    else:
        half = math.sqrt(square)
        cosine, k = math.cos(half), 0.5 * math.sin(half) / half
    return cosine, k * vx, k * vy, k * vz


@_inlined
def _entries(quaternion: F64) -> Quaternion:
    return quaternion[0], quaternion[1], quaternion[2], quaternion[3]


@_inlined
def _set_unit(out: F64, quaternion: Entries) -> None:
    a, b, c, d = quaternion
    n = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    out[0], out[1], out[2], out[3] = a * n, b * n, c * n, d * n


@_inlined
def _rotation(a: Entries) -> Entries:
    """The nine entries of a quaternion's rotation matrix, row by row."""
    w, i, j, k = a[0], a[1], a[2], a[3]
    return (
        1.0 - 2.0 * (j * j + k * k),
        2.0 * (i * j - w * k),
        2.0 * (i * k + w * j),
        2.0 * (i * j + w * k),
        1.0 - 2.0 * (i * i + k * k),
        2.0 * (j * k - w * i),
        2.0 * (i * k - w * j),
        2.0 * (j * k + w * i),
        1.0 - 2.0 * (i * i + j * j),
    )


@_inlined
def _wrap(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@_inlined
def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@_inlined
def camera_quaternion(yaw_rad: float, pitch_rad: float) -> Quaternion:
    """Camera optical -> ENU for a level picture (geometry.frames.rotation_camera_to_enu)."""
    body = _multiply(
        (math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)),
        (math.cos(0.5 * pitch_rad), 0.0, -math.sin(0.5 * pitch_rad), 0.0),
    )
    return _multiply(body, (0.5, -0.5, 0.5, -0.5))


@njit(cache=True, error_model="numpy")
def start(state: F64, rng: U64, parameters: F64) -> None:
    """Draws the slow errors from their stationary distributions and points the camera."""
    x, q = state.view(STATE)[0], parameters.view(PARAMETERS)[0]
    std = q.position_std
    for i in range(3):
        share = VERTICAL_POSITION_ERROR if i == 2 else 1.0
        x.position_error[i] = std * share * _normal(rng)
        x.velocity_error[i] = std * share * 2.0 / POSITION_ERROR_TIME_S * _normal(rng)
    _believe_yaw(x)
    x.gimbal_pitch = q.gimbal_goal
    _set_unit(x.camera, camera_quaternion(x.believed_yaw, x.gimbal_pitch))


@njit(cache=True, error_model="numpy")
def _move_air_and_errors(x: Record, rng: U64, q: Record) -> None:
    """Gauss-Markov steps of the gusts (first order), GNSS (second order) and attitude errors (first)."""
    dt = STEP_S * NOISE_STEPS

    feet = max((x.position[2] - x.ground_height) / FOOT_M, 10.0)
    shape = 0.177 + 0.000823 * min(feet, 1000.0)
    airspeed = 1.0
    for i in range(3):
        airspeed += (x.velocity[i] - q.wind[i]) ** 2
    airspeed = math.sqrt(airspeed)
    keep = math.exp(-dt * airspeed / (FOOT_M * feet / shape**1.2))
    fresh = q.gust_std * math.sqrt(1.0 - keep * keep)
    x.gust[0] = keep * x.gust[0] + fresh * _normal(rng)
    x.gust[1] = keep * x.gust[1] + fresh * _normal(rng)
    keep = math.exp(-dt * airspeed / (FOOT_M * feet))
    fresh = q.gust_std * shape**0.4 * math.sqrt(1.0 - keep * keep)
    x.gust[2] = keep * x.gust[2] + fresh * _normal(rng)

    w = 2.0 / POSITION_ERROR_TIME_S
    for i in range(3):
        draw = _normal(rng)  # even if unused, so that the gusts do not depend on the errors
        if q.position_std > 0.0:
            std = q.position_std * (VERTICAL_POSITION_ERROR if i == 2 else 1.0)
            push = 2.0 * w * std * math.sqrt(w * dt) * draw
            x.velocity_error[i] += -dt * (w * w * x.position_error[i] + 2.0 * w * x.velocity_error[i]) + push
            x.position_error[i] += dt * x.velocity_error[i]

    keep = math.exp(-dt / ATTITUDE_ERROR_TIME_S)
    for i in range(3):
        fresh = q.attitude_std * math.sqrt(1.0 - keep * keep) * _normal(rng)
        x.attitude_error[i] = keep * x.attitude_error[i] + fresh


@_inlined
def _vertical_limits(x: Record, q: Record) -> tuple[float, float]:
    """Largest climb and descent rates now, m/s, both positive; a negative climb keeps it on the ground."""
    agl = x.position[2] - x.ground_height
    up, down = q.climb_speed, q.descent_speed
    if x.mode == TAKEOFF:
        if agl < MPC_LAND_ALT1:
            up = min(up, MPC_TKO_SPEED)
        ramp = _clip((x.mode_time - SPOOLUP_S) / MPC_TKO_RAMP_T, 0.0, 1.0)
        held = -G / MPC_Z_VEL_P
        up = min(up, held + ramp * (up - held))
    elif x.mode == LAND:
        low = min(MPC_LAND_SPEED, down)
        share = _clip((agl - MPC_LAND_ALT2) / (MPC_LAND_ALT1 - MPC_LAND_ALT2), 0.0, 1.0)
        down = low + share * (down - low)
    return up, down


@_inlined
def _limited_xy(px: float, py: float, fx: float, fy: float, limit: float) -> tuple[float, float]:
    """The sum p + f, limited in length: the feed-forward f is cut before the position part p."""
    if math.hypot(px + fx, py + fy) <= limit:
        return px + fx, py + fy
    p, f = math.hypot(px, py), math.hypot(fx, fy)
    if p >= limit or f < 1e-3:
        return px / p * limit, py / p * limit
    ux, uy = fx / f, fy / f
    m = ux * px + uy * py
    s = -m + math.sqrt(m * m - p * p + limit * limit)
    return px + s * ux, py + s * uy


@_inlined
def _velocity_setpoint(x: Record, q: Record) -> tuple[float, float, float]:
    ex = x.target_position[0] - x.position[0] - x.position_error[0]
    ey = x.target_position[1] - x.position[1] - x.position_error[1]
    ez = x.target_position[2] - x.position[2] - x.position_error[2]
    vx, vy = _limited_xy(
        MPC_XY_P * ex, MPC_XY_P * ey, x.target_velocity[0], x.target_velocity[1], x.target_speed
    )
    up, down = _vertical_limits(x, q)
    if x.mode == LAND:
        vz = -down
    else:
        vz = (TAKEOFF_Z_P if x.mode == TAKEOFF else MPC_Z_P) * ez + x.target_velocity[2]
    return vx, vy, min(max(vz, -down), up)


@_inlined
def _thrust_setpoint(x: Record, q: Record) -> tuple[float, float, float]:
    """Velocity PID with tracking anti-windup, tilt and thrust limits: specific thrust (3,) ENU, m/s2.

    It is rotated by the lean error, because the attitude loop turns the body by its wrong estimate.
    """
    vx, vy, vz = _velocity_setpoint(x, q)
    bx = x.velocity[0] + x.velocity_error[0]
    by = x.velocity[1] + x.velocity_error[1]
    bz = x.velocity[2] + x.velocity_error[2]
    for i, b in enumerate((bx, by, bz)):
        gradient = (b - x.last_velocity[i]) / STEP_S
        x.velocity_slope[i] += SLOPE_BLEND * (gradient - x.velocity_slope[i])
        x.last_velocity[i] = b
    ex, ey, ez = vx - bx, vy - by, vz - bz
    ax = MPC_XY_VEL_P * ex + x.velocity_integral[0] - MPC_XY_VEL_D * x.velocity_slope[0]
    ay = MPC_XY_VEL_P * ey + x.velocity_integral[1] - MPC_XY_VEL_D * x.velocity_slope[1]
    az = MPC_Z_VEL_P * ez + x.velocity_integral[2]

    # Decoupled: the tilt follows from the horizontal demand against gravity alone.
    a_xy = math.hypot(ax, ay)
    slope = min(a_xy / G, SLOPE_MAX)
    lift = max(az + G, THRUST_MIN / math.sqrt(1.0 + slope * slope))
    if (lift <= THRUST_MIN and ez <= 0.0) or (lift >= THRUST_MAX and ez >= 0.0):
        ez = 0.0
    side = lift * slope
    lift = min(lift, math.sqrt(THRUST_MAX**2 - min(side, THRUST_XY_MARGIN) ** 2))
    side = min(side, math.sqrt(THRUST_MAX**2 - lift**2))
    share = side / a_xy if a_xy > 1e-9 else 1.0
    tx, ty = ax * share, ay * share
    if share < 1.0:
        ex -= 2.0 / MPC_XY_VEL_P * (ax - tx)
        ey -= 2.0 / MPC_XY_VEL_P * (ay - ty)
    x.velocity_integral[0] += MPC_XY_VEL_I * ex * STEP_S
    x.velocity_integral[1] += MPC_XY_VEL_I * ey * STEP_S
    x.velocity_integral[2] = _clip(x.velocity_integral[2] + MPC_Z_VEL_I * ez * STEP_S, -G, G)
    lx, ly = x.lean_error[0], x.lean_error[1]
    return tx - lx * lift, ty - ly * lift, lift + lx * tx + ly * ty


@_inlined
def _turn_towards(x: Record, R: Entries, tx: float, ty: float, tz: float) -> float:
    """Attitude P (tilt first, yaw with less weight), rate loop and motor lag. Updates rates and attitude."""
    T = math.sqrt(tx * tx + ty * ty + tz * tz)
    dx = (R[0] * tx + R[3] * ty + R[6] * tz) / T
    dy = (R[1] * tx + R[4] * ty + R[7] * tz) / T
    dz = (R[2] * tx + R[5] * ty + R[8] * tz) / T
    k = TILT_P / math.sqrt(max(0.5 * (1.0 + dz), 1e-6))
    yaw_error = _wrap(x.target_yaw - math.atan2(R[3], R[0]))
    yaw_rate = MC_YAW_P * 2.0 * math.sin(0.5 * MC_YAW_WEIGHT * yaw_error) / MC_YAW_WEIGHT
    wanted = (
        _clip(-k * dy, -MC_TILT_RATE_MAX, MC_TILT_RATE_MAX),
        _clip(k * dx, -MC_TILT_RATE_MAX, MC_TILT_RATE_MAX),
        _clip(yaw_rate, -MC_YAW_RATE_MAX, MC_YAW_RATE_MAX),
    )
    for i in range(3):
        rate = x.rates[i]
        produced = x.angular_acceleration[i]
        net = produced - ROTATION_DRAG * rate
        if i < 2:
            push = RATE_GAIN_TILT * (wanted[i] - rate) - RATE_DAMPING_TILT * net
            push = _clip(push, -ANGULAR_ACCELERATION_MAX_TILT, ANGULAR_ACCELERATION_MAX_TILT)
        else:
            push = RATE_GAIN_YAW * (wanted[i] - rate)
            push = _clip(push, -ANGULAR_ACCELERATION_MAX_YAW, ANGULAR_ACCELERATION_MAX_YAW)
        x.angular_acceleration[i] = produced + MOTOR_BLEND * (push - produced)
        x.rates[i] = rate + net * STEP_S
    step = _turn(x.rates[0] * STEP_S, x.rates[1] * STEP_S, x.rates[2] * STEP_S)
    _set_unit(x.attitude, _multiply(_entries(x.attitude), step))
    return T


@_inlined
def _move_body(x: Record, q: Record, R: Entries) -> None:
    """Thrust, linear drag against the air, gravity, and the ground."""
    along = (R[2], R[5], R[8])
    for i in range(3):
        air = q.wind[i] + x.gust[i]
        force = x.thrust * along[i] - q.drag_per_mass * (x.velocity[i] - air)
        x.velocity[i] += (force - (G if i == 2 else 0.0)) * STEP_S
        x.position[i] += x.velocity[i] * STEP_S
    floor = x.ground_height + LEG_HEIGHT_M
    stands = x.mode == LAND and x.contact_time > 0.0
    if x.position[2] <= floor + (GIVES_M if stands else 0.0):
        x.position[2] = floor
        _stand(x, R)
        x.contact_time += STEP_S
    else:
        x.airborne = 1.0
        x.contact_time = 0.0


@njit(cache=True, error_model="numpy")
def _stand(x: Record, R: Entries) -> None:
    """Level and still, with the same heading."""
    yaw = math.atan2(R[3], R[0])
    _set_unit(x.attitude, (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)))
    for i in range(3):
        x.rates[i] = x.angular_acceleration[i] = 0.0
        x.velocity[i] = x.velocity_integral[i] = x.velocity_slope[i] = 0.0


@_inlined
def _believe_yaw(x: Record) -> None:
    R = _rotation(_entries(x.attitude))
    east = R[0] + x.attitude_error[1] * R[6] - x.attitude_error[2] * R[3]
    north = R[3] + x.attitude_error[2] * R[0] - x.attitude_error[0] * R[6]
    x.believed_yaw = math.atan2(north, east)


@_inlined
def _move_gimbal(x: Record, R: Entries, goal: float, rate_max: float, gain: float) -> None:
    """The body carries the camera; the joints turn it back with a first-order lag and a rate limit.

    A new pitch is approached at a share of that rate, because stabilising needs the rest.
    """
    _believe_yaw(x)
    step_max = POINTING_SHARE * rate_max * STEP_S
    x.gimbal_pitch += _clip(goal - x.gimbal_pitch, -step_max, step_max)
    e = _turn(-x.attitude_error[0], -x.attitude_error[1], -x.attitude_error[2])
    wanted = _multiply(e, camera_quaternion(x.believed_yaw, x.gimbal_pitch))
    camera = _entries(x.camera)
    error = _multiply(wanted, (camera[0], -camera[1], -camera[2], -camera[3]))
    sine = math.sqrt(error[1] ** 2 + error[2] ** 2 + error[3] ** 2)
    angle = 2.0 * math.atan2(sine, abs(error[0]))
    joint_rate = min(angle * gain, rate_max)
    k = math.copysign(joint_rate / sine, error[0]) if sine > 1e-12 else 0.0
    for i in range(3):
        carried = R[3 * i] * x.rates[0] + R[3 * i + 1] * x.rates[1] + R[3 * i + 2] * x.rates[2]
        x.camera_rates[i] = carried + k * error[1 + i]
    step = _turn(x.camera_rates[0] * STEP_S, x.camera_rates[1] * STEP_S, x.camera_rates[2] * STEP_S)
    _set_unit(x.camera, _multiply(step, camera))


@njit(cache=True, error_model="numpy")
def fly(state: F64, rng: U64, parameters: F64, steps: int, out: F64) -> None:
    """Advances the simulation by ``steps`` of STEP_S and writes the ``poses`` then."""
    x, q = state.view(STATE)[0], parameters.view(PARAMETERS)[0]
    goal, rate_max = q.gimbal_goal, q.gimbal_rate
    gain = (1.0 - math.exp(-STEP_S / max(q.gimbal_lag, 1e-6))) / STEP_S
    for _ in range(steps):
        if int(x.steps) % NOISE_STEPS == 0:
            _move_air_and_errors(x, rng, q)
        x.steps += 1.0
        x.mode_time += STEP_S
        R = _rotation(_entries(x.attitude))
        power = AVIONICS_W
        if x.mode != ON_GROUND:
            tx, ty, tz = _thrust_setpoint(x, q)
            thrust = _turn_towards(x, R, tx, ty, tz)
            x.thrust += MOTOR_BLEND * (thrust - x.thrust)
            _move_body(x, q, R)
            load = x.thrust / G
            power += q.hover_power * load * math.sqrt(load)
            if x.mode == LAND and x.contact_time >= LANDED_AFTER_S:
                x.mode = ON_GROUND
                x.airborne = 0.0
                x.thrust = 0.0
        _move_gimbal(x, R, goal, rate_max, gain)
        x.energy_wh += power * STEP_S / 3600.0
    poses(state, out)


@njit(cache=True, error_model="numpy")
def poses(state: F64, out: F64) -> None:
    """Estimated and true poses, as rows of 3 in ``out`` (19, 3).

    Estimated: 0 position, 1 velocity, 2-4 R_body_to_enu, 5 camera position, 6-8 R_camera_to_enu.
    True: 9-11 R_body_to_enu, 12 camera position, 13-15 R_camera_to_enu, 16 camera velocity in camera axes,
    17 camera rates in camera axes. Both: 18 time, energy, whether it is airborne.
    """
    x = state.view(STATE)[0]
    e = _turn(x.attitude_error[0], x.attitude_error[1], x.attitude_error[2])
    attitude = _entries(x.attitude)
    B = _rotation(_multiply(e, attitude))
    C = _rotation(camera_quaternion(x.believed_yaw, x.gimbal_pitch))
    R = _rotation(attitude)
    K = _rotation(_entries(x.camera))
    wx, wy = x.rates[0], x.rates[1]
    for i in range(3):
        out[0, i] = x.position[i] + x.position_error[i]
        out[1, i] = x.velocity[i] + x.velocity_error[i]
        out[5, i] = out[0, i] - CAMERA_BELOW_M * B[3 * i + 2]
        out[12, i] = x.position[i] - CAMERA_BELOW_M * R[3 * i + 2]
        for j in range(3):
            out[2 + i, j] = B[3 * i + j]
            out[6 + i, j] = C[3 * i + j]
            out[9 + i, j] = R[3 * i + j]
            out[13 + i, j] = K[3 * i + j]
    out[18, 0], out[18, 1], out[18, 2] = x.steps * STEP_S, x.energy_wh, x.airborne
    for j in range(3):
        out[16, j] = 0.0
        out[17, j] = 0.0
        for i in range(3):
            # rates x (0, 0, -CAMERA_BELOW_M), rotated to ENU
            swing = CAMERA_BELOW_M * (-R[3 * i] * wy + R[3 * i + 1] * wx)
            out[16, j] += K[3 * i + j] * (x.velocity[i] + swing)
            out[17, j] += K[3 * i + j] * x.camera_rates[i]
