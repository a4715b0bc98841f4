"""The measurement of what a page costs; how much it is on a machine, is no test."""

import pytest

from skysweep.web import cost


@pytest.mark.slow
def test_missions_are_flown_in_pairs_with_and_without_a_page(run, monkeypatch):
    monkeypatch.setattr(cost, "_SCENARIO", str(run / "config.yaml"))
    monkeypatch.setattr(cost, "_PAIRS", 1)
    flown, speed = [], cost._speed
    monkeypatch.setattr(
        cost, "_speed", lambda folder, watched: flown.append(watched) or speed(folder, watched)
    )
    assert -5.0 < cost.live_view_cost() < 1.0
    assert flown == [False, True, False]
