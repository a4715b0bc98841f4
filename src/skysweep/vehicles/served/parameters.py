"""Parameters with PX4's names, and the protocol that reads and writes them.

Every parameter either works as in PX4 or is fixed: it describes the vehicle, and a write is answered with the
unchanged value. Integers travel as in PX4, their 4 bytes in place of the float's.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace

from skysweep.scenarios.model import VehicleLimits
from skysweep.vehicles.mavlink.dialect import mavlink
from skysweep.vehicles.mavlink.modes import SYSTEM_ID, finite
from skysweep.vehicles.mavlink.wire import Message

Number = int | float
_AT_ONCE = 10  # parameters of a list sent in one tick


@dataclass(frozen=True, slots=True)
class _Parameter:
    default: Number  # its type is the parameter's
    low: float
    high: float


def _fixed(value: Number) -> _Parameter:
    return _Parameter(value, value, value)


def _table(limits: VehicleLimits, system_id: int) -> dict[str, _Parameter]:
    up, down = float(limits.climb_speed_mps), float(limits.descent_speed_mps)
    return {
        "BAT1_N_CELLS": _fixed(4),
        "BAT1_V_CHARGED": _fixed(4.05),
        "BAT1_V_EMPTY": _fixed(3.6),
        "BAT_CRIT_THR": _Parameter(0.07, 0.05, 0.5),
        "BAT_EMERGEN_THR": _Parameter(0.05, 0.03, 0.5),
        "BAT_LOW_THR": _Parameter(0.15, 0.05, 0.5),
        "CAL_ACC0_ID": _fixed(1310988),
        "CAL_GYRO0_ID": _fixed(1310988),
        "CAL_MAG0_ID": _fixed(197388),
        "COM_DISARM_LAND": _Parameter(2.0, -1.0, 20.0),
        "COM_DISARM_PRFLT": _Parameter(10.0, -1.0, 30.0),
        "COM_FAIL_ACT_T": _Parameter(5.0, 0.0, 25.0),
        "COM_LOW_BAT_ACT": _Parameter(3, 0, 3),
        "COM_OBL_RC_ACT": _Parameter(0, 0, 7),
        "COM_OF_LOSS_T": _Parameter(1.0, 0.0, 60.0),
        "COM_RCL_EXCEPT": _Parameter(0, 0, 31),
        "COM_RC_IN_MODE": _Parameter(1, 0, 4),
        "COM_RC_LOSS_T": _Parameter(1.0, 0.0, 35.0),
        "COM_RC_OVERRIDE": _Parameter(1, 0, 3),
        "COM_RC_STICK_OV": _Parameter(30.0, 5.0, 80.0),
        "GF_ACTION": _Parameter(2, 0, 5),
        "GF_MAX_HOR_DIST": _Parameter(0.0, 0.0, 10000.0),
        "GF_MAX_VER_DIST": _Parameter(0.0, 0.0, 10000.0),
        "MAV_SYS_ID": _fixed(system_id),
        "MAV_TYPE": _fixed(2),
        "MIS_TAKEOFF_ALT": _Parameter(2.5, 0.0, 500.0),
        "MPC_LAND_SPEED": _fixed(0.7),
        "MPC_MAN_Y_MAX": _Parameter(150.0, 0.0, 400.0),
        "MPC_TKO_SPEED": _fixed(1.5),
        "MPC_VEL_MANUAL": _Parameter(10.0, 3.0, 20.0),
        "MPC_XY_CRUISE": _Parameter(float(limits.cruise_speed_mps), 3.0, 20.0),
        "MPC_XY_P": _fixed(0.95),
        "MPC_XY_VEL_MAX": _Parameter(12.0, 3.0, 20.0),  # PX4 allows 0, which never comes home
        "MPC_Z_VEL_MAX_DN": _fixed(down),
        "MPC_Z_VEL_MAX_UP": _fixed(up),
        "MPC_Z_V_AUTO_DN": _fixed(down),
        "MPC_Z_V_AUTO_UP": _fixed(up),
        "NAV_ACC_RAD": _Parameter(2.0, 0.05, 200.0),
        "NAV_MC_ALT_RAD": _Parameter(0.8, 0.05, 200.0),
        "NAV_RCL_ACT": _Parameter(2, 1, 6),
        "RTL_MIN_DIST": _Parameter(10.0, 0.5, 100.0),
        "RTL_RETURN_ALT": _Parameter(30.0, 0.0, 1000.0),
        "SYS_AUTOSTART": _fixed(10040),  # PX4's SIH quadrotor
        "SYS_HAS_MAG": _fixed(1),
    }


class Parameters:
    """Values by name, and the answers of the parameter protocol."""

    def __init__(self, limits: VehicleLimits, system_id: int = SYSTEM_ID) -> None:
        self._table = _table(limits, system_id)
        self._names = list(self._table)
        self._values: dict[str, Number] = {name: p.default for name, p in self._table.items()}

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def set(self, name: str, value: float) -> bool:
        """Sets a parameter; False if it is unknown or fixed, or the value is out of range."""
        parameter = self._table.get(name)
        if parameter is None or not finite(value) or not parameter.low <= value <= parameter.high:
            return False
        self._values[name] = type(parameter.default)(value)
        return True

    def stretch(self, name: str, factor: float) -> None:
        """Multiplies a value and its upper limit."""
        parameter = self._table[name]
        self._table[name] = replace(parameter, high=parameter.high * factor)
        self._values[name] *= factor

    def _message(self, name: str) -> Message:
        value = self._values[name]
        if isinstance(value, int):
            kind = mavlink.MAV_PARAM_TYPE_INT32
            value = struct.unpack("<f", struct.pack("<i", value))[0]
        else:
            kind = mavlink.MAV_PARAM_TYPE_REAL32
        return mavlink.MAVLink_param_value_message(
            name.encode(), value, kind, len(self._names), self._names.index(name)
        )

    def read(self, asked: Message) -> Message | None:
        """The answer to PARAM_REQUEST_READ; None if there is no such parameter."""
        if asked.param_index < 0:
            return self.answer(asked.param_id)
        known = asked.param_index < len(self._names)
        return self._message(self._names[asked.param_index]) if known else None

    def answer(self, name: str) -> Message | None:
        """PARAM_VALUE of a parameter; None if there is no such parameter."""
        return self._message(name) if name in self._table else None

    def write(self, asked: Message) -> None:
        """Carries out a PARAM_SET, if the value is in range and the parameter not fixed."""
        name = asked.param_id
        if name not in self._table:
            return
        if isinstance(self._table[name].default, int) and asked.param_type != mavlink.MAV_PARAM_TYPE_REAL32:
            self.set(name, struct.unpack("<i", struct.pack("<f", asked.param_value))[0])
        elif asked.param_type == mavlink.MAV_PARAM_TYPE_REAL32:
            self.set(name, asked.param_value)

    def list(self) -> Iterator[list[Message]]:
        """The messages of all parameters, a few at a time."""
        for i in range(0, len(self._names), _AT_ONCE):
            yield [self._message(name) for name in self._names[i : i + _AT_ONCE]]
