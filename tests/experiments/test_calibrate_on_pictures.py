import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.detection.training.labelled import LabelledDataset, LabelledImage
from skysweep.errors import UserError
from skysweep.experiments.calibration import from_pictures
from skysweep.experiments.calibration.figure import _NO_SHIFT, drawn_rates
from skysweep.experiments.calibration.from_pictures import calibrate_on_pictures
from skysweep.sensing.statistical.model import StatisticalModel, score_of
from skysweep.types import Detections

NONE = np.zeros((0, 4))
SIZE = 640, 360


class Known:
    """Finds every person of 20 px or more with confidence 0.7, none below, and something where nothing is."""

    answers: dict[int, list]

    def __init__(self, *_, **__):
        self.class_names = ("person", "stop sign")

    def detect(self, frame):
        found = self.answers[int(frame.image[0, 0, 0])]
        return Detections(
            0.0,
            np.array([box for box, _ in found], float).reshape(-1, 4),
            np.array([sure for _, sure in found], float),
            ("person",) * len(found),
            frame.camera,
            frame.lens,
        )


def pictures(folder, monkeypatch, n=24):
    rng, images, answers = np.random.default_rng(3), [], {}
    for k in range(n):
        path = folder / f"{k}.png"
        cv2.imwrite(str(path), np.full((SIZE[1], SIZE[0], 3), k, np.uint8))
        sizes = np.exp(rng.uniform(np.log(6), np.log(90), 6))
        middles = np.array([[60 + 100 * j, 60 + 200 * (j % 2)] for j in range(6)], float)
        boxes = np.column_stack([middles - sizes[:, None] / 2, middles + sizes[:, None] / 2])
        answers[k] = [(b, 0.7) for b, size in zip(boxes, sizes, strict=True) if size >= 20]
        answers[k] += [((300, 330, 310, 340), 0.3)] * (k % 2)
        shares = boxes / np.array([*SIZE, *SIZE])
        images.append(LabelledImage(path, shares, ("person",) * 6, NONE, NONE, (), 30.0, 2500.0))
    monkeypatch.setattr(Known, "answers", answers, raising=False)
    monkeypatch.setattr(from_pictures, "YoloDetector", Known)
    return LabelledDataset(folder, ("person",), tuple(images))


def test_curves_follow_the_pictures_and_the_rest_is_the_rendered_fit(tmp_path, monkeypatch):
    rendered = StatisticalModel.load()
    out = tmp_path / "real.yaml"
    data = pictures(tmp_path, monkeypatch)
    calibrate_on_pictures("skysweep", data, rendered, out)
    model = StatisticalModel.load(out)
    assert model.pictures.labels == {"person": 144}
    assert "score, spread and lapse of person" in model.pictures.measured
    assert "background of person" in model.pictures.measured
    lying = next(k for k in model.kinds if (k.kind, k.pose, k.reported_as) == ("person", "lying", "person"))
    known = next(
        k for k in rendered.kinds if (k.kind, k.pose, k.reported_as) == ("person", "lying", "person")
    )
    rates = dict(zip(model.pixels, drawn_rates(lying, _NO_SHIFT), strict=True))
    assert rates[7.5] < 0.15
    assert rates[40.0] > 0.8  # the fit is smooth, the detector's threshold of 20 px is not
    assert lying.score[model.pixels.index(40.0)] == pytest.approx(float(score_of(0.7)), abs=0.15)
    assert (lying.object_share, lying.hidden, lying.grounds) == (
        known.object_share,
        known.hidden,
        known.grounds,
    )
    signs = [k for k in model.kinds if k.reported_as == "stop sign"]
    assert signs == [k for k in rendered.kinds if k.reported_as == "stop sign"]
    person = next(b for b in model.background if b.reported_as == "person")
    altitude = np.sqrt(2500.0 / (SIZE[0] * SIZE[1])) * rendered.camera.lens.focal_px
    rate = np.interp(np.log(altitude), np.log(person.altitude_agl_m), person.per_hectare)
    assert rate == pytest.approx(12 / (24 * 0.25), rel=0.2)
    assert set(person.surfaces.values()) == {1.0}
    assert model.held_out[0].brier < model.held_out[0].brier_of_rates


def test_another_detectors_rendered_fit_and_empty_pictures_are_refused(tmp_path, monkeypatch):
    rendered = StatisticalModel.load()
    data = pictures(tmp_path, monkeypatch, n=3)
    other = rendered.model_copy(update={"detector": rendered.detector.model_copy(update={"sha256": "0"})})
    with pytest.raises(UserError, match="--rendered: the sensor model is of skysweep, not of"):
        calibrate_on_pictures("skysweep", data, other, tmp_path / "x.yaml")
    nothing = tuple(replace(image, boxes_xyxy=NONE, class_names=()) for image in data.images)
    with pytest.raises(UserError, match="of no class were 5 reports of 3 objects"):
        calibrate_on_pictures("skysweep", replace(data, images=nothing), rendered, tmp_path / "x.yaml")
    assert not (tmp_path / "x.yaml").exists()


def test_pictures_are_a_number_or_a_folder(tmp_path):
    gone = CliRunner().invoke(
        app, ["calibrate", "--pictures", str(tmp_path / "gone"), "--out", str(tmp_path / "s.yaml")]
    )
    assert gone.exit_code == 2
    few = CliRunner().invoke(app, ["calibrate", "--pictures", "9", "--out", str(tmp_path / "s.yaml")])
    assert few.exit_code == 2
    assert json.dumps(few.output).count("write 10 to 1000000, or a folder") <= 1
