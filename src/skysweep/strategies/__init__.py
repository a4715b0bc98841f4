"""Search strategies. A new one is one file and one line here, or of a third party.

Third parties register a ``StrategySpec`` under the entry point group ``skysweep.strategies``, or name their
class ``module:Name``.
"""

from __future__ import annotations

import hashlib
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from skysweep.errors import UserError
from skysweep.strategies.baselines import SingleAltitude
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.belief.search import BeliefSearch
from skysweep.strategies.given import is_given, sound_source, sources_of, spec_named, spec_of
from skysweep.strategies.scan_check import ScanCheck
from skysweep.strategies.spec import StrategySpec as StrategySpec

_BUILT_IN: dict[str, StrategySpec] = {
    "scan-check": StrategySpec(ScanCheck),
    "scan-only": StrategySpec(lambda context: SingleAltitude(context, context.search.scan_altitude_agl_m)),
    "low-only": StrategySpec(
        lambda context: SingleAltitude(context, context.search.check_altitude_agl_m),
        lambda search: search.check_altitude_agl_m,
    ),
    "belief": StrategySpec(BeliefSearch, parameters=BeliefParameters, needs_sensor_model=True),
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
    entry = _installed(name)
    if entry is not None:
        return _loaded(entry)
    raise UserError(
        f"search.strategy: there is no strategy '{name}'; write one of {', '.join(strategy_names())}, or "
        "MODULE:NAME of your own"
    )


def code_of(name: str) -> tuple[tuple[Path, ...], str]:
    """The files that a strategy which is not built in comes from, and its package's version.

    Raises UserError where one was changed since Python imported it.
    """
    entry = None if name in _BUILT_IN else _installed(name)
    if entry is None:
        return sources_of(name), ""
    version = f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else ""
    if entry.module not in sys.modules:
        _loaded(entry)
    return sources_of(f"{entry.module}:{entry.attr}"), version


def fingerprint_of(name: str) -> str | None:
    """What tells a strategy's code from another one's; None of a built-in one, and of notebooks.

    That is the SHA-256 of its files, in hexadecimal, and before it the name and version of its package where
    it is installed. Raises UserError as ``code_of``.
    """
    paths, version = code_of(name)
    code = b"".join(path.read_bytes() for path in paths if path.is_file())
    digest = hashlib.sha256(code).hexdigest() if code else ""
    return " ".join(filter(None, (version, digest))) or None


def _installed(name: str) -> EntryPoint | None:
    return next((e for e in entry_points(group="skysweep.strategies") if e.name == name), None)


def _loaded(entry: EntryPoint) -> StrategySpec:
    where = f"search.strategy: {entry.name}"
    package = entry.dist.name if entry.dist is not None else entry.value
    try:
        found = entry.load()
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split())
        raise UserError(
            f"{where}: {package} cannot be loaded ({type(error).__name__}: {reason}); update or remove it"
        ) from error
    sound_source(entry.module, where)
    return spec_of(found, where)
