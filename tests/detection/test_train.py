import cv2
import numpy as np
import onnx
import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.detection.training.labelled import LabelledImage, write_labels
from skysweep.detection.training.reading import read_dataset
from skysweep.detection.training.train import SIDE_PX, _turn, mosaic, sample, train_detector
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError

NONE = np.zeros((0, 4))


def squares(folder, n=16, side=320, seed=0, names=("square",)):
    """A data set of one bright square a picture."""
    rng = np.random.default_rng(seed)
    (folder / "images").mkdir(parents=True)
    images = []
    for k in range(n):
        p = np.full((side, side, 3), 60, np.uint8)
        size, (x, y) = int(rng.integers(30, 90)), rng.integers(0, side - 90, 2)
        p[y : y + size, x : x + size] = (200, 220, 240)
        path = folder / "images" / f"{k}.png"
        cv2.imwrite(str(path), p)
        box = np.array([[x, y, x + size, y + size]]) / side
        images.append(LabelledImage(path, box, (names[k % len(names)],), NONE, NONE, ()))
    write_labels(folder, names, images, (side, side), {"seed": seed})
    return folder


def box_of_bright(picture):
    ys, xs = np.nonzero(picture.min(axis=2) > 130)
    return np.array([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1])


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("mirror", [False, True])
def test_boxes_turn_with_their_picture(quarters, mirror):
    p = np.zeros((SIDE_PX, SIDE_PX, 3), np.uint8)
    p[30:70, 200:290] = 255
    turned, boxes = _turn(p, np.array([[200.0, 30.0, 290.0, 70.0]]), quarters, mirror)
    np.testing.assert_array_equal(boxes[0], box_of_bright(turned))


@pytest.mark.parametrize("side", [200, 320, 900])
def test_labels_stay_on_their_things_through_augmentation(side, tmp_path):
    data = read_dataset(squares(tmp_path / "d", n=8, side=side))
    rng = np.random.default_rng(1)
    seen = 0
    for image in data.images * 4:
        picture, labels = sample(image, {"square": 0}, rng)
        assert picture.shape == (SIDE_PX, SIDE_PX, 3)
        for _, cx, cy, w, h in labels:
            expected = [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2]
            np.testing.assert_allclose(box_of_bright(picture), expected, atol=2.5)
            seen += 1
    assert seen > 8


def test_a_mosaic_shows_a_label_of_each_picture_where_it_says(tmp_path):
    images = read_dataset(squares(tmp_path / "d", n=8, side=320)).images
    images = [image for image in images if len(image.boxes_xyxy)]
    rng = np.random.default_rng(1)
    for _ in range(8):
        four = [images[i] for i in rng.integers(len(images), size=4)]
        picture, labels = mosaic(four, {"square": 0}, rng)
        assert picture.shape == (SIDE_PX, SIDE_PX, 3)
        assert len(labels) >= 3
        for _, cx, cy, w, h in labels:
            x0, y0, x1, y1 = np.rint([cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2]).astype(int)
            assert picture[y0 + 2 : y1 - 2, x0 + 2 : x1 - 2].mean() > 150


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    pytest.importorskip("torch")
    pytest.importorskip("pycocotools")
    folder = tmp_path_factory.mktemp("trained")
    squares(folder / "d")
    steps = []
    train_detector(
        folder / "d", folder / "m.onnx", minutes=0.03, threads=1, progress=lambda *step: steps.append(step)
    )
    assert steps
    assert np.isfinite(steps[-1]).all()
    return folder


def test_the_exported_model_is_read_as_yolox_with_its_names(trained):
    detector = YoloDetector(trained / "m.onnx")
    assert detector.layout.name == "YOLOX"
    assert detector.class_names == ("square",)
    metadata = {p.key: p.value for p in onnx.load(trained / "m.onnx").metadata_props}
    assert metadata["command"].startswith("skysweep train")
    assert '"seed": 0' in metadata["dataset"]


def weights(path):
    return {i.name: onnx.numpy_helper.to_array(i) for i in onnx.load(path).graph.initializer}


def test_fine_tuning_starts_from_the_models_own_weights(trained):
    """After a step or two the weights have hardly moved, and a class known by name keeps its head."""
    squares(trained / "two", names=("circle", "square"))
    out = train_detector(
        trained / "two", trained / "tuned.onnx", minutes=0.001, init=trained / "m.onnx", threads=1
    )
    before, after = weights(trained / "m.onnx"), weights(out)
    stem = "backbone.backbone.stem.conv.conv.weight"
    np.testing.assert_allclose(after[stem], before[stem], atol=5e-3)
    head = "head.cls_preds.0.weight"
    np.testing.assert_allclose(after[head][1], before[head][0], atol=5e-3)
    assert YoloDetector(out).class_names == ("circle", "square")


def test_the_shipped_model_can_be_fine_tuned(trained):
    out = train_detector(trained / "d", trained / "own.onnx", minutes=0.001, init="skysweep", threads=1)
    assert YoloDetector(out).class_names == ("square",)


def test_training_that_is_stopped_leaves_the_model_as_it_was_then(trained, monkeypatch):
    monkeypatch.chdir(trained)
    shares = []

    def stop(share, loss):
        shares.append(share)
        raise KeyboardInterrupt

    out = train_detector(trained / "d", trained / "early.onnx", minutes=5, threads=99, progress=stop)
    assert len(shares) == 1
    assert YoloDetector(out).class_names == ("square",)
    again = CliRunner().invoke(app, ["train", "d", "--out", "early.onnx"])
    assert "--out early.onnx: exists; write another, or --overwrite to replace it" in again.output


def test_only_our_own_models_can_be_fine_tuned(trained):
    for name in ("gone.onnx", "broken.onnx"):
        (trained / "broken.onnx").write_bytes(b"no model")
        with pytest.raises(UserError, match=name):
            train_detector(trained / "d", trained / "x.onnx", minutes=0.001, init=trained / name)
    assert not (trained / "x.onnx").exists()


def test_the_model_is_an_onnx_file(tmp_path):
    """It is said before an hour of training."""
    with pytest.raises(UserError, match=r"--out .*m.txt: is no name of an ONNX file"):
        train_detector(tmp_path, tmp_path / "m.txt")


def test_a_data_set_without_labels_teaches_nothing(tmp_path):
    pytest.importorskip("torch")
    (tmp_path / "images").mkdir()
    path = tmp_path / "images" / "0.png"
    cv2.imwrite(str(path), np.zeros((320, 320, 3), np.uint8))
    write_labels(tmp_path, ["square"], [LabelledImage(path, NONE, (), NONE, NONE, ())], (320, 320), {})
    with pytest.raises(UserError, match="no picture has a label"):
        train_detector(tmp_path, tmp_path / "m.onnx")
