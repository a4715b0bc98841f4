"""What a strategy makes of a scenario's coverage."""

from __future__ import annotations

from skysweep.scenarios.model import Scenario
from skysweep.strategies import StrategySpec, strategy_spec


def as_covered(scenario: Scenario, spec: StrategySpec | None = None) -> Scenario:
    """The scenario with its strategy's own altitude as that of the scan: to be planned, not to be flown.

    ``spec`` is for a strategy that is not called by its name. A plan drawn for another altitude is left out,
    as in a mission. Raises UserError where there is no such strategy, or it covers the area from no height
    that may be flown.
    """
    spec = strategy_spec(scenario.search.strategy) if spec is None else spec
    altitude_agl_m = spec.cover_altitude_of(scenario)
    if altitude_agl_m == scenario.search.scan_altitude_agl_m:
        return scenario
    search = scenario.search.model_copy(update={"scan_altitude_agl_m": altitude_agl_m, "plan": None})
    return scenario.model_copy(update={"search": search})
