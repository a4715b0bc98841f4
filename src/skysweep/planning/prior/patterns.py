"""Search patterns by their names in the IAMSAR Manual, Volume II, chapter 5.

Each is a path (K, 2) in ENU metres from its commence search point on. ``heading_deg`` is a compass heading,
turns are to the right unless ``turn`` is "left".
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.areas import heading_axes
from skysweep.planning.prior.checks import place, positive

Turn = Literal["right", "left"]

_SECTORS = 3  # triangles of a sector search
_MOST_LEGS = 10_000


def parallel_track(
    centre_xy_m: ArrayLike, length_m: float, width_m: float, spacing_m: float, heading_deg: float
) -> F64:
    """Parallel sweep search (PS): legs along the longer side of a rectangle, half a spacing inside it.

    ``heading_deg`` is that of the longer side; the search begins in its rear left corner. Raises UserError as
    ``creeping_line`` does, and where the rectangle is wider than long.
    """
    if length_m < width_m:
        raise UserError("length_m: is shorter than width_m; write the longer side, or a creeping line")
    return _legs(centre_xy_m, length_m, width_m, spacing_m, heading_deg)


def creeping_line(
    centre_xy_m: ArrayLike, length_m: float, width_m: float, spacing_m: float, heading_deg: float
) -> F64:
    """Creeping line search (CS): legs along the shorter side, so that the search creeps along the longer one.

    ``heading_deg`` is the direction of creep. The search begins in the rear right corner. Raises UserError
    where a number is none above 0, or there are too many legs.
    """
    if length_m < width_m:
        raise UserError("length_m: is shorter than width_m; write the longer side, or a parallel sweep")
    return _legs(centre_xy_m, width_m, length_m, spacing_m, heading_deg - 90.0)


def expanding_square(
    datum_xy_m: ArrayLike, radius_m: float, spacing_m: float, heading_deg: float, turn: Turn = "right"
) -> F64:
    """Expanding square search (SS): legs of 1, 1, 2, 2, 3, 3 ... spacings, until they reach the radius.

    Raises UserError where a number is none above 0, there are too many legs, or the turn is another word.
    """
    spacing, radius = positive(spacing_m, "spacing_m"), positive(radius_m, "radius_m")
    side, legs = _side(turn), 4 * math.ceil(radius / spacing)
    _refuse_many(legs)
    lengths = spacing * (1 + np.arange(legs) // 2)
    quarter = np.arange(legs) % 4
    steps = np.column_stack([side * lengths * np.array([0, 1, 0, -1])[quarter],
                             lengths * np.array([1, 0, -1, 0])[quarter]])  # fmt: skip
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return place(datum_xy_m, "datum_xy_m") + path @ _axes(heading_deg)


def sector_search(datum_xy_m: ArrayLike, radius_m: float, heading_deg: float, turn: Turn = "right") -> F64:
    """Sector search (VS): three equilateral triangles through the datum, each leg as long as the radius.

    Turns are of 120 degrees; none at the datum, where the path ends. Raises UserError where the radius is
    none above 0, or the turn is another word.
    """
    radius, side = positive(radius_m, "radius_m"), _side(turn)
    legs = 3 * _SECTORS
    turns = np.array([0.0 if leg % 3 == 0 else 120.0 for leg in range(legs)])
    angles = np.radians(side * np.cumsum(turns))
    steps = radius * np.column_stack([np.sin(angles), np.cos(angles)])
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return place(datum_xy_m, "datum_xy_m") + path @ _axes(heading_deg)


def _legs(
    centre_xy_m: ArrayLike, along_m: float, across_m: float, spacing_m: float, heading_deg: float
) -> F64:
    """Legs back and forth, the first one ahead on the left; neighbours are a spacing or less apart."""
    along, across = positive(along_m, "length_m"), positive(across_m, "width_m")
    spacing = positive(spacing_m, "spacing_m")
    count = math.ceil(across / spacing - 1e-9)
    _refuse_many(count)
    return place(centre_xy_m, "centre_xy_m") + legs_over(along, across, count) @ _axes(heading_deg)


def legs_over(along_m: float, across_m: float, count: int) -> F64:
    """So many legs (K, 2) north and south in a rectangle about 0, 0; the first goes north, in the west."""
    apart = across_m / count
    x = -across_m / 2.0 + apart * (np.arange(count) + 0.5)
    half = max(along_m / 2.0 - apart / 2.0, 0.0)
    ends = np.array([[-half, half], [half, -half]])[np.arange(count) % 2]
    return np.column_stack([np.repeat(x, 2), ends.ravel()])


def _axes(heading_deg: float) -> F64:
    """Rows: the directions to the right of a heading and along it."""
    if not math.isfinite(heading_deg):
        raise UserError(f"heading_deg: is {heading_deg:g}; write degrees clockwise from north")
    along, left = heading_axes(heading_deg)
    return np.array([-left, along])


def _side(turn: Turn) -> float:
    if turn not in ("right", "left"):
        raise UserError(f"turn: is {turn!r}; write 'right' or 'left'")
    return 1.0 if turn == "right" else -1.0


def _refuse_many(legs: int) -> None:
    if legs > _MOST_LEGS:
        raise UserError(f"spacing_m: makes {legs:,} legs; write at most {_MOST_LEGS:,}, farther apart")
