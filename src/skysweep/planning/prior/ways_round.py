"""Paths led round places where nobody may fly."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.planning.prior.coverage import beginning
from skysweep.types import XY

Way = Callable[[XY, XY], Sequence[XY]]  # places to fly to in turn, the goal last; empty: there is no way


def led_round(path_xy_m: F64, way: Way) -> F64:
    """A path (K, 2) whose legs are ways; what no way leads to is left out.

    Raises UserError where that is all but the start.
    """
    places: list[XY] = [(float(path_xy_m[0, 0]), float(path_xy_m[0, 1]))]
    for x, y in path_xy_m[1:].tolist():
        places.extend(way(places[-1], (x, y)))
    if len(places) < 2:
        raise UserError(
            "start: no way leads from there to where the target may be, inside the geofence and round no-fly "
            "areas; start elsewhere"
        )
    return np.array(places)


def cut_to(path_xy_m: F64, length_m: float) -> F64:
    """A path (K, 2) of at most so many metres."""
    legs_m = np.linalg.norm(np.diff(path_xy_m, axis=0), axis=1)
    return path_xy_m if legs_m.sum() <= length_m else beginning(path_xy_m, length_m)
