from __future__ import annotations

import numpy as np

from skysweep.ros.messages import TEXT
from skysweep.ros.targets import TargetBoard


def sighting(candidate, p):
    return {"kind": "sighting", "candidate": candidate, "class_name": "person", "p": p}


def test_a_target_is_seen_then_confirmed_where_the_verdict_says():
    board = TargetBoard()
    assert board.note(sighting(1, [1, 2, 0]))
    assert not board.note(sighting(1, [9, 9, 0]))
    assert board.note(
        {"kind": "confirmed", "candidate": 1, "p": [1.5, 2, 0], "covariance_m2": [[4, 0], [0, 1]]}
    )
    target = board.targets[1]
    assert target.standing == "confirmed"
    assert target.position_enu_m.tolist() == [1.5, 2, 0]
    assert np.isclose(target.radius_95_m, 2 * np.sqrt(5.991))


def test_other_records_change_nothing():
    board = TargetBoard()
    position = {"kind": "state", "p": [0, 0, 0]}
    for record in (position, {"kind": "waypoint_reached"}, {"kind": "rejected", "candidate": 3}):
        assert not board.note(record)
    assert board.marks() == []


def test_every_target_has_a_disc_and_a_label():
    board = TargetBoard()
    board.note(sighting(1, [1, 2, 0]))
    board.note(sighting(2, [5, 2, 0]))
    assert [mark.text for mark in board.marks() if mark.kind == TEXT] == ["1 person seen", "2 person seen"]
    assert len(board.marks()) == 4
