"""Plans of coverage."""

from __future__ import annotations

from dataclasses import dataclass

from skysweep.api.scenarios import ScenarioLike, load_scenario
from skysweep.arrays import F64
from skysweep.planning.advice import warnings_for
from skysweep.planning.coverage import CoveragePlan
from skysweep.planning.flight_plan import FlightEstimate, plan_scenario
from skysweep.scenarios.model import Scenario


@dataclass(frozen=True, slots=True)
class Plan:
    """The scan of a scenario's area and its cost. Shown as a picture in notebooks."""

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

        return plan_png(self.scenario, self.coverage, self.estimate)


def plan(scenario: ScenarioLike) -> Plan:
    """Plan the scan of a scenario's area. Raises UserError if there is no such scenario or no flight."""
    chosen = load_scenario(scenario)
    return Plan(chosen, *plan_scenario(chosen), tuple(warnings_for(chosen)))
