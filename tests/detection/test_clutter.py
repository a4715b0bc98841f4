from dataclasses import replace

import cv2
import numpy as np
import pytest

from skysweep.detection.training.camera_looks import sharpened, toned
from skysweep.detection.training.clutter import CLEAR_M, with_clutter
from skysweep.detection.training.dataset import render_dataset
from skysweep.detection.training.random_worlds import CLUTTERED, random_view, random_world
from skysweep.detection.training.reading import read_dataset
from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.worlds.assets.clutter import CLUTTER, clutter_mesh
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.world import HELD_OUT_VARIANTS


def worlds(water, n=6, split="train"):
    first = 0 if split == "train" else HELD_OUT_VARIANTS
    found, seed = [], 0
    while len(found) < n:
        rng = np.random.default_rng(seed)
        plain = random_world(rng, split)
        if (plain.terrain.surface == "water") == water:
            found.append((plain, with_clutter(plain, first, rng)))
        seed += 1
    return found


@pytest.mark.parametrize("kind", CLUTTER)
def test_meshes_are_as_long_as_said(kind):
    for variant in (0, 1, 2, HELD_OUT_VARIANTS):
        mesh = clutter_mesh(kind, 5.0, variant)
        assert np.isfinite(mesh.vertices).all()
        assert 3.0 < np.ptp(mesh.vertices[:, :2], axis=0).max() < 8.5 or kind == "rubbish"
        assert mesh.vertices[:, 2].max() > 0.03
        assert mesh.vertices[:, 2].min() > (-1.1 if kind == "jetty" else -0.5)
        assert np.array_equal(mesh.vertices, clutter_mesh(kind, 5.0, variant).vertices)


def test_land_is_cluttered_and_only_cars_are_labelled():
    pairs = worlds(water=False)
    assert all(full.objects[: len(plain.objects)] == plain.objects for plain, full in pairs)
    more = [o for plain, full in pairs for o in full.objects[len(plain.objects) :]]
    assert len(more) > 10
    assert {(o.kind, o.is_target) for o in more} == {("car", True)}
    kinds = {c.kind for _, full in pairs for c in full.clutter}
    assert kinds >= {"fence", "fallen tree", "rubbish"}
    assert any(len(full.buildings) > len(plain.buildings) for plain, full in pairs)
    assert any(len(np.unique(full.terrain.cover.codes)) > 1 for _, full in pairs)
    for plain, full in pairs:
        places = np.array([o.position_enu_m[:2] for o in plain.objects])
        for thing in (*full.clutter, *full.objects[len(plain.objects) :]):
            assert np.hypot(*(places - thing.position_enu_m[:2]).T).min() >= CLEAR_M


def test_boats_beside_jetties_are_labelled_boats():
    pairs = worlds(water=True, n=12)
    more = [o for plain, full in pairs for o in full.objects[len(plain.objects) :]]
    assert len(more) > 10
    assert {(o.kind, o.is_target) for o in more} == {("boat", True)}
    assert {c.kind for _, full in pairs for c in full.clutter} == {"jetty"}


def test_looks_of_the_splits_do_not_meet():
    for split in ("train", "held-out"):
        variants = [c.variant for _, full in worlds(False, 3, split) for c in full.clutter]
        assert {v >= HELD_OUT_VARIANTS for v in variants} == {split == "held-out"}


def test_clutter_hides_and_is_no_object():
    plain, full = worlds(False, 1)[0]
    canopy = replace(full.clutter[0], kind="canopy", length_m=4.5)
    alone = replace(full, objects=(), trees=(), buildings=(), clutter=(canopy,))
    above = CameraPose(canopy.position_enu_m + np.array([0, 0, 12]), rotation_camera_to_enu(0.0, -np.pi / 2))
    lens = Lens(64, 64, 0.6)
    with_canopy, without = make_renderer(alone), make_renderer(replace(alone, clutter=()))
    assert not with_canopy.render_ids(lens, above).any()
    assert not np.array_equal(with_canopy.render(lens, above), without.render(lens, above))
    below = replace(alone, objects=(replace(plain.objects[0], position_enu_m=canopy.position_enu_m),))
    hidden = make_renderer(below)
    assert hidden.render_ids(lens, above, occluders=False).any()
    seen, whole = ((hidden.render_ids(lens, above, occluders=o) > 0).sum() for o in (True, False))
    assert seen < whole


def test_most_pictures_without_targets_show_clutter():
    empty = CLUTTERED._replace(empty_share=1.0)
    full = worlds(False, 1)[0][1]
    places = np.array([c.position_enu_m for c in full.clutter])
    shares = []
    for world in (full, replace(full, clutter=())):
        rng = np.random.default_rng(0)
        views = [view for view in (random_view(world, rng, empty) for _ in range(400)) if view is not None]
        shares.append(np.mean([_shows(*view, places) for view in views]))
    assert shares[0] > max(0.65, shares[1] + 0.2)


def _shows(lens, pose, places):
    px, depth = project(lens, pose, places)
    return ((px > 0) & (px < lens.width_px)).all(axis=1)[depth > 0].any()


def test_tones_are_those_of_cameras():
    """More contrast and half of the colour, on average; each picture differently."""
    rng = np.random.default_rng(3)
    patches = cv2.resize(rng.uniform(60, 120, (8, 8, 3)), (96, 96), interpolation=cv2.INTER_LINEAR)
    flat = np.rint(patches * [0.8, 1.1, 0.5]).astype(np.uint8)

    def measures(image):
        saturation = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)[..., 1].mean()
        return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).std(), saturation

    before = measures(flat)
    after = np.array([measures(toned(flat, rng)) for _ in range(60)])
    assert np.median(after[:, 0]) > 1.6 * before[0]
    assert np.median(after[:, 1]) < 0.75 * before[1]
    assert (after.std(axis=0) > [1, 10]).all()


def test_sharpening_leaves_seams():
    edge = np.full((40, 40, 3), 80, np.uint8)
    edge[:, 20:] = 160
    ranges = [np.ptp(sharpened(edge, np.random.default_rng(seed)).astype(int)) for seed in range(10)]
    assert min(ranges) == 80
    assert max(ranges) > 100


def test_a_cluttered_data_set_is_reproducible(tmp_path):
    first, second = (render_dataset(tmp_path / n, 3, seed=5, clutter=True, workers=1) for n in ("a", "b"))
    for image in read_dataset(first).images:
        assert image.path.read_bytes() == (second / "images" / image.path.name).read_bytes()
    assert (first / "annotations.json").read_text() == (second / "annotations.json").read_text()
