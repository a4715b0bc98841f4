import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from skysweep.detection.training.dataset import render_dataset
from skysweep.detection.training.labelled import LabelledImage
from skysweep.detection.training.random_worlds import (
    ANIMALS,
    SIDE_PX,
    THERMAL,
    VISIBLE,
    random_view,
    random_world,
)
from skysweep.detection.training.reading import read_dataset
from skysweep.detection.training.rendered_pictures import ID_MARGIN_PX, _stand_out, develop, labels_of
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
        assert VISIBLE.focal_px[0] <= lens.focal_px <= VISIBLE.focal_px[1] * 1.0001
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
    image = labels_of(tmp_path / "a.jpg", world, *ids({target + 1: visible}, {target + 1: whole}))
    expected = np.zeros((0, 4)) if labelled is None else [labelled]
    np.testing.assert_allclose(image.boxes_xyxy * SIDE_PX, expected)


def test_look_alikes_are_no_labels(tmp_path):
    world = random_world(np.random.default_rng(3), "train")
    decoy = next(k for k, o in enumerate(world.objects) if not o.is_target)
    box = {decoy + 1: (100, 50, 120, 60)}
    image = labels_of(tmp_path / "a.jpg", world, *ids(box, box))
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


def test_ctrl_c_leaves_nothing_and_says_so(tmp_path):
    command = [sys.executable, "-m", "skysweep.cli", "dataset", "d", "--pictures", "100000"]
    rendering = subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    while not any(tmp_path.rglob("*.jpg")):
        assert rendering.poll() is None
        time.sleep(0.2)
    os.killpg(rendering.pid, signal.SIGINT)
    said = rendering.communicate(timeout=60)[1]
    assert rendering.returncode == 130
    assert "stopped; nothing was written, and the same command starts again" in said
    assert not (tmp_path / "d").exists()


def test_bad_requests(tmp_path):
    with pytest.raises(UserError, match="write at least 1"):
        render_dataset(tmp_path / "a", 0)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "thesis.txt").write_text("precious")
    (tmp_path / "killed" / ".unfinished-1").mkdir(parents=True)
    with pytest.raises(UserError, match=r"not finished \(\.unfinished-1\); delete it, or write"):
        render_dataset(tmp_path / "killed", 1)
    with pytest.raises(UserError, match="not empty"):
        render_dataset(tmp_path / "b", 4)
    assert (tmp_path / "b" / "thesis.txt").read_text() == "precious"


def test_thermal_pictures_show_persons_and_animals_that_stand_out(tmp_path):
    for name in ("a", "b"):
        render_dataset(tmp_path / name, 12, seed=4, camera="thermal", workers=1)
    data = read_dataset(tmp_path / "a")
    assert data.class_names == ("person", "animal")
    assert {name for image in data.images for name in image.class_names} == {"person", "animal"}
    written = json.loads((tmp_path / "a" / "annotations.json").read_text())
    assert written["info"]["camera"] == "thermal"
    altitudes_m = [image["altitude_agl_m"] for image in written["images"]]
    assert 1 < min(altitudes_m) <= max(altitudes_m) < 91
    for image in data.images:
        picture = cv2.imread(str(image.path))
        assert (picture == picture[..., :1]).all()
        assert image.path.read_bytes() == (tmp_path / "b" / "images" / image.path.name).read_bytes()
    assert sum(len(image.boxes_xyxy) for image in data.images) > 5
    assert sum(len(image.decoys_xyxy) for image in data.images) > 5


def test_weather_of_thermal_pictures_is_by_day_and_by_night_and_possible():
    skies = [THERMAL.sky(np.random.default_rng(k)) for k in range(60)]
    elevations = np.array([sky.light.sun_elevation_deg for sky in skies])
    assert 0.25 < np.mean(elevations < 0) < 0.75
    worlds = [random_world(np.random.default_rng(k), "train", THERMAL) for k in range(12)]
    assert {o.kind for w in worlds for o in w.objects if o.is_target} == {"person", *ANIMALS}
    assert {"sheep", "deer", "dog", "rock"} <= {o.kind for w in worlds for o in w.objects}


NONE = np.zeros((0, 4))


def test_a_person_as_warm_as_the_ground_does_not_stand_out():
    box = LabelledImage(Path(), np.array([[0.4, 0.4, 0.5, 0.5]]), ("person",), NONE, NONE, ())
    grey = np.random.default_rng(0).normal(120, 3, (SIDE_PX, SIDE_PX, 1)).clip(0, 255).astype(np.uint8)
    picture = np.repeat(grey, 3, axis=2)
    assert not _stand_out(picture, box)
    picture[135:150, 135:150] = 220
    assert _stand_out(picture, box)
