"""Plans of coverage."""

from __future__ import annotations

from dataclasses import dataclass

from skysweep.api.scenarios import ScenarioLike, load_scenario
from skysweep.arrays import F64
from skysweep.planning.advice import warnings_for
from skysweep.planning.coverage import CoveragePlan
from skysweep.planning.flight_plan import FlightEstimate, plan_scenario
from skysweep.scenarios.model import Scenario
from skysweep.strategies.covering import as_covered


@dataclass(frozen=True, slots=True)
class Plan:
    """How a scenario's strategy covers its area, and the cost. Shown as a picture in notebooks."""

    scenario: Scenario
    coverage: CoveragePlan
    estimate: FlightEstimate  # time, energy, batteries, pixels on target ...
    advice: tuple[str, ...]  # probable problems, a sentence each

    @property
    def waypoints(self) -> F64:
        """(N, 2) east and north in metres, in the order of flight."""
        return self.coverage.waypoints_xy_enu_m

    def __repr__(self) -> str:
        """One line."""
        e = self.estimate
        return (
            f"Plan({self.scenario.name}: {e.n_transects} transects, {e.path_length_m:.0f} m, "
            f"{e.time_s / 60:.1f} min, batteries: {e.batteries})"
        )

    def _repr_png_(self) -> bytes:
        from skysweep.planning.picture import plan_png

        return plan_png(as_covered(self.scenario), self.coverage, self.estimate)


def plan(scenario: ScenarioLike) -> Plan:
    """Plan how a scenario's area is covered, from the altitude of its ``search.strategy``.

    Raises UserError if there is no such scenario or strategy, or no flight.
    """
    chosen = load_scenario(scenario)
    covered = as_covered(chosen)
    altitude_agl_m = covered.search.scan_altitude_agl_m
    return Plan(chosen, *plan_scenario(covered), tuple(warnings_for(chosen, altitude_agl_m)))
