"""What a strategy makes of a scenario's coverage."""

from __future__ import annotations

from skysweep.scenarios.model import Scenario
from skysweep.strategies import strategy_spec


def as_covered(scenario: Scenario) -> Scenario:
    """The scenario with its strategy's own altitude as that of the scan: to be planned, not to be flown.

    A plan drawn for another altitude is left out, as in a mission. Raises UserError where there is no such
    strategy, or it covers the area from no height that may be flown.
    """
    altitude_agl_m = strategy_spec(scenario.search.strategy).cover_altitude_of(scenario)
    if altitude_agl_m == scenario.search.scan_altitude_agl_m:
        return scenario
    search = scenario.search.model_copy(update={"scan_altitude_agl_m": altitude_agl_m, "plan": None})
    return scenario.model_copy(update={"search": search})
