"""Paths that were flown or drawn elsewhere, in a map's frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.qgc import read_plan


def path_of_plan(path: str | Path, frame: LocalFrame) -> F64:
    """The waypoints (K, 2) of a QGroundControl plan, ENU metres. Raises UserError where it has no path."""
    points = [(p.latitude_deg, p.longitude_deg) for p in read_plan(path).waypoints]
    if len(points) < 2:
        raise UserError(f"{path}: mission.items: there is no path; give a plan with at least 2 waypoints")
    return ground_path(points, frame)


def ground_path(lat_lon_deg: ArrayLike, frame: LocalFrame) -> F64:
    """Places (K, 2) given as latitude and longitude, as ENU metres (K, 2)."""
    places = np.asarray(lat_lon_deg, dtype=float)
    heights = np.full(len(places), frame.altitude_m)
    return frame.enu_from_geodetic(np.column_stack([places, heights]))[:, :2]
