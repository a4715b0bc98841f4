"""Where ground was searched too weakly, and whether another look at it pays."""

import json

import numpy as np
import pytest
from contexts import context_of

from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.strategies.belief.ground import Ground
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.types import Look

CONTEXT = context_of()
HEIGHT_M = CONTEXT.search.scan_altitude_agl_m
WEST, SOUTH, EAST, NORTH = CONTEXT.area_enu_m.bounds
HERE = (EAST, NORTH)


def searched(but=lambda x, y: False):
    """The ground after a scan whose looks all count, but those from some places."""
    ground, time_s = Ground(CONTEXT, BeliefParameters()), 0.0
    R = rotation_camera_to_enu(CONTEXT.yaw_rad, CONTEXT.gimbal_pitch_rad)
    for x in np.arange(WEST, EAST + 10.0, 15.0):
        for y in np.arange(SOUTH, NORTH + 10.0, 5.0):
            time_s += 1.0
            if not but(x, y):
                ground.take(Look(time_s, CameraPose(np.array([x, y, HEIGHT_M]), R), CONTEXT.lens))
    return ground


def in_the_south_west(x, y):
    return x < WEST + 70.0 and y < SOUTH + 50.0


def test_what_was_searched_well_is_left():
    ground = searched()
    assert ground.pod[ground.pod > 0.0].min() > 0.9
    assert ground.again(HERE, HEIGHT_M, 5.0) is None


def test_what_was_not_seen_is_looked_at_where_that_pays():
    ground = searched(in_the_south_west)
    (x, y, _), buys_s, takes_s = ground.again(HERE, HEIGHT_M, 5.0)
    assert in_the_south_west(x, y)
    assert buys_s > takes_s > np.hypot(x - HERE[0], y - HERE[1]) / BeliefParameters().check_speed_mps


@pytest.mark.parametrize(("found", "missed_cost_s"), [(0.0, 1000.0), (0.001, 1000.0), (5.0, 1.0)])
def test_nobody_is_sought_where_nobody_is_expected_or_it_costs_nothing(found, missed_cost_s):
    ground = searched(in_the_south_west)
    ground._missed_cost_s = missed_cost_s
    assert ground.again(HERE, HEIGHT_M, found) is None


def test_a_place_is_looked_at_again_once():
    ground, places = searched(in_the_south_west), []
    while (worth := ground.again(HERE, HEIGHT_M, 500.0)) is not None:
        places.append(worth[0])
        assert len(places) < 20
    assert 1 < len(places) == len(set(places))


def test_a_snapshot_keeps_how_well_each_cell_was_searched():
    ground, again = searched(in_the_south_west), Ground(CONTEXT, BeliefParameters())
    again.restore(json.loads(json.dumps(ground.snapshot())))
    assert np.abs(again.pod - ground.pod).max() <= 1.0 / 255.0
    place, *_ = again.again(HERE, HEIGHT_M, 5.0)
    assert in_the_south_west(*place[:2])
