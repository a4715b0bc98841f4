"""Flies logged PX4 manoeuvres again with the embedded vehicle and compares the two.

``python -m skysweep.vehicles.embedded.calibration LOG.csv.gz ...`` prints the table of docs/vehicle.md. A log
has columns ``t, phase, sp_x..sp_vz`` (setpoints sent), ``x..vz`` (estimates; all NED) and
``roll_deg, pitch_deg, yaw_deg``; phases: ``pre`` (hover), the legs, ``post``. The number before ``ms`` or
after ``vmax`` in its name is the speed limit, ``kdv03`` means drag 0.3 N/(m/s).

The estimator of the logged vehicle errs in velocity and attitude for seconds at a time: the velocity is not
the derivative of the position, and the acceleration does not match the attitude. The embedded vehicle flies
under the same errors; ``Log.exact`` is the log without them.
"""

from __future__ import annotations

import re
import sys
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation

from skysweep.geometry.frames import enu_from_ned
from skysweep.scenarios.model import CameraModel, VehicleLimits, Wind
from skysweep.types import F64, Setpoint
from skysweep.vehicles.embedded.dynamics import DRAG_PER_MASS, G
from skysweep.vehicles.embedded.multirotor import Multirotor

_ENTERED_M = 0.5
_LAWNMOWER_ACCEPTANCE_M, _SQUARE_ACCEPTANCE_M = 1.0, 0.5  # of the logged flights
_PATIENCE = 2.0  # times the duration of the logged leg, then it has failed
_TICK_S = 0.04
_ERROR_WINDOW_S = 1.0  # over which velocity and position are compared
_STILL_AIR = Wind(mean_speed_mps=0.0, gust_std_mps=0.0)
_EXACT = VehicleLimits(position_noise_m=0.0, attitude_noise_deg=0.0)


@dataclass(frozen=True, slots=True)
class Log:
    """One manoeuvre in ENU, 25 Hz. Setpoints are NaN where none was sent."""

    name: str
    time_s: F64  # (N,)
    legs: tuple[slice, ...]  # rows of each leg and turn
    setpoint_enu_m: F64  # (N, 3)
    feed_forward_enu_mps: F64  # (N, 3)
    position_enu_m: F64  # (N, 3)
    velocity_enu_mps: F64  # (N, 3)
    velocity_error_enu_mps: F64  # (N, 3) estimated minus derivative of the estimated position
    lean_error: (
        F64  # (N, 2) rad, estimated lean of the up axis, east and north, minus that of its acceleration
    )
    tilt_deg: F64  # (N,)
    yaw_rad: F64  # (N,) ENU

    @property
    def speed_limit_mps(self) -> float:
        """Horizontal speed limit; only the vehicle limits moving setpoints."""
        found = re.search(r"vmax(\d+)|step_(\d+)ms", self.name)
        return float(next(filter(None, found.groups()))) if found else 12.0

    def exact(self) -> Log:
        no_error = np.zeros_like(self.velocity_error_enu_mps)
        return replace(self, velocity_error_enu_mps=no_error, lean_error=no_error[:, :2])


@dataclass(frozen=True, slots=True)
class FlownManoeuvre:
    """Duration and peaks of one flight of a manoeuvre."""

    time_s: float  # until 0.5 m before the target along the way (single leg), or the end of the last leg
    sphere_time_s: float  # until 0.5 m from the target in space; NaN for patterns and a miss
    peak_speed_mps: float
    peak_tilt_deg: float


def read_log(path: Path) -> Log:
    """Reads a log; its name is the file's."""
    rows = pl.read_csv(path)

    def columns(*names: str) -> F64:
        return rows.select(pl.col(names).cast(float)).to_numpy()

    angles_deg = columns("yaw_deg", "pitch_deg", "roll_deg")
    time_s = columns("t")[:, 0]
    position_enu_m = enu_from_ned(columns("x", "y", "z"))
    velocity_enu_mps = enu_from_ned(columns("vx", "vy", "vz"))
    name = path.name.removesuffix(".csv.gz")
    velocity_error_enu_mps = _velocity_error(time_s, position_enu_m, velocity_enu_mps)
    up_enu = enu_from_ned(Rotation.from_euler("ZYX", angles_deg, degrees=True).apply([0.0, 0.0, -1.0]))
    true_velocity_enu_mps = velocity_enu_mps - velocity_error_enu_mps
    lean_error = _lean_error(time_s, up_enu, true_velocity_enu_mps, _drag_per_mass(name))
    return Log(
        name,
        time_s,
        _legs(rows["phase"].to_list()),
        enu_from_ned(columns("sp_x", "sp_y", "sp_z")),
        enu_from_ned(columns("sp_vx", "sp_vy", "sp_vz")),
        position_enu_m,
        velocity_enu_mps,
        velocity_error_enu_mps,
        lean_error,
        np.degrees(np.arccos(up_enu[:, 2])),
        np.pi / 2 - np.radians(angles_deg[:, 0]),
    )


def _legs(phases: list[str]) -> tuple[slice, ...]:
    starts = [0, *(i for i in range(1, len(phases)) if phases[i] != phases[i - 1])]
    ends = [*starts[1:], len(phases)]
    return tuple(
        slice(a, b) for a, b in zip(starts, ends, strict=True) if phases[a].startswith(("leg", "turn"))
    )


def _drag_per_mass(name: str) -> float:
    return 0.3 if "kdv03" in name else DRAG_PER_MASS


def _velocity_error(time_s: F64, position_m: F64, velocity_mps: F64) -> F64:
    """(N, 3): estimated velocity minus the slope of the estimated position."""
    travelled_m = cumulative_trapezoid(velocity_mps, time_s, axis=0, initial=0.0)
    return _mean_slope(time_s, travelled_m - position_m)


def _lean_error(time_s: F64, up_enu: F64, velocity_mps: F64, drag_per_mass: float) -> F64:
    """(N, 2): estimated lean minus that of the horizontal acceleration (thrust, linear drag)."""
    lift_mps2 = G + drag_per_mass * velocity_mps[:, 2] + np.gradient(velocity_mps[:, 2], time_s)
    said_mps2 = up_enu[:, :2] / up_enu[:, 2:] * lift_mps2[:, None] - drag_per_mass * velocity_mps[:, :2]
    said_mps = cumulative_trapezoid(said_mps2, time_s, axis=0, initial=0.0)
    return _mean_slope(time_s, said_mps - velocity_mps[:, :2]) / G


def _mean_slope(time_s: F64, values: F64) -> F64:
    """Mean slope of each column of ``values`` in the window around each time."""
    before_s = np.maximum(time_s - 0.5 * _ERROR_WINDOW_S, time_s[0])
    after_s = np.minimum(time_s + 0.5 * _ERROR_WINDOW_S, time_s[-1])
    at = interp1d(time_s, values, axis=0)
    return np.asarray((at(after_s) - at(before_s)) / (after_s - before_s)[:, None])


def _level_ground(_east_m: float, _north_m: float) -> float:
    return 0.0


def fly_again(log: Log) -> tuple[FlownManoeuvre, FlownManoeuvre]:
    """(PX4, ours): the logged flight, and the embedded vehicle's with its setpoints and estimation errors.

    Ours starts where the log starts. The next leg of a pattern begins as in the log: near the last setpoint,
    and not before a moving setpoint has stopped.
    """
    legs, home, drag = log.legs, np.zeros(3), _drag_per_mass(log.name)
    vehicle = Multirotor(_EXACT, _STILL_AIR, CameraModel(), home, _level_ground, 0, drag)
    first = int(np.argmax(np.isfinite(log.setpoint_enu_m[:, 0])))
    velocity_enu_mps = log.velocity_enu_mps[first] - log.velocity_error_enu_mps[first]
    vehicle.place(log.position_enu_m[first], velocity_enu_mps, log.yaw_rad[first])
    for row in range(first, legs[0].start):
        _command(vehicle, log, row)
        vehicle.advance(log.time_s[row + 1] - log.time_s[row])
    times, positions, speeds, tilts = [], [], [], []
    time_s = 0.0
    for leg in legs:
        elapsed_s = 0.0
        rows = log.time_s[leg] - log.time_s[leg.start]
        earliest_s, near_m = _arrival(log, leg)
        target = log.setpoint_enu_m[leg.stop - 1]
        while elapsed_s < earliest_s or np.linalg.norm(vehicle.true_position_enu_m - target) > near_m:
            if elapsed_s > _PATIENCE * rows[-1]:
                raise RuntimeError(f"{log.name}: the vehicle never finished the leg at row {leg.start}")
            row = leg.start + int(np.searchsorted(rows, elapsed_s + 1e-6)) - 1
            _command(vehicle, log, row)
            vehicle.advance(_TICK_S)
            elapsed_s += _TICK_S
            time_s += _TICK_S
            times.append(time_s)
            positions.append(vehicle.true_position_enu_m)
            speeds.append(np.linalg.norm(vehicle.state().velocity_enu_mps))
            believed_lean = vehicle.true_R_body_to_enu[:2, 2] + log.lean_error[row]
            tilts.append(np.degrees(np.arcsin(np.hypot(*believed_lean))))
    flown = slice(legs[0].start, legs[-1].stop)
    logged_s = log.time_s[flown] - log.time_s[legs[0].start]
    logged_mps = np.linalg.norm(log.velocity_enu_mps[flown], axis=1)
    logged = _measure(log, logged_s, log.position_enu_m[flown], logged_mps, log.tilt_deg[flown])
    ours = _measure(log, np.array(times), np.array(positions), np.array(speeds), np.array(tilts))
    return logged, ours


def _command(vehicle: Multirotor, log: Log, row: int) -> None:
    feed_forward = log.feed_forward_enu_mps[row]
    vehicle.misjudge(log.velocity_error_enu_mps[row], log.lean_error[row])
    vehicle.command(
        Setpoint(
            log.setpoint_enu_m[row],
            log.speed_limit_mps,
            float(log.yaw_rad[log.legs[0].start]),
            feed_forward if np.isfinite(feed_forward).all() else None,
        )
    )


def _arrival(log: Log, leg: slice) -> tuple[float, float]:
    """The earliest end of a leg (s) and its largest distance from the last setpoint (m)."""
    rows_s = log.time_s[leg] - log.time_s[leg.start]
    if len(log.legs) == 1:
        return float(rows_s[-1]), np.inf
    moving = (np.diff(log.setpoint_enu_m[leg], axis=0) != 0.0).any(axis=1)
    earliest_s = float(rows_s[1:][moving][-1]) if moving.any() else 0.0
    return earliest_s, _SQUARE_ACCEPTANCE_M if log.name.startswith("square") else _LAWNMOWER_ACCEPTANCE_M


def _measure(log: Log, times_s: F64, positions_enu_m: F64, speeds_mps: F64, tilts_deg: F64) -> FlownManoeuvre:
    if len(log.legs) > 1:
        time_s, sphere_time_s = float(times_s[-1]), np.nan
    else:
        start, target = log.position_enu_m[log.legs[0].start], log.setpoint_enu_m[log.legs[0].stop - 1]
        way = (target - start) / np.linalg.norm(target - start)
        left_m = target - positions_enu_m
        time_s = _first(times_s, left_m @ way < _ENTERED_M)
        sphere_time_s = _first(times_s, np.linalg.norm(left_m, axis=1) < _ENTERED_M)
    return FlownManoeuvre(time_s, sphere_time_s, float(speeds_mps.max()), float(tilts_deg.max()))


def _first(times_s: F64, arrived: NDArray[np.bool_]) -> float:
    return float(times_s[np.argmax(arrived)]) if arrived.any() else np.nan


def main(paths: list[Path]) -> None:
    """Prints one line per log: ours, PX4's and the difference."""
    titles = ("time s", "to the sphere s", "peak speed m/s", "peak tilt deg")
    print(f"{'manoeuvre':30s}" + "".join(f"{title:>25s}" for title in titles))
    for path in paths:
        theirs, ours = fly_again(read_log(path))
        pairs = zip(astuple(ours), astuple(theirs), strict=True)
        cells = "".join(
            f"{a:9.2f} {b:8.2f} {100 * (a / b - 1):+6.1f}%" if np.isfinite(a / b) else f"{'-':>25s}"
            for a, b in pairs
        )
        print(f"{path.name.removesuffix('.csv.gz'):30s}{cells}")


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
