"""A mission is slowed down to a speed, and what is flown again is not."""

import time

import numpy as np
import pytest

from skysweep.flights.pace import Pace
from skysweep.types import Mode


class At:
    """Stands for a state: its time is all that a pace reads."""

    def __init__(self, time_s):
        self.time_s = time_s


def lasted(pace, until_s):
    started = time.monotonic()
    for time_s in np.arange(0.0, until_s, 0.1).tolist():
        pace.watch(At(time_s), Mode.SCAN, None)
    return time.monotonic() - started


def test_time_passes_no_faster_than_asked_for():
    pace = Pace(20.0)
    pace.hear({})
    assert lasted(pace, 10.0) == pytest.approx(0.5, abs=0.1)


def test_what_is_flown_again_is_not_slowed_down():
    assert lasted(Pace(1.0), 10.0) < 0.1


def test_a_halt_is_not_made_up_for():
    pace = Pace(20.0)
    pace.hear({})
    lasted(pace, 1.0)
    time.sleep(0.6)
    started = time.monotonic()
    for k in range(1, 101):
        pace.watch(At(1.0 + 0.1 * k), Mode.SCAN, None)
    assert time.monotonic() - started > 0.25
