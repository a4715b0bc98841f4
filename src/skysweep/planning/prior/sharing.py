"""One long path shared out among several vehicles."""

from __future__ import annotations

import numpy as np

from skysweep.planning.prior.growth import Paths


def shared_out(path: Paths, vehicles: int, budget_m: float) -> Paths:
    """Consecutive parts of one path, each with the way there from the start, within the budget each.

    Route first, cluster second: Beasley, "Route first - cluster second methods for vehicle routing", Omega 11
    (1983). What no vehicle gets to is left out.
    """
    visits = path.visits(0)[1:]
    places, start = path.xy_m(visits), path.starts_xy_m[0]
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    ways = np.linalg.norm(places - start, axis=1)
    routes, first = [], 0
    for _ in range(vehicles):
        end = first
        if first < len(visits):
            reach_m = budget_m - ways[first] + along[first]
            end = max(int(np.searchsorted(along, reach_m, side="right")), first)
        routes.append(path.nodes[visits[first:end]])
        first = end
    return Paths.through(path.lattice, np.tile(start, (vehicles, 1)), budget_m, routes)
