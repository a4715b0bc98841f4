"""One compiled 250 Hz step of the multirotor: PX4's control cascade, the airframe, the gimbal, the air.

The whole simulation is three flat arrays, so that a call costs nothing and a snapshot is two lists:
``x`` (N_STATE,) what changes, ``q`` (N_PARAMETERS,) what does not, ``rng`` (1,) uint64. The constants
below name their places. ENU metres and FLU body throughout; quaternions are (w, x, y, z).

Sources. Control: PX4 v1.17 PositionControl and AttitudeControl (user guide, "Controller diagrams"; the
constants carry the parameters' names), after Brescianini, Hehn & D'Andrea, "Nonlinear quadrocopter
attitude control" (ETH 2013). Airframe: PX4 SIH (simulator_sih). Air: MIL-HDBK-1797, low-altitude Dryden
lengths, with first-order spectra.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

F64 = NDArray[np.float64]
U64 = NDArray[np.uint64]
Quaternion = tuple[float, float, float, float]
Entries = tuple[float, ...]

STEP_S = 0.004
NOISE_STEPS = 5  # gusts and estimation errors move at 50 Hz

# ---- places in x -------------------------------------------------------------------------------------
STEPS = 0  # steps flown
MODE = 1
AIRBORNE = 2
POSITION = 3  # (3,) true
VELOCITY = 6  # (3,)
ATTITUDE = 9  # (4,) body -> ENU
RATES = 13  # (3,) body, rad/s
ANGULAR_ACCELERATION = 16  # (3,) body, that the motors produce
THRUST = 19  # m/s2 along body z
VELOCITY_INTEGRAL = 20  # (3,)
VELOCITY_SLOPE = 23  # (3,) filtered derivative of the believed velocity
LAST_VELOCITY = 26  # (3,) believed
GUST = 29  # (3,)
POSITION_ERROR = 32  # (3,) believed minus true
VELOCITY_ERROR = 35  # (3,)
ATTITUDE_ERROR = 38  # (3,) rotation vector in ENU, believed minus true
CAMERA = 41  # (4,) camera optical -> ENU, true
CAMERA_RATES = 45  # (3,) ENU, rad/s
BELIEVED_YAW = 48
ENERGY_WH = 49
TARGET_POSITION = 50  # (3,)
TARGET_VELOCITY = 53  # (3,) feed-forward
TARGET_SPEED = 56
TARGET_YAW = 57
MODE_TIME = 58  # seconds since the mode began
CONTACT_TIME = 59  # seconds on the ground while landing
GROUND_HEIGHT = 60  # below the vehicle
LEAN_ERROR = 61  # (2,) how much farther east and north it takes its up axis to lean than it does
N_STATE = 63

# ---- places in q -------------------------------------------------------------------------------------
DRAG_PER_MASS = 0  # 1/s
CLIMB_SPEED = 1
DESCENT_SPEED = 2
WIND = 3  # (3,) mean, ENU
GUST_STD = 6  # horizontal, per axis
POSITION_STD = 7
ATTITUDE_STD = 8  # rad
GIMBAL_PITCH = 9  # rad above the horizon
GIMBAL_RATE = 10  # rad/s
GIMBAL_LAG = 11  # s
HOVER_POWER = 12  # W
N_PARAMETERS = 13

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
TAKEOFF_Z_P = 0.4  # identified: PX4's automatic take-off arrives more gently than an offboard climb
THRUST_MIN, THRUST_MAX, THRUST_XY_MARGIN = 0.12 * 20.0, 20.0, 0.3 * 20.0  # m/s2 (SIH: 20 N, 1 kg)
# Identified from six logged steps (docs/vehicle.md); PX4's default of 6.5 tilts 15 % too far here.
TILT_P = 4.5
MC_YAW_P, MC_YAW_WEIGHT = 2.8, 0.4
MC_TILT_RATE_MAX, MC_YAW_RATE_MAX = math.radians(220.0), math.radians(200.0)

# Rate loop: gain x motor torque / inertia of the SIH airframe, 1/s; what the motors can give, rad/s2.
RATE_GAIN_TILT, RATE_GAIN_YAW = 17.0, 2.7
RATE_DAMPING_TILT = 0.34
ANGULAR_ACCELERATION_MAX_TILT, ANGULAR_ACCELERATION_MAX_YAW = 60.0, 6.6
ROTATION_DRAG = 1.0  # SIH_KDW / SIH_IXX, 1/s
MOTOR_BLEND = 1.0 - math.exp(-STEP_S / 0.05)  # SIH_T_TAU
SLOPE_BLEND = 1.0 - math.exp(-STEP_S / MPC_VELD_LP_S)

# ---- the rest ----------------------------------------------------------------------------------------
LEG_HEIGHT_M = 0.25  # of the body origin above ground when landed
CAMERA_BELOW_M = 0.1
AVIONICS_W = 10.0
LANDED_AFTER_S = 1.0
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
    """Quaternion of a rotation vector; a short one by Taylor series, to the last bit of a double."""
    square = 0.25 * (vx * vx + vy * vy + vz * vz)
    if square < 1e-3:
        cosine = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)))
        k = 0.5 * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)))
    else:
        half = math.sqrt(square)
        cosine, k = math.cos(half), 0.5 * math.sin(half) / half
    return cosine, k * vx, k * vy, k * vz


@_inlined
def _four(x: F64, at: int) -> Quaternion:
    """The quaternion that begins at ``at``."""
    return x[at], x[at + 1], x[at + 2], x[at + 3]


@_inlined
def _set_unit(x: F64, at: int, quaternion: Entries) -> None:
    a, b, c, d = quaternion
    n = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    x[at], x[at + 1], x[at + 2], x[at + 3] = a * n, b * n, c * n, d * n


@_inlined
def _rotation(a: Entries) -> Entries:
    """The nine entries, row by row, of a quaternion's rotation matrix."""
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
def start(x: F64, rng: U64, q: F64) -> None:
    """Draws the slow errors from their stationary distributions and points the camera."""
    std = q[POSITION_STD]
    for i in range(3):
        share = VERTICAL_POSITION_ERROR if i == 2 else 1.0
        x[POSITION_ERROR + i] = std * share * _normal(rng)
        x[VELOCITY_ERROR + i] = std * share * 2.0 / POSITION_ERROR_TIME_S * _normal(rng)
    _believe_yaw(x)
    _set_unit(x, CAMERA, camera_quaternion(x[BELIEVED_YAW], q[GIMBAL_PITCH]))


@njit(cache=True, error_model="numpy")
def _move_air_and_errors(x: F64, rng: U64, q: F64) -> None:
    """Gauss-Markov steps of the gusts (first order), GNSS (second order) and attitude errors (first)."""
    dt = STEP_S * NOISE_STEPS

    feet = max((x[POSITION + 2] - x[GROUND_HEIGHT]) / FOOT_M, 10.0)
    shape = 0.177 + 0.000823 * min(feet, 1000.0)
    airspeed = 1.0
    for i in range(3):
        airspeed += (x[VELOCITY + i] - q[WIND + i]) ** 2
    airspeed = math.sqrt(airspeed)
    keep = math.exp(-dt * airspeed / (FOOT_M * feet / shape**1.2))
    fresh = q[GUST_STD] * math.sqrt(1.0 - keep * keep)
    x[GUST] = keep * x[GUST] + fresh * _normal(rng)
    x[GUST + 1] = keep * x[GUST + 1] + fresh * _normal(rng)
    keep = math.exp(-dt * airspeed / (FOOT_M * feet))
    fresh = q[GUST_STD] * shape**0.4 * math.sqrt(1.0 - keep * keep)
    x[GUST + 2] = keep * x[GUST + 2] + fresh * _normal(rng)

    w = 2.0 / POSITION_ERROR_TIME_S
    for i in range(3):
        draw = _normal(rng)  # always, so that the gusts do not depend on the errors
        if q[POSITION_STD] > 0.0:
            std = q[POSITION_STD] * (VERTICAL_POSITION_ERROR if i == 2 else 1.0)
            push = 2.0 * w * std * math.sqrt(w * dt) * draw
            x[VELOCITY_ERROR + i] += (
                -dt * (w * w * x[POSITION_ERROR + i] + 2.0 * w * x[VELOCITY_ERROR + i]) + push
            )
            x[POSITION_ERROR + i] += dt * x[VELOCITY_ERROR + i]

    keep = math.exp(-dt / ATTITUDE_ERROR_TIME_S)
    for i in range(3):
        fresh = q[ATTITUDE_STD] * math.sqrt(1.0 - keep * keep) * _normal(rng)
        x[ATTITUDE_ERROR + i] = keep * x[ATTITUDE_ERROR + i] + fresh


@_inlined
def _vertical_limits(x: F64, q: F64) -> tuple[float, float]:
    """Fastest climb and descent now, m/s, both positive; a negative climb keeps it on the ground."""
    agl = x[POSITION + 2] - x[GROUND_HEIGHT]
    up, down = q[CLIMB_SPEED], q[DESCENT_SPEED]
    if x[MODE] == TAKEOFF:
        if agl < MPC_LAND_ALT1:
            up = min(up, MPC_TKO_SPEED)
        ramp = _clip((x[MODE_TIME] - SPOOLUP_S) / MPC_TKO_RAMP_T, 0.0, 1.0)
        held = -G / MPC_Z_VEL_P
        up = min(up, held + ramp * (up - held))
    elif x[MODE] == LAND:
        low = min(MPC_LAND_SPEED, down)
        share = _clip((agl - MPC_LAND_ALT2) / (MPC_LAND_ALT1 - MPC_LAND_ALT2), 0.0, 1.0)
        down = low + share * (down - low)
    return up, down


@_inlined
def _limited_xy(px: float, py: float, fx: float, fy: float, limit: float) -> tuple[float, float]:
    """The sum p + f, no longer than limit, giving way on the feed-forward f before the position part p."""
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
def _velocity_setpoint(x: F64, q: F64) -> tuple[float, float, float]:
    ex, ey, ez = (
        x[TARGET_POSITION] - x[POSITION] - x[POSITION_ERROR],
        x[TARGET_POSITION + 1] - x[POSITION + 1] - x[POSITION_ERROR + 1],
        x[TARGET_POSITION + 2] - x[POSITION + 2] - x[POSITION_ERROR + 2],
    )
    vx, vy = _limited_xy(
        MPC_XY_P * ex, MPC_XY_P * ey, x[TARGET_VELOCITY], x[TARGET_VELOCITY + 1], x[TARGET_SPEED]
    )
    up, down = _vertical_limits(x, q)
    if x[MODE] == LAND:
        vz = -down
    else:
        vz = (TAKEOFF_Z_P if x[MODE] == TAKEOFF else MPC_Z_P) * ez + x[TARGET_VELOCITY + 2]
    return vx, vy, min(max(vz, -down), up)


@_inlined
def _thrust_setpoint(x: F64, q: F64) -> tuple[float, float, float]:
    """Velocity PID with tracking anti-windup, tilt and thrust limits: specific thrust (3,) ENU, m/s2.

    It comes out turned by what the vehicle errs in its own lean, as the attitude loop then turns the body.
    """
    vx, vy, vz = _velocity_setpoint(x, q)
    bx = x[VELOCITY] + x[VELOCITY_ERROR]
    by = x[VELOCITY + 1] + x[VELOCITY_ERROR + 1]
    bz = x[VELOCITY + 2] + x[VELOCITY_ERROR + 2]
    for i, b in enumerate((bx, by, bz)):
        gradient = (b - x[LAST_VELOCITY + i]) / STEP_S
        x[VELOCITY_SLOPE + i] += SLOPE_BLEND * (gradient - x[VELOCITY_SLOPE + i])
        x[LAST_VELOCITY + i] = b
    ex, ey, ez = vx - bx, vy - by, vz - bz
    ax = MPC_XY_VEL_P * ex + x[VELOCITY_INTEGRAL] - MPC_XY_VEL_D * x[VELOCITY_SLOPE]
    ay = MPC_XY_VEL_P * ey + x[VELOCITY_INTEGRAL + 1] - MPC_XY_VEL_D * x[VELOCITY_SLOPE + 1]
    az = MPC_Z_VEL_P * ez + x[VELOCITY_INTEGRAL + 2]

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
    x[VELOCITY_INTEGRAL] += MPC_XY_VEL_I * ex * STEP_S
    x[VELOCITY_INTEGRAL + 1] += MPC_XY_VEL_I * ey * STEP_S
    x[VELOCITY_INTEGRAL + 2] = _clip(x[VELOCITY_INTEGRAL + 2] + MPC_Z_VEL_I * ez * STEP_S, -G, G)
    lx, ly = x[LEAN_ERROR], x[LEAN_ERROR + 1]
    return tx - lx * lift, ty - ly * lift, lift + lx * tx + ly * ty


@_inlined
def _turn_towards(x: F64, R: Entries, tx: float, ty: float, tz: float) -> float:
    """Attitude P (tilt first, yaw with less weight) and rate loop; motors lag. Moves RATES and ATTITUDE."""
    T = math.sqrt(tx * tx + ty * ty + tz * tz)
    dx = (R[0] * tx + R[3] * ty + R[6] * tz) / T
    dy = (R[1] * tx + R[4] * ty + R[7] * tz) / T
    dz = (R[2] * tx + R[5] * ty + R[8] * tz) / T
    k = TILT_P / math.sqrt(max(0.5 * (1.0 + dz), 1e-6))
    yaw_error = _wrap(x[TARGET_YAW] - math.atan2(R[3], R[0]))
    yaw_rate = MC_YAW_P * 2.0 * math.sin(0.5 * MC_YAW_WEIGHT * yaw_error) / MC_YAW_WEIGHT
    wanted = (
        _clip(-k * dy, -MC_TILT_RATE_MAX, MC_TILT_RATE_MAX),
        _clip(k * dx, -MC_TILT_RATE_MAX, MC_TILT_RATE_MAX),
        _clip(yaw_rate, -MC_YAW_RATE_MAX, MC_YAW_RATE_MAX),
    )
    for i in range(3):
        rate = x[RATES + i]
        produced = x[ANGULAR_ACCELERATION + i]
        net = produced - ROTATION_DRAG * rate
        if i < 2:
            push = RATE_GAIN_TILT * (wanted[i] - rate) - RATE_DAMPING_TILT * net
            push = _clip(push, -ANGULAR_ACCELERATION_MAX_TILT, ANGULAR_ACCELERATION_MAX_TILT)
        else:
            push = RATE_GAIN_YAW * (wanted[i] - rate)
            push = _clip(push, -ANGULAR_ACCELERATION_MAX_YAW, ANGULAR_ACCELERATION_MAX_YAW)
        x[ANGULAR_ACCELERATION + i] = produced + MOTOR_BLEND * (push - produced)
        x[RATES + i] = rate + net * STEP_S
    step = _turn(x[RATES] * STEP_S, x[RATES + 1] * STEP_S, x[RATES + 2] * STEP_S)
    _set_unit(x, ATTITUDE, _multiply(_four(x, ATTITUDE), step))
    return T


@_inlined
def _move_body(x: F64, q: F64, R: Entries) -> None:
    """Thrust, linear drag against the air, gravity, and the ground."""
    along = (R[2], R[5], R[8])
    for i in range(3):
        air = q[WIND + i] + x[GUST + i]
        force = x[THRUST] * along[i] - q[DRAG_PER_MASS] * (x[VELOCITY + i] - air)
        x[VELOCITY + i] += (force - (G if i == 2 else 0.0)) * STEP_S
        x[POSITION + i] += x[VELOCITY + i] * STEP_S
    floor = x[GROUND_HEIGHT] + LEG_HEIGHT_M
    if x[POSITION + 2] <= floor:
        x[POSITION + 2] = floor
        _stand(x, R)
        x[CONTACT_TIME] += STEP_S
    else:
        x[AIRBORNE] = 1.0
        x[CONTACT_TIME] = 0.0


@njit(cache=True, error_model="numpy")
def _stand(x: F64, R: Entries) -> None:
    """Level and still, facing where it faced."""
    yaw = math.atan2(R[3], R[0])
    _set_unit(x, ATTITUDE, (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)))
    for at in (RATES, ANGULAR_ACCELERATION, VELOCITY, VELOCITY_INTEGRAL, VELOCITY_SLOPE):
        x[at : at + 3] = 0.0


@_inlined
def _believe_yaw(x: F64) -> None:
    R = _rotation(_four(x, ATTITUDE))
    east = R[0] + x[ATTITUDE_ERROR + 1] * R[6] - x[ATTITUDE_ERROR + 2] * R[3]
    north = R[3] + x[ATTITUDE_ERROR + 2] * R[0] - x[ATTITUDE_ERROR] * R[6]
    x[BELIEVED_YAW] = math.atan2(north, east)


@_inlined
def _move_gimbal(x: F64, R: Entries, pitch: float, rate_max: float, gain: float) -> None:
    """The body carries the camera along; the joints turn it back with a first-order lag and a rate limit."""
    _believe_yaw(x)
    e = _turn(-x[ATTITUDE_ERROR], -x[ATTITUDE_ERROR + 1], -x[ATTITUDE_ERROR + 2])
    wanted = _multiply(e, camera_quaternion(x[BELIEVED_YAW], pitch))
    camera = _four(x, CAMERA)
    error = _multiply(wanted, (camera[0], -camera[1], -camera[2], -camera[3]))
    sine = math.sqrt(error[1] ** 2 + error[2] ** 2 + error[3] ** 2)
    angle = 2.0 * math.atan2(sine, abs(error[0]))
    joint_rate = min(angle * gain, rate_max)
    k = math.copysign(joint_rate / sine, error[0]) if sine > 1e-12 else 0.0
    for i in range(3):
        carried = R[3 * i] * x[RATES] + R[3 * i + 1] * x[RATES + 1] + R[3 * i + 2] * x[RATES + 2]
        x[CAMERA_RATES + i] = carried + k * error[1 + i]
    step = _turn(x[CAMERA_RATES] * STEP_S, x[CAMERA_RATES + 1] * STEP_S, x[CAMERA_RATES + 2] * STEP_S)
    _set_unit(x, CAMERA, _multiply(step, camera))


@njit(cache=True, error_model="numpy")
def fly(x: F64, rng: U64, q: F64, steps: int) -> None:
    """Moves the simulation by ``steps`` of STEP_S."""
    pitch, rate_max = q[GIMBAL_PITCH], q[GIMBAL_RATE]
    gain = (1.0 - math.exp(-STEP_S / max(q[GIMBAL_LAG], 1e-6))) / STEP_S
    for _ in range(steps):
        if int(x[STEPS]) % NOISE_STEPS == 0:
            _move_air_and_errors(x, rng, q)
        x[STEPS] += 1.0
        x[MODE_TIME] += STEP_S
        R = _rotation(_four(x, ATTITUDE))
        power = AVIONICS_W
        if x[MODE] != ON_GROUND:
            tx, ty, tz = _thrust_setpoint(x, q)
            thrust = _turn_towards(x, R, tx, ty, tz)
            x[THRUST] += MOTOR_BLEND * (thrust - x[THRUST])
            _move_body(x, q, R)
            load = x[THRUST] / G
            power += q[HOVER_POWER] * load * math.sqrt(load)
            if x[MODE] == LAND and x[CONTACT_TIME] >= LANDED_AFTER_S:
                x[MODE] = ON_GROUND
                x[AIRBORNE] = 0.0
                x[THRUST] = 0.0
        _move_gimbal(x, R, pitch, rate_max, gain)
        x[ENERGY_WH] += power * STEP_S / 3600.0


@njit(cache=True, error_model="numpy")
def poses(x: F64, q: F64, out: F64) -> None:
    """What the vehicle believes and what is so, as rows of 3 in ``out`` (18, 3).

    Believed: 0 position, 1 velocity, 2-4 R_body_to_enu, 5 camera position, 6-8 R_camera_to_enu.
    True: 9-11 R_body_to_enu, 12 camera position, 13-15 R_camera_to_enu, 16 camera velocity in camera axes,
    17 camera rates in camera axes.
    """
    e = _turn(x[ATTITUDE_ERROR], x[ATTITUDE_ERROR + 1], x[ATTITUDE_ERROR + 2])
    attitude = _four(x, ATTITUDE)
    B = _rotation(_multiply(e, attitude))
    C = _rotation(camera_quaternion(x[BELIEVED_YAW], q[GIMBAL_PITCH]))
    R = _rotation(attitude)
    K = _rotation(_four(x, CAMERA))
    wx, wy = x[RATES], x[RATES + 1]
    for i in range(3):
        out[0, i] = x[POSITION + i] + x[POSITION_ERROR + i]
        out[1, i] = x[VELOCITY + i] + x[VELOCITY_ERROR + i]
        out[5, i] = out[0, i] - CAMERA_BELOW_M * B[3 * i + 2]
        out[12, i] = x[POSITION + i] - CAMERA_BELOW_M * R[3 * i + 2]
        for j in range(3):
            out[2 + i, j] = B[3 * i + j]
            out[6 + i, j] = C[3 * i + j]
            out[9 + i, j] = R[3 * i + j]
            out[13 + i, j] = K[3 * i + j]
    for j in range(3):
        out[16, j] = 0.0
        out[17, j] = 0.0
        for i in range(3):
            # rates x (0, 0, -CAMERA_BELOW_M), turned to ENU
            swing = CAMERA_BELOW_M * (-R[3 * i] * wy + R[3 * i + 1] * wx)
            out[16, j] += K[3 * i + j] * (x[VELOCITY + i] + swing)
            out[17, j] += K[3 * i + j] * x[CAMERA_RATES + i]
