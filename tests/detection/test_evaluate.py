import json
import shutil
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.detection.model_files import own_model_path
from skysweep.detection.training.evaluate import Score, bin_of, evaluate
from skysweep.detection.training.labelled import LabelledDataset, LabelledImage
from skysweep.detection.training.matching import iou, match
from skysweep.errors import UserError
from skysweep.experiments.pictures.curves import calibration_error, precision_recall, reliability
from skysweep.experiments.pictures.paired import differences
from skysweep.experiments.pictures.report import write_report
from skysweep.experiments.pictures.tables import classes_json, grids, scores_json
from skysweep.results.reporting.tables import markdown
from skysweep.types import Detections

SIDE = 100
NONE = np.zeros((0, 4))


@dataclass
class Oracle:
    """Answers picture k with the boxes listed for k; the picture's grey level is k."""

    answers: list[list[tuple[tuple[float, float, float, float], float, str]]]
    class_names: tuple[str, ...] = ("person", "boat")

    def detect(self, frame):
        answer = self.answers[int(frame.image[0, 0, 0])]
        return Detections(
            frame.time_s,
            np.array([b for b, _, _ in answer], float).reshape(-1, 4),
            np.array([c for _, c, _ in answer], float),
            tuple(n for _, _, n in answer),
            frame.camera,
            frame.lens,
        )


def dataset(folder, *pictures):
    """Pictures of (boxes in pixels with names, crowds, decoys with names, altitude)."""
    images = []
    for k, (labels, crowds, decoys, altitude) in enumerate(pictures):
        path = folder / f"{k}.png"
        cv2.imwrite(str(path), np.full((SIDE, SIDE, 3), k, np.uint8))
        images.append(
            LabelledImage(
                path,
                np.array([b for b, _ in labels], float).reshape(-1, 4) / SIDE,
                tuple(n for _, n in labels),
                np.array(crowds, float).reshape(-1, 4) / SIDE,
                np.array([b for b, _ in decoys], float).reshape(-1, 4) / SIDE,
                tuple(n for _, n in decoys),
                altitude,
            )
        )
    return LabelledDataset(folder, ("person", "boat", "sheep"), tuple(images))


def test_counts_by_hand(tmp_path):
    data = dataset(
        tmp_path,
        # a person of 10 px found twice, a boat of 50 px found weakly, a sheep that the detector does not know
        ([((10, 10, 20, 20), "person"), ((40, 40, 90, 60), "boat"), ((0, 90, 9, 99), "sheep")], [], [], 30.0),
        # a person missed, a false boat, a detection in a crowd, a buoy taken for a person
        ([((10, 10, 20, 20), "person")], [(50, 50, 100, 100)], [((80, 10, 90, 20), "buoy")], 4.0),
    )
    oracle = Oracle(
        [
            [
                ((10, 10, 20, 21), 0.9, "person"),
                ((11, 10, 20, 20), 0.5, "person"),
                ((40, 40, 90, 62), 0.3, "boat"),
            ],
            [
                ((30, 5, 45, 20), 0.7, "boat"),
                ((60, 60, 70, 70), 0.8, "person"),
                ((80, 10, 90, 20), 0.65, "person"),
                ((10, 10, 20, 20), 0.1, "person"),  # below the threshold
            ],
        ]
    )
    result = evaluate(oracle, data, confidence_min=0.25)
    assert result.classes == ("person", "boat")
    person = result.by_pixels["person", 8.0]
    assert (person.n_targets, person.n_found, person.n_confirming, person.n_false) == (2, 1, 1, 2)
    boats = [score for (name, _), score in result.by_pixels.items() if name == "boat"]
    assert [sum(s.n_targets for s in boats), sum(s.n_found for s in boats)] == [1, 1]
    assert [sum(s.n_confirming for s in boats), sum(s.n_false for s in boats)] == [0, 1]
    high, low = result.by_altitude["person", 25.0], result.by_altitude["person", 3.0]
    assert (high.n_found, high.n_targets) == (1, 1)
    assert (low.n_found, low.n_targets) == (0, 1)
    decoy = result.decoys["buoy", 8.0]
    assert (decoy.n, decoy.n_taken, decoy.n_confirmed) == (1, 1, 1)
    assert (sum(s.n_false for s in result.by_pixels.values()), result.n_images) == (3, 2)


def test_tables_show_every_detector(tmp_path):
    data = dataset(tmp_path, ([((10, 10, 20, 20), "person")], [], [((50, 50, 60, 60), "buoy")], 30.0))
    found = evaluate(Oracle([[((10, 10, 20, 20), 0.9, "person")]]), data)
    missed = evaluate(Oracle([[]]), data)
    text = "\n".join(map(markdown, grids({"ours": found, "stock": missed})))
    for part in ("ours", "stock", "person", "8 to 12", "25 to 50", "buoy", "1.00", "0.00"):
        assert part in text


def test_counts_are_told_as_numbers_with_their_bins(tmp_path):
    data = dataset(tmp_path, ([((10, 10, 20, 20), "person")], [], [((50, 50, 60, 60), "buoy")], 30.0))
    found = evaluate(Oracle([[((10, 10, 20, 20), 0.9, "person")]]), data)
    told = json.loads(json.dumps(scores_json(found), allow_nan=False))
    (person,) = (each for each in told["by_pixels"] if each["class"] == "person" and each["n_targets"])
    assert (person["from"], person["to"], person["n_found"]) == (8.0, 12.0, 1)
    buoy, person = told["confusions"]
    assert (buoy["class"], buoy["n"], buoy["n_taken"]) == ("buoy", 1, 0)
    assert (person["class"], person["n"], person["n_taken"]) == ("person", 1, 0)


def test_what_is_taken_for_what(tmp_path):
    data = dataset(
        tmp_path,
        # a sheep called a person; a person beside a boat that is found
        (
            [((10, 10, 20, 20), "sheep"), ((40, 40, 50, 50), "person"), ((42, 40, 52, 50), "boat")],
            [],
            [],
            None,
        ),
        # a person found twice; a sheep called a person weakly
        ([((10, 10, 20, 20), "person"), ((60, 60, 70, 70), "sheep")], [], [], None),
    )
    answers = [
        [((10, 10, 20, 20), 0.7, "person"), ((42, 40, 52, 50), 0.9, "boat")],
        [
            ((10, 10, 20, 20), 0.9, "person"),
            ((11, 10, 20, 20), 0.8, "person"),
            ((60, 60, 70, 70), 0.2, "person"),
        ],
    ]
    result = evaluate(Oracle(answers), data)
    sheep = result.decoys["sheep", 8.0]
    assert (sheep.n, sheep.n_taken, sheep.n_confirmed, sheep.taken_for) == (2, 1, 1, {"person": 1})
    assert result.decoys["person", 8.0].n_taken == 0  # neither by a boat that is one nor by a double
    assert "person 1" in markdown(grids({"ours": result})[-1])


def test_confident_detections_choose_first():
    labels = np.array([[0, 0, 10, 10], [4, 0, 14, 10]], float)
    boxes = np.array([[1, 0, 11, 10], [0, 0, 10, 10]], float)
    assert match(boxes, np.array([0.9, 0.8]), labels, 0.5).tolist() == [
        0,
        -1,
    ]  # the second finds its label taken
    assert match(boxes, np.array([0.8, 0.9]), labels, 0.5).tolist() == [1, 0]


def test_iou():
    a = np.array([[0, 0, 10, 10]], float)
    b = np.array([[0, 0, 10, 10], [5, 0, 15, 10], [20, 20, 30, 30]], float)
    np.testing.assert_allclose(iou(a, b), [[1, 1 / 3, 0]])


def test_bins_exclude_their_upper_edge():
    assert [bin_of(v, (0, 8, 12)) for v in (0.0, 7.9, 8.0, 11.9)] == [0, 0, 8, 8]


def test_no_class_in_common(tmp_path):
    data = dataset(tmp_path, ([], [], [], None))
    with pytest.raises(UserError, match=r"person, boat, sheep\) are none of the detector's \(wolf\)"):
        evaluate(Oracle([[]], ("wolf",)), data)


def test_no_pictures(tmp_path):
    with pytest.raises(UserError, match="no pictures"):
        evaluate(Oracle([]), LabelledDataset(tmp_path, ("person",), ()))


def test_unreadable_picture(tmp_path):
    (tmp_path / "bad.jpg").write_bytes(b"no picture")
    image = LabelledImage(tmp_path / "bad.jpg", NONE, (), NONE, NONE, ())
    with pytest.raises(UserError, match=r"bad\.jpg: not a readable picture"):
        evaluate(Oracle([[]]), LabelledDataset(tmp_path, ("person",), (image,)))


def judged(folder, answers, **options):
    data = dataset(
        folder,
        ([((10, 10, 20, 20), "person"), ((40, 40, 90, 60), "boat")], [], [], 30.0),
        ([((10, 10, 20, 20), "person")], [], [], 30.0),
    )
    ground = tuple(replace(image, ground_m2=5000.0) for image in data.images)
    return data, evaluate(Oracle(answers), replace(data, images=ground), **options)


GOOD = [
    [((10, 10, 20, 20), 0.9, "person"), ((70, 70, 80, 80), 0.8, "person")],
    [((10, 10, 20, 20), 0.1, "person")],
]
POOR = [[], [((30, 30, 40, 40), 0.7, "person")]]


def test_json_of_classes_and_false_ones_a_hectare(tmp_path):
    _, result = judged(tmp_path, GOOD)
    person = classes_json(result)["person"]
    assert (person["recall"], person["precision"], person["false_per_picture"]) == (0.5, 0.5, 0.5)
    assert person["by_pixels"] == [{"lo": 8.0, "hi": 12.0, "n": 2, "recall": 0.5}]
    assert (result.hectares, person["false_per_hectare"]) == (1.0, 1.0)
    curve = precision_recall(result, "person")
    assert curve.recall.tolist() == [0.5, 0.5, 1.0]  # down to the floor, with the one of confidence 0.1
    assert curve.average_precision == pytest.approx(0.5 * 1 + 0.5 * 2 / 3)


def test_the_order_of_pictures_does_not_matter(tmp_path):
    """A threshold takes all detections of one confidence, whichever picture comes first."""
    labelled, empty = ([((10, 10, 20, 20), "person")], [], [], None), ([], [], [], None)
    right, wrong = [((10, 10, 20, 20), 0.8, "person")], [((50, 50, 60, 60), 0.8, "person")]
    found = []
    for k, pictures in enumerate(([labelled, empty], [empty, labelled])):
        (tmp_path / str(k)).mkdir()
        answers = [right if p is labelled else wrong for p in pictures]
        curve = precision_recall(evaluate(Oracle(answers), dataset(tmp_path / str(k), *pictures)), "person")
        found.append((curve.confidence.tolist(), curve.average_precision))
    assert found == [([0.8], 0.5)] * 2


def test_two_names_of_the_detector_for_one_of_ours_are_one_detection(tmp_path):
    data = dataset(tmp_path, ([((10, 10, 20, 20), "person")], [], [], None))
    twice = [[((10, 10, 20, 20), 0.9, "pedestrian"), ((10, 10, 20, 21), 0.8, "people")]]
    result = evaluate(Oracle(twice, ("pedestrian", "people")), data)
    assert result.total("person") == Score(n_targets=1, n_found=1, n_confirming=1, n_false=0)


def test_a_crowd_of_one_class_excuses_no_other(tmp_path):
    data = dataset(tmp_path, ([((10, 10, 20, 20), "person")], [(0, 0, 100, 100)], [], None))
    (image,) = data.images
    data = replace(data, images=(replace(image, crowd_names=("person",)),))
    false = [[((50, 50, 60, 60), 0.9, "boat"), ((70, 70, 80, 80), 0.9, "person")]]
    result = evaluate(Oracle(false), data)
    assert (result.total("boat").n_false, result.total("person").n_false) == (1, 0)


def test_reliability_by_hand(tmp_path):
    _, result = judged(tmp_path, GOOD)
    weak, sure, surest = reliability(result)
    assert (weak.confidence, weak.share_right, sure.share_right, surest.share_right) == (0.1, 1.0, 0.0, 1.0)
    assert calibration_error([weak, sure, surest]) == pytest.approx((0.9 + 0.8 + 0.1) / 3)


def test_two_detectors_on_the_same_pictures(tmp_path):
    (_, first), (_, second) = judged(tmp_path, GOOD), judged(tmp_path, POOR)
    person, boat = differences(first, second)
    assert (person.n_only_first, person.n_only_second) == (1, 0)
    assert person.recall.mean == -0.5
    assert person.false_per_picture.mean == 0.0
    assert boat.recall is None  # one picture alone has a boat


def test_report_holds_everything(tmp_path):
    data, first = judged(tmp_path, GOOD)
    _, second = judged(tmp_path, POOR)
    write_report(tmp_path / "page.html", data, {"ours": first, "theirs": second})
    page = (tmp_path / "page.html").read_text()
    for part in (
        "theirs less ours",
        "person 0.80 where none is, 10 px, 0.png",
        "boat not found, 50 px",
        "1.0 ha",
    ):
        assert part in page
    assert "http" not in page.replace("http-equiv", "")


def test_a_model_is_not_compared_with_itself(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((32, 32, 3), np.uint8))
    (tmp_path / "a.txt").write_text("")
    (tmp_path / "classes.txt").write_text("person\n")
    same = shutil.copy(own_model_path(), tmp_path / "copy.onnx")
    told = CliRunner().invoke(app, ["detect", "evaluate", str(tmp_path), "--against", str(same)])
    assert told.exit_code == 2
    assert "copy.onnx: is the same model as skysweep; write another one" in " ".join(told.output.split())
