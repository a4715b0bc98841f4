"""What paths may find, beside what no path can beat."""

import numpy as np
import pytest
from maps_of_all_kinds import MAPS

from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.planning.prior.planned_sortie import plan_sortie
from skysweep.planning.prior.report import expected_pos

FRAME = LocalFrame(60.2, 22.1)


def cells_of(poa, cell_m=10.0):
    return ProbabilityMap(poa / poa.sum(), cell_m, np.zeros(2), FRAME)


def test_definite_range_finds_the_share_of_each_cell_that_is_swept():
    """Along the first row, half a cell wide, and back over one of its cells, then a whole cell wide."""
    cells = cells_of(np.array([[4.0, 2.0, 2.0], [1.0, 1.0, 0.0]]))
    row = np.array([[0.0, 5.0], [30.0, 5.0], [20.0, 5.0]])
    assert expected_pos(cells, [row], 5.0).definite_pos == pytest.approx(0.2 + 0.1 + 0.2)
    assert expected_pos(cells, [row], 10.0).definite_pos == pytest.approx(0.8)


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("width_m", [3.0, 10.0, 14.0, 40.0])
@pytest.mark.parametrize("turned", [0.0, 0.4, 0.785])
def test_no_path_beats_its_bounds(name, width_m, turned):
    """Legs over the middle, a sweep apart, at any angle."""
    cells = cells_of(MAPS[name])
    aside = width_m * (np.arange(9) - 4.0)
    legs = np.array([[x, y] for k, x in enumerate(aside) for y in (200.0, -200.0)[:: 1 - 2 * (k % 2)]])
    axes = np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]])
    found = expected_pos(cells, [600.0 + legs @ axes], width_m)
    assert (found.pos <= found.bound + 1e-12).all()
    assert found.pos[-1] <= found.definite_pos <= found.definite_bound + 1e-12


@pytest.mark.parametrize(("name", "budget_m", "width_m"), [("wide", 27e3, 5.0), ("ring", 7.2e3, 10.0)])
def test_no_plan_beats_the_bound_of_definite_range(name, budget_m, width_m):
    """Over wide cells, and on diagonal legs."""
    found = plan_sortie(cells_of(MAPS[name]), (600.0, 600.0), budget_m, width_m, 1).expected
    assert 0.7 * found.definite_bound < found.definite_pos <= found.definite_bound
