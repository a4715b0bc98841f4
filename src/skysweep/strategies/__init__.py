"""Search strategies. A new one is one file and one line here, or an entry point of a third party's package.

Third parties register a ``StrategySpec`` under the entry point group ``skysweep.strategies``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points

from skysweep.errors import UserError
from skysweep.scenarios.model import Search
from skysweep.strategies.baselines import SingleAltitude
from skysweep.strategies.scan_check import ScanCheck
from skysweep.types import XY, Strategy


@dataclass(frozen=True, slots=True)
class StrategySpec:
    """How to make a strategy and which altitude its coverage is planned for."""

    make: Callable[[Search, Sequence[XY], float], Strategy]  # search, F (x, y), seconds of a look
    cover_altitude_agl_m: Callable[[Search], float]


_BUILT_IN: dict[str, StrategySpec] = {
    "scan-check": StrategySpec(ScanCheck, lambda s: s.scan_altitude_agl_m),
    "scan-only": StrategySpec(
        lambda s, f, _look: SingleAltitude(s, f, s.scan_altitude_agl_m), lambda s: s.scan_altitude_agl_m
    ),
    "low-only": StrategySpec(
        lambda s, f, _look: SingleAltitude(s, f, s.check_altitude_agl_m), lambda s: s.check_altitude_agl_m
    ),
}


def strategy_names() -> list[str]:
    """Every strategy that can be asked for by name."""
    return [*_BUILT_IN, *(e.name for e in entry_points(group="skysweep.strategies"))]


def strategy_spec(name: str) -> StrategySpec:
    """The strategy called ``name``. Raises UserError naming those there are."""
    if name in _BUILT_IN:
        return _BUILT_IN[name]
    for entry in entry_points(group="skysweep.strategies"):
        if entry.name == name:
            spec: StrategySpec = entry.load()
            return spec
    raise UserError(
        f"search.strategy: there is no strategy '{name}'; write one of {', '.join(strategy_names())}"
    )
