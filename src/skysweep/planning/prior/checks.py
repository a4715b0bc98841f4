"""What a search cannot be planned with, each told in one sentence."""

from __future__ import annotations

import math
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.errors import UserError

MAX_CELLS = 4_000_000
MAX_UAVS = 100


def checked_poa(poa: ArrayLike, field: str = "poa") -> F64:
    """A map's probabilities (R, C), scaled to a sum of 1.

    Raises UserError where they are no such map: empty, negative, not finite, zero everywhere.
    """
    try:
        if np.ma.is_masked(poa) or np.iscomplexobj(poa):
            raise TypeError
        values = np.array(poa, dtype=float, order="C")
    except (TypeError, ValueError):
        raise UserError(f"{field}: is no table of numbers, real and unmasked; write rows of them") from None
    if values.ndim != 2 or not values.size:
        shape = "x".join(map(str, values.shape)) or "one number"
        raise UserError(f"{field}: is {shape}, not rows and columns; write a map with at least one cell")
    if values.size > MAX_CELLS:
        raise UserError(f"{field}: has {values.size:,} cells; write at most {MAX_CELLS:,}, larger ones")
    if not np.isfinite(values).all():
        bad = int((~np.isfinite(values)).sum())
        cells = "cell is" if bad == 1 else "cells are"
        raise UserError(f"{field}: {bad} {cells} NaN or infinite; write 0 where the target cannot be")
    if values.min() < 0.0:
        raise UserError(f"{field}: holds {values.min():g}; write probabilities from 0 on")
    largest = values.max()
    if largest == 0.0:
        raise UserError(f"{field}: is 0 everywhere; write more than 0 where the target may be")
    values /= largest
    return np.asarray(values / values.sum())


def positive(value: float, field: str, unit: str = "metres") -> float:
    """The number. Raises UserError where it is none above 0."""
    try:
        number = math.nan if isinstance(value, str) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number > 0.0):
        shown = f"{value:g}" if isinstance(value, Real) else f"{value!r:.60}"
        raise UserError(f"{field}: is {shown}; write {unit} above 0")
    return number


def place(xy_m: ArrayLike, field: str) -> F64:
    """A place (2,). Raises UserError where it is none."""
    try:
        xy = np.asarray(xy_m, dtype=float)
    except (TypeError, ValueError):
        xy = np.empty(0)
    if xy.shape != (2,) or not np.isfinite(xy).all():
        raise UserError(f"{field}: is no place; write two numbers, east and north in metres")
    return xy


def uavs(count: int) -> int:
    """How many vehicles. Raises UserError where there can be no such number."""
    if not isinstance(count, Real) or not 1 <= count <= MAX_UAVS or count != int(count):
        raise UserError(f"n_uavs: is {count!r:.60}; write a whole number from 1 to {MAX_UAVS}")
    return int(count)


def way_to_map(poa: F64, cell_size_m: float, origin_xy_m: F64, start_xy_m: F64) -> float:
    """Metres from a start (2,) to the nearest cell where the target may be; 0 inside one."""
    rows, columns = np.nonzero(poa)
    nearest_xy_m = np.clip(
        start_xy_m,
        origin_xy_m + cell_size_m * np.column_stack([columns, rows]),
        origin_xy_m + cell_size_m * np.column_stack([columns + 1, rows + 1]),
    )
    return float(np.linalg.norm(nearest_xy_m - start_xy_m, axis=1).min())
