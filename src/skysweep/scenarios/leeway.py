"""How wind drives what floats: leeway.

The taxonomy of Allen and Plourde, "Review of Leeway: Field Experiments and Implementation" (USCG Research
and Development Center, CG-D-08-99, 1999): slope, offset and standard error of the drift down the wind and
across it, as SAROPS lists them (Allen, 2010). As in Breivik and Allen, "An operational search and rescue
model for the Norwegian Sea and the North Sea" (Journal of Marine Systems 69, 2008), each object keeps its
own error e of each part, slope + e / 20 and offset + e / 2, and drifts to the right or to the left of the
wind, half and half. It never changes sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F64


@dataclass(frozen=True)
class Part:
    """Speed in cm/s: slope in % of the wind's in m/s, offset and standard error in cm/s."""

    slope_percent: float
    offset_cmps: float
    error_cmps: float


@dataclass(frozen=True)
class Leeway:
    """One class of object: its drift down the wind, and to the right and the left of it."""

    name: str
    downwind: Part
    right: Part
    left: Part


def _leeway(name: str, *numbers: float) -> Leeway:
    down, right, left = (Part(*numbers[k : k + 3]) for k in (0, 3, 6))
    return Leeway(name, down, right, left)


LEEWAY = {
    "PIW-1": _leeway("person in water, unknown state", 0.96, 0, 12, 0.54, 0, 9.4, -0.54, 0, 9.4),
    "PIW-2": _leeway("person in water, vertical, PFD type III, conscious",
                     0.48, 0, 8.3, 0.15, 0, 6.7, -0.15, 0, 6.7),
    "PIW-3": _leeway("person in water, sitting, PFD type I or II",
                     1.60, -3.98, 2.42, 0.13, 0.33, 2.11, -0.13, -0.33, 2.11),
    "PIW-4": _leeway("person in water, survival suit, face up",
                     1.71, 1.12, 3.93, 1.36, -3.30, 1.71, -0.13, -2.65, 1.62),
    "PIW-5": _leeway("person in water, scuba suit, face up",
                     0.63, 0, 5.3, 0.31, 0, 4.5, -0.31, 0, 4.5),
    "LIFE-RAFT-DB-10": _leeway("life raft, deep ballast, general",
                               3.52, -2.50, 6.10, 0.62, -3.00, 3.50, -0.45, -0.20, 3.60),
    "LIFE-RAFT-SB-6": _leeway("life raft, shallow ballast and canopy, general",
                              2.68, 0, 12, 1.10, 0, 9.4, -1.10, 0, 9.4),
    "LIFE-RAFT-NB-1": _leeway("life raft, no ballast, general", 3.70, 0, 12, 1.98, 0, 9.4, -1.98, 0, 9.4),
    "PERSON-POWERED-VESSEL-1": _leeway("sea kayak with person on aft deck",
                                       1.16, 11.12, 4.12, 0.41, 0, 4.39, -0.41, 0, 4.39),
    "PERSON-POWERED-VESSEL-2": _leeway("surf board with person", 1.93, 0, 8.3, 0.51, 0, 6.7, -0.51, 0, 6.7),
    "SKIFF-1": _leeway("skiff, modified V, runabout with outboard",
                       3.15, 0, 2.2, 1.29, 0, 2.2, -1.29, 0, 2.2),
    "SKIFF-3": _leeway("skiff, swamped or capsized", 1.65, 0, 3.1, 0.39, 0, 2.9, -0.39, 0, 2.9),
    "SPORT-BOAT": _leeway("sport boat, no canvas, modified V hull", 6.54, 0, 3, 2.19, 0, 2.8, -2.19, 0, 2.8),
    "FISHING-VESSEL-1": _leeway("fishing vessel, general", 2.47, 0, 12, 2.76, 0, 9.4, -2.76, 0, 9.4),
}  # fmt: skip


def leeway_mps(leeway: Leeway, wind_mps: F64, to_right: NDArray[np.bool_], errors: F64) -> F64:
    """Velocities (P, 2) through the water of objects in winds (P, 2), where they blow to.

    ``to_right`` (P,) are those that drift to the right of the wind; ``errors`` (2, P) are standard normal, of
    the part down the wind and of the part across it.
    """
    speed_mps = np.linalg.norm(wind_mps, axis=1)
    along = wind_mps / np.maximum(speed_mps, 1e-9)[:, None]
    down = _speed_mps(leeway.downwind, speed_mps, errors[0])
    aside = np.where(
        to_right,
        _speed_mps(leeway.right, speed_mps, errors[1]),
        _speed_mps(leeway.left, speed_mps, errors[1]),
    )
    rightwards = np.column_stack([along[:, 1], -along[:, 0]])
    return np.asarray(down[:, None] * along + aside[:, None] * rightwards)


def _speed_mps(part: Part, wind_mps: F64, error: F64) -> F64:
    own = part.error_cmps * error
    return 0.01 * ((part.slope_percent + own / 20.0) * wind_mps + part.offset_cmps + own / 2.0)
