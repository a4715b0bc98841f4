"""What ends 'skysweep fly' from outside."""

import os
import signal
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.cli.fly import _end_on_signals
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.model import Scenario

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

SMALL = {"name": "small", "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]}}


@pytest.fixture(autouse=True)
def handlers():
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class Around:
    def __init__(self, inner):
        self.inner = inner

    def __getattr__(self, name):
        return getattr(self.inner, name)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_the_detector_answers_ends_the_mission_in_hold(number):
    """A mission survives every ``Exception`` of its detector: the end must not be one."""
    asked = []

    class Sensor(Around):
        def sense(self, state):
            if state.time_s > 20.0:
                signal.raise_signal(number)
            return self.inner.sense(state)

    class Vehicle(Around):
        def hold(self):
            signal.raise_signal(signal.SIGHUP)  # the next one, as a shell sends it
            signal.raise_signal(signal.SIGTERM)
            asked.append("hold")
            self.inner.hold()

    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored
    _end_on_signals()
    mission = build_mission(Scenario.model_validate(SMALL), 0, Rig("statistical"))
    mission = replace(mission, sensor=Sensor(mission.sensor), vehicle=Vehicle(mission.vehicle))
    with pytest.raises(SystemExit) as ended:
        fly(mission, MemoryJournal())
    assert ended.value.code == 128 + number
    assert asked == ["hold"]


def test_sound_lines_are_those_of_a_run_folder():
    told = CliRunner().invoke(app, ["fly", "clusters", "--from-sound-lines"])
    assert told.exit_code == 2
    assert "--from-sound-lines: clusters is no run folder to go on with; leave it out" in told.stderr


def test_nohup_is_respected():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    _end_on_signals()
    signal.raise_signal(signal.SIGHUP)
    with pytest.raises(SystemExit):
        signal.raise_signal(signal.SIGTERM)
