"""Actions and observations of learners: numbers near 1, in the frame of the search area."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces

from skysweep.arrays import F32, F64
from skysweep.scenarios.model import Scenario
from skysweep.types import XY

Observed = dict[str, Any]  # name -> array

N_VEHICLE, N_CANDIDATE = 10, 8  # numbers that describe one; docs/gym.md lists them
EMPTY, OPEN, CONFIRMED, REJECTED, UNCHECKED = range(5)  # status of a slot
_FAR = 100.0  # observed numbers are clipped to -_FAR .. _FAR


@dataclass(frozen=True, slots=True)
class Chart:
    """The search area's bounding box as the square from -1 to 1, east and north."""

    west_m: float
    south_m: float
    east_m: float
    north_m: float

    @classmethod
    def of(cls, scenario: Scenario) -> Chart:
        """The chart of a scenario's area."""
        return cls(*scenario.area_enu_m.bounds)

    @property
    def half_m(self) -> XY:
        """Half the width and half the height."""
        return (self.east_m - self.west_m) / 2.0, (self.north_m - self.south_m) / 2.0

    def xy_enu_m(self, east: float, north: float) -> XY:
        """A place on the square, in metres ENU."""
        half_x, half_y = self.half_m
        return self.west_m + half_x * (1.0 + east), self.south_m + half_y * (1.0 + north)

    def on_square(self, x_m: float, y_m: float) -> XY:
        """A place in metres ENU, on the square; outside the box it lies beyond -1 .. 1."""
        half_x, half_y = self.half_m
        return (x_m - self.west_m) / half_x - 1.0, (y_m - self.south_m) / half_y - 1.0

    def places_of_cells(self, cells: int) -> F64:
        """Cell centres (cells * cells, 2) in metres ENU: rows south to north, each west to east."""
        shares = (np.arange(cells) + 0.5) / cells
        x = self.west_m + shares * (self.east_m - self.west_m)
        y = self.south_m + shares * (self.north_m - self.south_m)
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def action_space() -> spaces.Space[Any]:
    """East, north, and a number above 0 for a CHECK."""
    return spaces.Box(-1.0, 1.0, (3,), np.float32)


def observation_space(cells: int, slots: int, others: int = 0) -> spaces.Dict:
    """The space of docs/gym.md; ``others`` is the number of other vehicles."""
    parts: dict[str, spaces.Space[Any]] = {
        "belief": spaces.Box(0.0, 1.0, (cells, cells), np.float32),
        "vehicle": _numbers(N_VEHICLE),
        "candidates": _numbers(slots, N_CANDIDATE),
        "candidate_status": spaces.MultiDiscrete([UNCHECKED + 1] * slots),
        "candidate_mask": spaces.MultiBinary(slots),
    }
    if others:
        parts["others"] = _numbers(others, 3)
    return spaces.Dict(parts)


def _numbers(*shape: int) -> spaces.Box:
    return spaces.Box(-_FAR, _FAR, shape, np.float32)


def as_numbers(values: Iterable[float]) -> F32:
    """Values (N,) clipped to the limits of the spaces."""
    return np.array([min(max(value, -_FAR), _FAR) for value in values], dtype=np.float32)
