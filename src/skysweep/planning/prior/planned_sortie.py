"""A sortie over a map: paths for each vehicle, what they may find, and the map if they find nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from skysweep.arrays import F64
from skysweep.geometry.areas import headings_of
from skysweep.planning.coverage import CoveragePlan
from skysweep.planning.prior.allocation import ideal_pos
from skysweep.planning.prior.coverage import length_of
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.planning.prior.report import ExpectedPos, expected_pos
from skysweep.planning.prior.search import plan_search
from skysweep.planning.prior.ways_round import Way, cut_to, led_round

_TRIES = 3  # with budgets that leave room for the ways round
_UNUSED = 0.05  # of the budget, that is worth saying


@dataclass(frozen=True)
class PlannedSortie:
    """What is flown over a map. ENU metres of the map's frame."""

    before: ProbabilityMap
    paths_xy_m: tuple[F64, ...]  # (K, 2) each
    budget_m: float
    sweep_width_m: float
    seed: int
    expected: ExpectedPos
    after: ProbabilityMap  # when nothing was found

    @property
    def hull(self) -> shapely.Polygon:
        """Where the paths are, half a sweep wider."""
        around = shapely.MultiPoint(np.concatenate(self.paths_xy_m)).convex_hull
        return around.buffer(self.sweep_width_m / 2.0, join_style="mitre")

    @property
    def unused_m(self) -> float:
        """How much of the budget is not flown; 0 where that is not worth saying."""
        unused_m = self.budget_m - float(self.expected.length_m[-1])
        return unused_m if unused_m > _UNUSED * self.budget_m else 0.0

    @property
    def bound_of_budget(self) -> float:
        """What an ideal searcher finds with all of the budget."""
        cells = self.before
        return ideal_pos(cells.poa, self.budget_m * self.sweep_width_m / cells.cell_size_m**2)

    def as_coverage(self, vehicle: int) -> CoveragePlan:
        """One vehicle's path as a plan that can be exported; each leg is a transect."""
        path = self.paths_xy_m[vehicle]
        legs = np.stack([path[:-1], path[1:]], axis=1)
        lengths = np.linalg.norm(legs[:, 1] - legs[:, 0], axis=1)
        heading = float(headings_of(legs)[np.argmax(lengths)] % 180.0)
        return CoveragePlan(
            path, tuple(legs), self.sweep_width_m, self.sweep_width_m, heading, length_of(path)
        )

    def as_json(self) -> dict[str, Any]:
        """The figures of the sortie; probabilities are shares of the map."""
        expected = self.expected
        return {
            "budget_m": self.budget_m,
            "sweep_width_m": self.sweep_width_m,
            "seed": self.seed,
            "cell_size_m": self.before.cell_size_m,
            "path_lengths_m": [length_of(path) for path in self.paths_xy_m],
            "pos": float(expected.pos[-1]),
            "bound": float(expected.bound[-1]),
            "bound_from_start": float(expected.bound_from_start[-1]),
            "bound_of_budget": self.bound_of_budget,
            "unused_m": self.unused_m,
            "definite_pos": expected.definite_pos,
            "definite_bound": expected.definite_bound,
            "curve": {
                "length_m": expected.length_m.tolist(),
                "pos": expected.pos.tolist(),
                "bound": expected.bound.tolist(),
                "bound_from_start": expected.bound_from_start.tolist(),
            },
        }


def plan_sortie(
    cells: ProbabilityMap,
    start_xy_m: Sequence[float] | F64,
    budget_m: float,
    sweep_width_m: float,
    n_uavs: int,
    seed: int = 0,
    on_step: Callable[[int, int], None] = lambda done, of: None,
    way: Way | None = None,
) -> PlannedSortie:
    """Plan a sortie, as ``plan_search`` does, over a map; legs are led along ``way`` where there is one.

    Raises UserError as ``plan_search`` does, and where no way leads to the map.
    """
    asked_m, best, found = budget_m, list[F64](), -1.0
    for _ in range(_TRIES):
        straight = plan_search(
            cells.poa,
            cells.cell_size_m,
            cells.origin_xy_m,
            start_xy_m,
            asked_m,
            sweep_width_m,
            n_uavs,
            seed,
            on_step,
        )
        led = straight if way is None else [led_round(path, way) for path in straight]
        paths = [cut_to(path, budget_m / n_uavs) for path in led]
        pos = cells.pos_of(cells.coverage_by(paths, sweep_width_m))
        if pos > found:
            best, found = paths, pos
        over = max(map(length_of, led)) / (budget_m / n_uavs)
        if over <= 1.0 + 1e-9:
            break
        asked_m /= over
    return PlannedSortie(
        cells,
        tuple(best),
        budget_m,
        sweep_width_m,
        seed,
        expected_pos(cells, best, sweep_width_m),
        cells.after_search(best, sweep_width_m),
    )
