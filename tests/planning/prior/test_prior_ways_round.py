"""Paths round places where nobody may fly."""

import numpy as np
import pytest
import shapely

from skysweep.errors import UserError
from skysweep.planning.prior.coverage import length_of
from skysweep.planning.prior.ways_round import cut_to, led_round

WALL = shapely.box(40.0, -50.0, 60.0, 50.0)


def round_the_wall(start, goal):
    """Over its northern corners; none leads into it."""
    if WALL.contains(shapely.Point(goal)):
        return []
    if not WALL.crosses(shapely.LineString([start, goal])):
        return [goal]
    corners = [(40.0, 50.0), (60.0, 50.0)]
    return [*(corners if start[0] < goal[0] else corners[::-1]), goal]


def test_legs_lead_round_and_what_cannot_be_reached_is_left_out():
    path = np.array([[0.0, 0.0], [20.0, 0.0], [50.0, 10.0], [100.0, 0.0], [0.0, 10.0]])
    led = led_round(path, round_the_wall)
    assert not WALL.crosses(shapely.LineString(led))
    assert led.tolist() == [[0, 0], [20, 0], [40, 50], [60, 50], [100, 0], [60, 50], [40, 50], [0, 10]]


def test_a_path_that_leads_nowhere_is_refused():
    with pytest.raises(UserError, match="start: no way leads from there"):
        led_round(np.array([[0.0, 0.0], [50.0, 0.0]]), round_the_wall)


def test_a_path_is_cut_to_its_budget():
    path = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 40.0]])
    assert cut_to(path, 80.0) is path
    assert length_of(cut_to(path, 50.0)) == pytest.approx(50.0)
    assert cut_to(path, 50.0)[-1] == pytest.approx([30.0, 20.0])
