"""Somebody takes the vehicle over, at every moment: never overruled, always said. On the look-alike."""

from __future__ import annotations

import itertools

import pytest
from look_alike import LookAlike
from takeovers import FAILSAFES, NOBODY, ON_LOSS, PHASES, WHO, Cell, cells, play

_STICKS_EVERY_S = 0.05
_HEARTBEAT_EVERY_S = 1.0


def faults(cell: Cell) -> list[str]:
    there = LookAlike(cell.on_loss)
    return play(cell, there).faults(cell)


def every(n, things):
    """The others only where everything is tried."""
    return [t if k % n == 0 else pytest.param(*t, marks=pytest.mark.exhaustive) for k, t in enumerate(things)]


@pytest.mark.parametrize(("phase", "on_loss"), every(2, itertools.product(PHASES, ON_LOSS)))
def test_whoever_takes_it_in_a_phase_keeps_it(phase, on_loss):
    chosen = [c for c in cells() if not c.gap_s and (c.phase, c.on_loss) == (phase, on_loss)]
    assert {c.who for c in chosen} == set(WHO)
    wrong = {str(cell): found for cell in chosen if (found := faults(cell))}
    assert not wrong


GAPS = sorted({(c.on_loss, c.gap_s, c.after_s) for c in cells() if c.gap_s})


@pytest.mark.parametrize(("on_loss", "gap_s", "after_s"), every(5, GAPS))
def test_whoever_takes_it_around_a_gap_of_the_link_keeps_it(on_loss, gap_s, after_s):
    chosen = [c for c in cells() if (c.on_loss, c.gap_s, c.after_s) == (on_loss, gap_s, after_s)]
    wrong = {str(cell): found for cell in chosen if (found := faults(cell))}
    assert not wrong


def test_there_are_enough_cells():
    everything = cells()
    assert len(set(everything)) == len(everything) >= 300
    assert {c.who for c in everything} == {*WHO, NOBODY}
    assert set(FAILSAFES) < {c.who for c in everything if c.gap_s == 0.0}
