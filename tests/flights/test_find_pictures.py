"""Finds of a mission with pictures are told with the picture that confirmed them."""

import json
from pathlib import Path

import cv2
import numpy as np

from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import project
from skysweep.scenarios.model import Scenario
from skysweep.types import Detections, Frame

SIGNS = {
    "name": "signs",
    "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
    "home": {"position_enu_m": [-5, -5]},
    "targets": [
        {"class": "stop sign", "position_enu_m": [20, 20], "size_m": 0.9},
        {"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9},
    ],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 2, "check_speed_mps": 2.0},
}


class Camera:
    """Each picture is one grey: the second of its exposure."""

    renderer = None

    def __init__(self, lens):
        self.lens = lens

    def capture(self, state):
        image = np.full((self.lens.height_px, self.lens.width_px, 3), int(state.time_s), np.uint8)
        return Frame(state.time_s, image, state.camera, self.lens)

    def close(self):
        pass


class Knowing:
    """A detector that knows where the targets are."""

    class_names = ("stop sign",)

    def detect(self, frame):
        places = np.array([[*target["position_enu_m"], 0.0] for target in SIGNS["targets"]])
        pixels, depth = project(frame.lens, frame.camera, places)
        inside = (depth > 0) & (np.abs(pixels - (320, 180)) < (310, 170)).all(axis=1)
        seen, half = pixels[inside], frame.lens.pixels_on_target(0.45, depth[inside])[:, None]
        n = len(seen)
        boxes = np.column_stack([seen - half, seen + half])
        return Detections(frame.time_s, boxes, np.full(n, 0.99), ("stop sign",) * n, frame.camera, frame.lens)


def test_each_find_of_one_descent_has_the_picture_that_confirmed_it(tmp_path):
    scenario, said = Scenario.model_validate(SIGNS), []
    rig = Rig(camera=Camera(scenario.camera.lens), detector=Knowing(), say=said.append)
    fly_to_folder(scenario, 0, tmp_path, rig)
    lines = [json.loads(text) for text in (tmp_path / "journal.jsonl").read_text().splitlines()]
    confirmed = [line for line in lines if line["kind"] == "confirmed"]
    finds = [words for words in said if words.startswith("found")]
    assert len(finds) == len(confirmed) == 2
    for words, line in zip(finds, confirmed, strict=True):
        path = Path(words.partition(", picture ")[2])
        assert path.parent == tmp_path / "pictures"
        assert path.name.startswith(f"candidate-{line['candidate']}-")
        seen = [s["t"] for s in lines if s["kind"] == "sighting" and s["candidate"] == line["candidate"]]
        grey = int(cv2.imread(str(path))[5, 5, 0])
        assert min(abs(grey - int(t)) for t in seen if t <= line["t"]) <= 1
