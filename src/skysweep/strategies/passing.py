"""When a waypoint that is flown through was reached, or flown by."""

from __future__ import annotations

import math

from skysweep.types import XY, Observation

_REACHED_M = 2.0  # PX4 NAV_ACC_RAD
_PASSED_M, _PASSED_MPS = 6.0, 0.3  # nearer than this, and approached no faster: flown by


def is_past(seen: Observation, to: XY) -> bool:
    """Whether a place was reached, or flown by."""
    x, y, _ = seen.vehicle.position_enu_m.tolist()
    away_m = math.dist((x, y), to)
    if away_m <= _REACHED_M:
        return True
    vx, vy, _ = seen.vehicle.velocity_enu_mps.tolist()
    approached_mps = (vx * (to[0] - x) + vy * (to[1] - y)) / away_m
    return bool(away_m <= _PASSED_M and approached_mps < _PASSED_MPS)
