"""Search strategies. A new one is one file and one line here, or of a third party.

Third parties register a ``StrategySpec`` under the entry point group ``skysweep.strategies``, or name their
class ``module:Name``.
"""

from __future__ import annotations

from importlib.metadata import entry_points

from skysweep.errors import UserError
from skysweep.strategies.baselines import SingleAltitude
from skysweep.strategies.given import is_given, spec_named
from skysweep.strategies.scan_check import ScanCheck
from skysweep.strategies.spec import StrategySpec as StrategySpec

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
    if is_given(name):
        return spec_named(name)
    for entry in entry_points(group="skysweep.strategies"):
        if entry.name == name:
            spec: StrategySpec = entry.load()
            return spec
    raise UserError(
        f"search.strategy: there is no strategy '{name}'; write one of {', '.join(strategy_names())}, or "
        "MODULE:NAME of your own"
    )
