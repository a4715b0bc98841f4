"""What paths may be expected to find, beside what no path can beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skysweep.arrays import F64
from skysweep.planning.prior.allocation import ideal_pos, ideal_pos_definite
from skysweep.planning.prior.checks import way_to_map
from skysweep.planning.prior.coverage import beginning, coverage_of, length_of
from skysweep.planning.prior.maps import ProbabilityMap

_POINTS = 20  # of the curve


@dataclass(frozen=True)
class ExpectedPos:
    """Probability of success against length flown, all vehicles together. Shares of the map."""

    length_m: F64  # (N,) from 0 on
    pos: F64  # (N,) exponential detection
    bound: F64  # (N,) of an ideal allocation of as much effort
    bound_from_start: F64  # (N,) the same of what is left after the straight way to the map
    definite_pos: float  # at the end, where the part of a cell that is swept is found for sure
    definite_bound: float  # of the best cells that as much effort covers once


def expected_pos(cells: ProbabilityMap, paths_xy_m: Sequence[F64], sweep_width_m: float) -> ExpectedPos:
    """What paths (K, 2) each may be expected to find, flown together, each by the same share."""
    lengths = np.array([length_of(path) for path in paths_xy_m])
    shares = np.linspace(0.0, 1.0, _POINTS + 1)
    ways_m = [way_to_map(cells.poa, cells.cell_size_m, cells.origin_xy_m, path[0]) for path in paths_xy_m]
    way_m = sum(max(way - sweep_width_m / 2.0, 0.0) for way in ways_m)  # beside a path it sees as far
    effort_per_m = sweep_width_m / cells.cell_size_m**2
    flown = shares * lengths.sum()
    coverages = [
        coverage_of(
            [beginning(path, share * length) for path, length in zip(paths_xy_m, lengths, strict=True)],
            cells.poa.shape,
            cells.cell_size_m,
            cells.origin_xy_m,
            sweep_width_m,
        )
        for share in shares
    ]
    bounds = [
        [ideal_pos(cells.poa, max(m, 0.0) * effort_per_m) for m in flown - less] for less in (0.0, way_m)
    ]
    return ExpectedPos(
        length_m=flown,
        pos=np.array([np.sum(cells.poa * -np.expm1(-coverage)) for coverage in coverages]),
        bound=np.array(bounds[0]),
        bound_from_start=np.array(bounds[1]),
        definite_pos=float(np.sum(cells.poa * np.minimum(coverages[-1], 1.0))),
        definite_bound=ideal_pos_definite(cells.poa, float(flown[-1]) * effort_per_m),
    )
