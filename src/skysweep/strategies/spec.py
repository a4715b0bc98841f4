"""How a strategy is made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from skysweep.scenarios.model import Search
from skysweep.types import XY, Strategy

MakeStrategy = Callable[[Search, Sequence[XY], float], Strategy]  # search, F (x, y), seconds of a look


@dataclass(frozen=True, slots=True)
class StrategySpec:
    """How to make a strategy and which altitude its coverage is planned for."""

    make: MakeStrategy
    cover_altitude_agl_m: Callable[[Search], float]
