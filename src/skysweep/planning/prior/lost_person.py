"""Where a person lost on land may be, from the place where they were last known to be.

Distances from the initial planning point to where people were found: Koester, "Lost Person Behavior" (dbS
Productions 2008), tables "Distance (horizontal) from the IPP", of the International Search and Rescue
Incident Database. The numbers here are from secondary copies of these tables, in miles, rounded to 100 m:
check them against the book before a search relies on them. Other categories are given as ``Distances`` of
one's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skysweep.errors import UserError
from skysweep.planning.prior.checks import checked_poa, place
from skysweep.planning.prior.maps import ProbabilityMap

SHARES = (0.25, 0.50, 0.75, 0.95)
_FARTHEST = 2.0  # times the last distance: within it lie the last 5 %, of whom the tables say no more
_SAMPLES = 5  # along a cell's side


@dataclass(frozen=True)
class Distances:
    """Within which distances 25, 50, 75 and 95 % were found."""

    category: str
    ecoregion: str
    within_m: tuple[float, float, float, float]


KOESTER_2008 = (
    Distances("hiker", "temperate mountainous", (1100.0, 3100.0, 5800.0, 18_300.0)),
    Distances("hiker", "temperate flat", (600.0, 1800.0, 3200.0, 9900.0)),
    Distances("hiker", "dry mountainous", (1600.0, 3200.0, 6500.0, 19_300.0)),
    Distances("hiker", "dry flat", (1300.0, 2100.0, 6600.0, 13_100.0)),
    Distances("dementia", "temperate mountainous", (300.0, 800.0, 1900.0, 8300.0)),
    Distances("dementia", "temperate flat", (300.0, 1000.0, 2400.0, 12_800.0)),
    Distances("dementia", "dry mountainous", (1000.0, 1900.0, 3100.0, 6100.0)),
    Distances("dementia", "dry flat", (500.0, 1600.0, 3600.0, 11_800.0)),
    Distances("dementia", "urban", (300.0, 1100.0, 3200.0, 12_600.0)),
)


def distances_of(category: str, ecoregion: str) -> Distances:
    """The published distances. Raises UserError with those that there are."""
    for row in KOESTER_2008:
        if (row.category, row.ecoregion) == (category, ecoregion):
            return row
    known = "; ".join(f"{row.category}, {row.ecoregion}" for row in KOESTER_2008)
    raise UserError(
        f"category: '{category}, {ecoregion}' is not in the table; write one of {known}, or own distances"
    )


def around_last_known_position(
    cells: ProbabilityMap, position_xy_m: ArrayLike, distances: Distances
) -> ProbabilityMap:
    """The map of a person lost at a place (2,): equally dense within each ring between two distances.

    ``cells`` gives the cells; what lies beyond them is left out (``with_share`` tells how much). Raises
    UserError where distances do not rise, or no cell is within them.
    """
    return with_share(cells, position_xy_m, distances)[0]


def with_share(
    cells: ProbabilityMap, position_xy_m: ArrayLike, distances: Distances
) -> tuple[ProbabilityMap, float]:
    """The same map, and the probability that the person is on it at all."""
    centre, rings = place(position_xy_m, "position_xy_m"), np.array(distances.within_m, dtype=float)
    if rings.shape != (len(SHARES),) or not (np.diff(rings, prepend=0.0) > 0.0).all():
        raise UserError("within_m: write four rising distances in metres, for 25, 50, 75 and 95 %")
    edges = np.append(rings, _FARTHEST * rings[-1])
    shares = np.diff([0.0, *SHARES, 1.0])
    density = np.append(shares / (np.pi * np.diff(np.append(0.0, edges) ** 2)), 0.0)
    poa = np.zeros(cells.poa.shape)
    for k in range(_SAMPLES**2):
        aside = cells.cell_size_m * ((np.array([k % _SAMPLES, k // _SAMPLES]) + 0.5) / _SAMPLES - 0.5)
        away_m = np.linalg.norm(cells.centres_xy_m + aside - centre, axis=-1)
        poa += density[np.searchsorted(edges, away_m)]
    if not poa.any():
        raise UserError(
            "position_xy_m: lies farther from the map than anybody is found; check it, or make the map there"
        )
    share = min(1.0, float(poa.sum()) * (cells.cell_size_m / _SAMPLES) ** 2)
    return cells.with_poa(checked_poa(poa)), share
