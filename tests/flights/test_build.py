"""Parts that somebody else's installed package brings."""

import sys

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.model import Scenario
from skysweep.strategies import strategy_names

SCENARIO = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [40, 0], [40, 20], [0, 20]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [{"class": "stop sign", "position_enu_m": [20, 10], "size_m": 0.9}],
    "camera": {"width_px": 160, "height_px": 90},
}

MODULE = """
import numpy as np
from skysweep.strategies import StrategySpec
from skysweep.strategies.baselines import SingleAltitude
from skysweep.types import Detections

halfway = StrategySpec(lambda context: SingleAltitude(context, 17.0), lambda _search: 17.0)


class Middle:
    class_names = ("stop sign",)

    def detect(self, frame):
        middle = np.array([[frame.lens.width_px / 2, frame.lens.height_px / 2] * 2])
        box = middle + [-3, -3, 3, 3]
        return Detections(frame.time_s, box, np.array([0.9]), ("stop sign",), frame.camera, frame.lens)


def middle(scenario):
    return Middle()
"""


@pytest.fixture
def third_party(tmp_path, monkeypatch):
    (tmp_path / "theirs.py").write_text(MODULE)
    info = tmp_path / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[skysweep.strategies]\nhalfway = theirs:halfway\n[skysweep.detectors]\nmiddle = theirs:middle\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("theirs", None)


@pytest.mark.usefixtures("third_party")
def test_a_registered_strategy_and_detector_fly():
    assert "halfway" in strategy_names()
    scenario = Scenario.model_validate(
        SCENARIO | {"search": {"strategy": "halfway"}, "detector": {"model": "middle"}}
    )
    journal = MemoryJournal()
    mission = build_mission(scenario, 0, Rig("imaging"))
    assert fly(mission, journal) == "completed"
    mission.sensor.close()
    heights = [s["p"][2] for s in journal.lines if s["kind"] == "state" and s["mode"] == "SCAN"]
    assert np.median(heights) == pytest.approx(17.0, abs=0.5)
    assert any(line["kind"] == "confirmed" for line in journal.lines)


def test_pictures_that_take_gigabytes_to_render_are_refused():
    area = {"polygon_enu_m": [[0, 0], [40, 0], [40, 30], [0, 30]]}
    camera = {"width_px": 8192, "height_px": 8192}
    scenario = Scenario.model_validate({"name": "sharp", "area": area, "camera": camera})
    with pytest.raises(
        UserError, match=r"camera\.width_px: 8192 x 8192 pixels are more than can be rendered"
    ):
        build_mission(scenario, 0, Rig("imaging"))
