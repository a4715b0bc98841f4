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
from skysweep.experiments.calibration.from_pictures import calibrate_on_pictures, look_at
from skysweep.scenarios.model import DetectorModel
from skysweep.sensing.statistical.model import StatisticalModel, score_of
from skysweep.types import Detections

NONE = np.zeros((0, 4))
SIZE = 640, 360
OURS = DetectorModel(model="skysweep")


class Known:
    """Finds every person of 20 px or more with confidence 0.7, none below, and something where nothing is."""

    answers: dict[int, list]

    def __init__(self, *_, **given):
        Known.given = given
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
    calibrate_on_pictures(OURS, data, rendered, out)
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


def kinds_of(model, kind):
    return [k for k in model.kinds if k.kind == k.reported_as == kind]


def test_whom_it_hardly_ever_finds_it_hardly_ever_finds_in_missions(tmp_path, monkeypatch):
    """144 persons, none reported: no curve can be fitted, and the rendered one would be far too good."""
    rendered, out = StatisticalModel.load(), tmp_path / "blind.yaml"
    data = pictures(tmp_path, monkeypatch)
    monkeypatch.setattr(Known, "answers", dict.fromkeys(range(24), ()))
    calibrate_on_pictures(OURS, data, rendered, out)
    model = StatisticalModel.load(out)
    assert model.pictures.labels == {"person": 144}
    assert model.pictures.measured == ["lapse of person", "background of person"]
    assert "score of person (0 of 144 labels reported)" in model.pictures.from_renders
    assert "background of boat" in model.pictures.from_renders
    for kind, known in zip(kinds_of(model, "person"), kinds_of(rendered, "person"), strict=True):
        assert kind.score == known.score
        assert max(drawn_rates(kind, _NO_SHIFT)) < 0.02
    assert kinds_of(model, "boat") == kinds_of(rendered, "boat")


def test_what_it_never_finds_among_a_thousand_labels_is_written_so_that_it_loads(tmp_path, monkeypatch):
    """Lapses were rounded to 1, which no sensor model may have."""
    data = pictures(tmp_path, monkeypatch, n=200)
    monkeypatch.setattr(Known, "answers", dict.fromkeys(range(200), ()))
    calibrate_on_pictures(OURS, data, StatisticalModel.load(), tmp_path / "blind.yaml")
    model = StatisticalModel.load(tmp_path / "blind.yaml")
    assert max(max(kind.lapse_among) for kind in kinds_of(model, "person")) == 0.9999


def test_a_class_that_the_rendered_fit_does_not_know_is_not_measured(tmp_path, monkeypatch):
    rendered, data = StatisticalModel.load(), pictures(tmp_path, monkeypatch)
    no_boats = rendered.model_copy(update={"kinds": [k for k in rendered.kinds if k.kind != "boat"]})
    boats = replace(
        data,
        class_names=("boat",),
        images=tuple(replace(image, class_names=("boat",) * 6) for image in data.images),
    )
    with pytest.raises(UserError, match="of no class were 10 labels"):
        calibrate_on_pictures(OURS, boats, no_boats, tmp_path / "r.yaml")


def test_false_reports_of_what_is_not_labelled_are_the_rendered_ones(tmp_path, monkeypatch):
    """They may be right: only persons are labelled. And where none was seen the rate does not rise."""
    rendered = StatisticalModel.load()
    data = pictures(tmp_path, monkeypatch)
    model = calibrate_on_pictures(OURS, data, rendered, tmp_path / "r.yaml")
    backgrounds = {b.reported_as: b for b in model.background}
    known = {b.reported_as: b for b in rendered.background}
    assert [n for n in known if backgrounds[n] == known[n]] == [n for n in known if n != "person"]
    both = replace(data, class_names=("person", "boat"))
    model = calibrate_on_pictures(OURS, both, rendered, tmp_path / "r.yaml")
    boat = next(b for b in model.background if b.reported_as == "boat")
    assert all(rate <= was for rate, was in zip(boat.per_hectare, known["boat"].per_hectare, strict=True))
    assert "background of boat" in model.pictures.measured


def test_a_picture_shows_the_fit(tmp_path, monkeypatch):
    calibrate_on_pictures(OURS, pictures(tmp_path, monkeypatch), StatisticalModel.load(), tmp_path / "r.yaml")
    picture = cv2.imread(str(tmp_path / "r.png"))
    height, width = picture.shape[:2]
    assert (width, height) == (930, 680)  # one kind, and three panels of held-out looks and of nothing
    assert (np.abs(picture.astype(int) - (178, 114, 0)).max(axis=2) < 30).sum() > 200  # a person's blue


def test_tiles_make_the_objects_larger(tmp_path, monkeypatch):
    """In 2 x 2 tiles a person of 20 px is for the shipped detector as one of 24 px in the whole picture."""
    data, rendered = pictures(tmp_path, monkeypatch), StatisticalModel.load()
    whole, _ = look_at(OURS, data, rendered)
    assert Known.given.items() >= {"tiles": 1, "boxes": None, "pixels": None, "channels": None}.items()
    settings = {"tiles": 2, "boxes": "pixels", "pixels": "0..255", "channels": "rgb"}
    tiled, _ = look_at(DetectorModel(**settings), data, rendered)
    assert Known.given.items() >= settings.items()
    assert tiled.pixels.max() / whole.pixels.max() == pytest.approx(1.216, abs=0.001)


@pytest.mark.parametrize(
    "option",
    [
        ("--tiles", "2"),
        ("--class", "a=boat"),
        ("--boxes", "pixels"),
        ("--pixels", "0..1"),
        ("--channels", "bgr"),
    ],
)
def test_what_counts_with_real_pictures_only(option, tmp_path):
    told = CliRunner().invoke(
        app, ["calibrate", "--pictures", "20", *option, "--out", str(tmp_path / "s.yaml")]
    )
    assert told.exit_code == 2
    assert f"{option[0]}: counts with real pictures only" in " ".join(told.output.split())


def test_another_detectors_rendered_fit_and_empty_pictures_are_refused(tmp_path, monkeypatch):
    rendered = StatisticalModel.load()
    data = pictures(tmp_path, monkeypatch, n=3)
    other = rendered.model_copy(update={"detector": rendered.detector.model_copy(update={"sha256": "0"})})
    with pytest.raises(UserError, match="--rendered: the sensor model is of skysweep, not of"):
        calibrate_on_pictures(OURS, data, other, tmp_path / "x.yaml")
    few = tuple(replace(image, boxes_xyxy=image.boxes_xyxy[:0], class_names=()) for image in data.images[1:])
    with pytest.raises(UserError, match="of no class were 10 labels, or 5 reports of 3 objects"):
        calibrate_on_pictures(
            OURS, replace(data, images=(one_label(data.images[0]), *few)), rendered, tmp_path / "x.yaml"
        )
    assert not (tmp_path / "x.yaml").exists()


def one_label(image):
    return replace(image, boxes_xyxy=image.boxes_xyxy[:1], class_names=("person",))


def test_labels_of_no_class_of_ours_are_named(tmp_path, monkeypatch):
    data, rendered = pictures(tmp_path, monkeypatch, n=3), StatisticalModel.load()
    images = tuple(replace(image, class_names=("hiker",) * 6) for image in data.images)
    hikers = replace(data, class_names=("hiker",), images=images)
    with pytest.raises(UserError, match=r"its labels \(hiker\) are of none of .* --class 'hiker=stop sign'"):
        look_at(OURS, hikers, rendered)
    with pytest.raises(UserError, match="--class hikers=person: no class has that name; there are hiker"):
        look_at(OURS, hikers, rendered, {"hikers": "person"})
    looks, _ = look_at(OURS, hikers, rendered, {"hiker": "person"})
    assert len(looks.pixels) == len(look_at(OURS, data, rendered)[0].pixels) > 0
    unlabelled = tuple(replace(image, boxes_xyxy=NONE, class_names=()) for image in data.images)
    with pytest.raises(UserError, match="no picture has a label that counts"):
        look_at(OURS, replace(data, images=unlabelled), rendered)
    with pytest.raises(UserError, match="the data set has no pictures"):
        look_at(OURS, replace(data, images=()), rendered)


@pytest.mark.parametrize("option", ["--camera", "--add-to", "--seed", "--workers"])
def test_what_counts_with_rendered_pictures_only(option, tmp_path):
    value = {"--camera": "clusters", "--add-to": "sensor.yaml"}.get(option, "1")
    told = CliRunner().invoke(
        app, ["calibrate", "--pictures", str(tmp_path), option, value, "--out", str(tmp_path / "s.yaml")]
    )
    assert told.exit_code == 2
    assert f"{option}: counts with rendered pictures only; leave it out" in " ".join(told.output.split())


def test_pictures_are_a_number_or_a_folder(tmp_path):
    gone = CliRunner().invoke(
        app, ["calibrate", "--pictures", str(tmp_path / "gone"), "--out", str(tmp_path / "s.yaml")]
    )
    assert gone.exit_code == 2
    few = CliRunner().invoke(app, ["calibrate", "--pictures", "9", "--out", str(tmp_path / "s.yaml")])
    assert few.exit_code == 2
    assert json.dumps(few.output).count("write 10 to 1000000, or a folder") <= 1


def test_a_folder_that_is_named_as_a_number_is_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "2024").mkdir()
    told = CliRunner().invoke(app, ["calibrate", "--pictures", "2024", "--out", "s.yaml"])
    assert told.exit_code == 2
    assert "2024: neither annotations nor labels are there" in " ".join(told.output.split())
