"""A mission at night with a thermal camera, from take-off to the report."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import skysweep
from skysweep.scenarios.files import change_scenario, load_scenario

ROOT = Path(__file__).parents[2]
BRIGHT = 215
CHANGES = {
    "area.polygon_enu_m": [[300, 450], [360, 450], [360, 500], [300, 500]],
    "home.position_enu_m": [290, 440],
    "search.scan_altitude_agl_m": 40,
    "generators": [
        {"class": "person", "pattern": "uniform", "count": 2, "poses": ["lying"], "min_separation_m": 20}
    ],
}


class BrightSpots:
    """Calls everything bright a person. Implements ``types.Detector``."""

    class_names = ("person",)

    def detect(self, frame: skysweep.Frame) -> skysweep.Detections:
        _, bright = cv2.threshold(frame.image[..., 0], BRIGHT, 255, cv2.THRESH_BINARY)
        spots = cv2.connectedComponentsWithStats(bright)[2][1:, :4].astype(float)
        spots = spots[(spots[:, 2:].max(axis=1) > 6) & (spots[:, 2:].max(axis=1) < 120)]
        boxes = np.column_stack([spots[:, :2], spots[:, :2] + spots[:, 2:]])
        confidences, names = np.full(len(boxes), 0.8), ("person",) * len(boxes)
        return skysweep.Detections(frame.time_s, boxes, confidences, names, frame.camera, frame.lens)


@pytest.mark.slow
def test_persons_are_found_by_their_warmth(tmp_path: Path) -> None:
    night = change_scenario(load_scenario("night"), CHANGES)
    run = skysweep.run(night, seed=1, detector=BrightSpots(), out=tmp_path / "run")
    assert run.summary["n_confirmed"] == run.summary["n_targets"] == 2
    looks = [json.loads(line) for line in (tmp_path / "run" / "journal.jsonl").read_text().splitlines()]
    assert not any(look.get("doubt") for look in looks if look["kind"] == "look")
    kept = cv2.imread(str(next((tmp_path / "run" / "pictures").glob("*.jpg"))))
    assert (kept == kept[..., :1]).mean() > 0.9  # grey, but for what is drawn on it
