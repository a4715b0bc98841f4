import json

import cv2
import numpy as np
import pytest

from skysweep.detection.training.dataset import (
    FOCAL_PX,
    ID_MARGIN_PX,
    SIDE_PX,
    _label,
    develop,
    random_view,
    random_world,
    render_dataset,
)
from skysweep.detection.training.reading import read_dataset
from skysweep.errors import UserError
from skysweep.worlds.world import HELD_OUT_VARIANTS


@pytest.mark.parametrize("split", ["train", "held-out"])
def test_assets_of_the_splits_do_not_meet(split):
    worlds = [random_world(np.random.default_rng(seed), split) for seed in range(8)]
    variants = np.array([t.variant for w in worlds for t in (*w.objects, *w.trees, *w.buildings)])
    assert ((variants < HELD_OUT_VARIANTS) == (split == "train")).all()
    assert {o.kind for w in worlds for o in w.objects if o.is_target} == {"stop sign", "person", "boat"}
    assert any(not o.is_target for w in worlds for o in w.objects)


def test_views_are_above_the_ground_and_steep_enough():
    rng = np.random.default_rng(0)
    world = random_world(rng, "train")
    views = [v for v in (random_view(world, rng) for _ in range(200)) if v is not None]
    assert len(views) > 100
    for lens, pose in views:
        assert pose.position_enu_m[2] >= 1.0
        assert FOCAL_PX[0] <= lens.focal_px <= FOCAL_PX[1] * 1.0001
        assert pose.R_camera_to_enu[2, 2] < -np.sin(np.radians(30))  # the optical axis points down


def ids(visible, whole):
    """Object ids with the margin, of boxes (x0, y0, x1, y1) in the picture's pixels by id."""
    side = SIDE_PX + 2 * ID_MARGIN_PX
    pictures = []
    for boxes in (visible, whole):
        a = np.zeros((side, side), np.int32)
        for k, (x0, y0, x1, y1) in boxes.items():
            a[y0 + ID_MARGIN_PX : y1 + ID_MARGIN_PX, x0 + ID_MARGIN_PX : x1 + ID_MARGIN_PX] = k
        pictures.append(a)
    return pictures


@pytest.mark.parametrize(
    ("visible", "whole", "labelled"),
    [
        ((100, 50, 120, 60), (100, 50, 120, 60), [100, 50, 120, 60]),
        ((100, 50, 110, 60), (100, 50, 120, 60), [100, 50, 110, 60]),  # half of it under a tree
        ((100, 50, 106, 60), (100, 50, 120, 60), None),  # 30 % visible
        ((-10, 50, 10, 60), (-10, 50, 10, 60), [0, 50, 10, 60]),  # cut by the edge to a half
        ((-40, 50, 10, 60), (-40, 50, 10, 60), None),  # cut to a fifth
        ((100, 50, 104, 54), (100, 50, 104, 54), None),  # too small
    ],
)
def test_labels_are_boxes_of_what_is_visible(visible, whole, labelled, tmp_path):
    world = random_world(np.random.default_rng(3), "train")
    target = next(k for k, o in enumerate(world.objects) if o.is_target)
    image = _label(tmp_path / "a.jpg", world, *ids({target + 1: visible}, {target + 1: whole}))
    expected = np.zeros((0, 4)) if labelled is None else [labelled]
    np.testing.assert_allclose(image.boxes_xyxy * SIDE_PX, expected)


def test_look_alikes_are_no_labels(tmp_path):
    world = random_world(np.random.default_rng(3), "train")
    decoy = next(k for k, o in enumerate(world.objects) if not o.is_target)
    box = {decoy + 1: (100, 50, 120, 60)}
    image = _label(tmp_path / "a.jpg", world, *ids(box, box))
    assert image.class_names == ()
    assert image.decoy_names == (world.objects[decoy].kind,)


def test_developing_blurs_without_moving():
    """The centre of gravity of a bright dot stays, whatever the blur."""
    dot = np.zeros((41, 41, 3), np.uint8)
    dot[18:23, 18:23] = 200
    for seed in range(12):
        p = develop(dot, np.random.default_rng(seed)).astype(float)[..., 0]
        p[p < 40] = 0
        ys, xs = np.mgrid[:41, :41]
        assert (p * xs).sum() / p.sum() == pytest.approx(20, abs=0.25)
        assert (p * ys).sum() / p.sum() == pytest.approx(20, abs=0.25)


def test_a_rendered_data_set_is_whole_and_reproducible(tmp_path):
    first, second = (render_dataset(tmp_path / n, 4, seed=3, workers=1) for n in ("a", "b"))
    data = read_dataset(first)
    assert len(data.images) == 4
    assert data.class_names == ("stop sign", "person", "boat")
    for image in data.images:
        assert cv2.imread(str(image.path)).shape == (SIDE_PX, SIDE_PX, 3)
        assert image.path.read_bytes() == (second / "images" / image.path.name).read_bytes()
    assert (first / "annotations.json").read_text() == (second / "annotations.json").read_text()
    assert json.loads((first / "annotations.json").read_text())["info"]["seed"] == 3


def test_bad_requests(tmp_path):
    with pytest.raises(UserError, match="write at least 1"):
        render_dataset(tmp_path / "a", 0)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "thesis.txt").write_text("precious")
    with pytest.raises(UserError, match="not empty"):
        render_dataset(tmp_path / "b", 4)
    assert (tmp_path / "b" / "thesis.txt").read_text() == "precious"
