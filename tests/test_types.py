"""The small values that flow through a mission."""

import numpy as np
import pytest

from skysweep.geometry.camera import CameraPose, Lens
from skysweep.types import Candidate, Look, Sighting

LENS = Lens(640, 360, 1.4)
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
EYE = CameraPose(np.array([10.0, 20.0, 30.0]), DOWN)


def candidate(number, x, y):
    return Candidate(number, "boat", np.array([x, y, 0.0]), np.eye(2), 0.0, 0.0, (0.5,))


def test_a_look_knows_what_it_missed():
    hit = Sighting(1, True, 0.0, np.array([10.0, 20.0, 0.0]), 0.5, 30.0)
    known = {c.id: c for c in (candidate(1, 10, 20), candidate(2, 15, 22), candidate(3, 80, 20))}
    assert Look(0.0, EYE, LENS, (hit,)).misses(known) == (2,)
    assert Look(0.0, EYE, LENS).misses({}) == ()


def test_a_look_knows_the_ground_in_its_picture():
    corners = Look(0.0, EYE, LENS).footprint_enu_m(2.0)
    width, height = LENS.footprint_m(28.0)
    assert np.ptp(corners[:, 0]) == pytest.approx(width)
    assert np.ptp(corners[:, 1]) == pytest.approx(height)
    assert corners.mean(axis=0) == pytest.approx([10.0, 20.0, 2.0])


def test_a_corner_above_the_horizon_sees_no_ground():
    level = CameraPose(EYE.position_enu_m, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))
    corners = Look(0.0, level, LENS).footprint_enu_m(0.0)
    assert np.isnan(corners).all(axis=1).sum() == 2
