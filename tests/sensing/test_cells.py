from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraMotion, CameraPose, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import CameraModel, DetectorModel, Light
from skysweep.sensing.statistical.cells import SearchedCells
from skysweep.sensing.statistical.model import StatisticalModel
from skysweep.sensing.statistical.sweep_width import lateral_range
from skysweep.worlds.world import GroundCover, TerrainSurface

CAMERA = CameraModel(hfov_rad=1.4)
MODEL = StatisticalModel.load()
STILL = CameraMotion(np.zeros(3), np.zeros(3))
NIGHT = Light(sun_elevation_deg=-10.0)
NO_SOLIDS = np.zeros((0, 11))
FLAT = TerrainSurface(np.zeros((2, 2)), (-1000, -1000, 1000, 1000), "grass")


def grid(rows: int = 20, columns: int = 30, cell_m: float = 2.0, z: float = 0.0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(columns) * cell_m, np.arange(rows) * cell_m)
    return np.stack([x, y, np.full(x.shape, z)], axis=-1)


def cells_over(
    centres: np.ndarray,
    solids: np.ndarray = NO_SOLIDS,
    name: str = "person",
    pose: str = "lying",
    terrain: TerrainSurface = FLAT,
    light: Light = NIGHT,
):
    wanted = np.ones(centres.shape[:2], dtype=bool)
    of_target = {name: (1.75, 1.75)}, {name: (pose,)}, 0.0
    return SearchedCells(centres, wanted, terrain, solids, light, CAMERA, DetectorModel(), MODEL, *of_target)


poses = st.builds(
    lambda x, y, z, yaw, pitch, roll: CameraPose(
        np.array([x, y, z]), rotation_camera_to_enu(yaw, pitch, roll)
    ),
    st.floats(-20, 80),
    st.floats(-20, 60),
    st.floats(1, 90),
    st.floats(-math.pi, math.pi),
    st.floats(-math.pi / 2, 0.5),
    st.floats(-1, 1),
)


@settings(max_examples=60)
@given(st.lists(poses, min_size=1, max_size=4), st.sampled_from(["lying", "standing"]))
def test_it_grows_within_0_and_1_and_only_where_the_picture_shows_the_cell(looks, pose):
    centres = grid()
    cells, before = cells_over(centres, pose=pose), np.zeros(centres.shape[:2])
    middle = centres + np.array([0, 0, 0.875 if pose == "standing" else 0.0])
    for camera in looks:
        cells.look(camera, STILL)
        pod = cells.pod
        assert (pod >= before).all()
        assert pod.max() <= 1.0
        uv, depth = project(CAMERA.lens, camera, middle.reshape(-1, 3))
        half_px = np.where(depth > 0.1, 0.5 * CAMERA.lens.focal_px * 1.75 / np.maximum(depth, 0.1), 0.0)
        size = CAMERA.lens.width_px, CAMERA.lens.height_px
        shown = (depth > 0.1) & ((uv > -half_px[:, None]) & (uv < size + half_px[:, None])).all(axis=1)
        assert not (pod > before).ravel()[~shown].any()
        whole = (depth > 0.1) & ((uv > half_px[:, None]) & (uv < size - half_px[:, None])).all(axis=1)
        large = 2 * half_px * (0.3 if pose == "standing" else 1.0) > MODEL.pixels[0]
        sure = whole & large & (before.ravel() < 0.99)
        assert (pod > before).ravel()[sure].all()
        before = pod


@pytest.mark.parametrize(("height_m", "is_halved"), [(8.0, True), (30.0, False)])
def test_a_wide_picture_from_low_altitude_counts_as_one_of_half_the_size(height_m, is_halved):
    kinds = [kind.model_copy(update={"lens": 0.0}) for kind in MODEL.kinds]
    of_target = {"person": (1.75, 1.75)}, {"person": ("standing",)}, 1.75
    centres, pods = grid(), []
    for width_px, height_px in ((640, 360), (1280, 720)):
        camera = CameraModel(width_px=width_px, height_px=height_px, hfov_rad=1.4)
        of_look = camera, DetectorModel(), MODEL.model_copy(update={"kinds": kinds}), *of_target
        wanted = np.ones(centres.shape[:2], dtype=bool)
        cells = SearchedCells(centres, wanted, FLAT, NO_SOLIDS, NIGHT, *of_look)
        cells.look(
            CameraPose(np.array([20.0, 15.0, height_m]), rotation_camera_to_enu(0.0, -math.pi / 2)), STILL
        )
        pods.append(cells.pod)
    assert pods[0].max() > 0.3
    assert np.allclose(*pods, rtol=1e-9) is is_halved


@pytest.mark.parametrize(
    ("name", "pose", "size_m", "height_m"),
    [
        ("stop sign", "face-up", 0.9, 90.0),
        ("person", "lying", 1.75, 60.0),
        ("person", "standing", 1.75, 60.0),
        ("person", "floating", 1.7, 40.0),
    ],
)
@pytest.mark.parametrize("lapses", [(0.0, 0.0, 0.0), (0.2, 0.6, 0.4), (0.2, 0.0, 0.5)])
def test_a_straight_pass_agrees_with_drawn_ones(name, pose, size_m, height_m, lapses):
    """``lateral_range`` draws a thousand passes, with the luck that looks have in common."""

    calm = load_scenario("clusters")
    kind = next(k for k in MODEL.kinds if k.kind == k.reported_as == name and k.pose == pose)
    more, *shares = lapses
    of_lapses = dict(zip(("lapse_object_share", "lapse_aspect_share"), shares, strict=True))
    kind = kind.model_copy(update={"lapse": [max(share, more) for share in kind.lapse], **of_lapses})
    model = MODEL.model_copy(update={"kinds": [kind]})
    width_m, along_m = CAMERA.lens.footprint_m(height_m)
    aside_m = width_m / 2 * np.array([0.1, 0.4, 0.7])
    drawn = lateral_range(calm, kind, size_m, height_m, aside_m, {"unknown": 1.0})
    step_m = calm.search.scan_speed_mps / calm.detector.rate_hz
    R = rotation_camera_to_enu(math.pi / 2, -math.pi / 2)
    motion = CameraMotion(R.T @ np.array([0.0, calm.search.scan_speed_mps, 0.0]), np.zeros(3))
    passes = []
    for share in np.linspace(0, 1, 4, endpoint=False):
        centres = np.stack([aside_m, 0 * aside_m, 0 * aside_m], axis=-1)[None]
        of_target = {name: (size_m, size_m)}, {name: (pose,)}, 0.0
        unknown = replace(FLAT, surface="unknown")
        cells = SearchedCells(
            centres,
            np.ones((1, 3), bool),
            unknown,
            NO_SOLIDS,
            NIGHT,
            CAMERA,
            DetectorModel(),
            model,
            *of_target,
        )
        for y in np.arange(-along_m / 2 - 5 + share * step_m, along_m / 2 + 5, step_m):
            cells.look(CameraPose(np.array([0.0, y, height_m]), R), motion)
        passes.append(cells.pod[0])
    assert 0.3 < drawn.min() < 0.97
    assert np.mean(passes, axis=0) == pytest.approx(drawn, abs=0.06)  # of a thousand: 0.03 in 95 of 100


def test_looks_at_one_aspect_count_less_than_looks_at_several():
    """What a look misses, the next from the same side misses, too, and so does another passing there."""
    down, high = rotation_camera_to_enu(0.0, -math.pi / 2), 60.0
    there, away = np.array([0.0, 0.0, high]), np.array([500.0, 0.0, high])
    same, later, sides = (cells_over(grid(1, 2)) for _ in range(3))
    for k in range(4):
        same.look(CameraPose(there, down), STILL)
        later.look(CameraPose(there, down), STILL)
        later.look(CameraPose(away, down), STILL)
        aside = np.array([(25.0, 0.0, high), (-25.0, 0.0, high), (0.0, 15.0, high), (0.0, -15.0, high)][k])
        sides.look(CameraPose(aside, down), STILL)
    assert same.pod[0, 0] == later.pod[0, 0]
    assert 0.05 < same.pod[0, 0] < sides.pod[0, 0] - 0.05


def test_a_crown_hides_what_lies_behind_it_from_there():
    crown = np.array([[20.0, 20.0, 8.0, 3.0, 3.0, 4.0, 1.0, 0.0, 12.0, 3.0, 0.0]])
    centres = grid(20, 20)
    under, behind, before = (10, 10), (10, 13), (10, 6)

    def seen_from(x_m: float, solids: np.ndarray) -> np.ndarray:
        cells = cells_over(centres, solids)
        place = np.array([x_m, 20.0, 25.0])
        cells.look(CameraPose(place, rotation_camera_to_enu(math.pi / 2, -math.pi / 2)), STILL)
        return cells.pod

    from_west, from_above, from_east = (seen_from(x, crown) for x in (11.0, 20.0, 32.0))
    free = seen_from(11.0, NO_SOLIDS)
    assert free[behind] > 0.3
    assert from_west[behind] == from_above[under] == 0.0
    assert from_west[before] == free[before] > 0.3
    assert from_east[behind] > 0.3


def test_in_the_shadow_of_a_crown_less_is_seen():
    crown, centres = np.array([[20.0, 20.0, 8.0, 3.0, 3.0, 4.0, 1.0, 0.0, 12.0, 3.0, 0.0]]), grid(20, 20)
    south, eye = Light(sun_elevation_deg=45.0, sun_heading_deg=180.0), np.array([20.0, 20.0, 30.0])
    dark, sunny = (cells_over(centres, crown, light=light) for light in (NIGHT, south))
    for cells in (dark, sunny):
        cells.look(CameraPose(eye, rotation_camera_to_enu(math.pi / 2, -math.pi / 2)), STILL)
    shadow = np.hypot(centres[..., 0] - 20.0, centres[..., 1] - 28.0) < 2.0  # 8 m north of the crown
    seen = dark.pod > 0.3
    assert (shadow & seen).any()
    assert (sunny.pod < dark.pod - 0.01)[shadow & seen].all()
    assert np.array_equal(sunny.pod[:10], dark.pod[:10]), "towards the sun"


def test_a_ridge_hides_what_lies_behind_it_from_there():
    """A wall of ground, 30 m high, between the eye in the west and the east."""
    heights = np.zeros((101, 101))
    heights[:, 50] = 30.0
    ridge = TerrainSurface(heights, (-1.0, -1.0, 41.0, 41.0), "grass")
    eye = CameraPose(np.array([5.0, 20.0, 35.0]), rotation_camera_to_enu(0.0, -1.0))
    flat, hilly = (cells_over(grid(20, 20), terrain=t) for t in (FLAT, ridge))
    for cells in (flat, hilly):
        cells.look(eye, STILL)
    assert (flat.pod[:, 14:18].max(axis=0) > 0.3).all()
    assert not hilly.pod[:, 14:18].any()
    assert np.array_equal(hilly.pod[:, 4:9], flat.pod[:, 4:9])


def test_what_covers_the_ground_counts_cell_by_cell():
    centres, west_half = grid(10, 20), (0.0, 0.0, 40.0, 20.0)
    rock, grass = (cells_over(centres, terrain=replace(FLAT, surface=s)) for s in ("rock", "grass"))
    cover = GroundCover(np.array([[0, 1]], dtype=np.uint8), west_half, ("rock", "grass"))
    mixed = cells_over(centres, terrain=replace(FLAT, cover=cover))
    for cells in (rock, grass, mixed):
        cells.look(CameraPose(np.array([20.0, 10.0, 60.0]), rotation_camera_to_enu(0.0, -1.5)), STILL)
    assert np.array_equal(mixed.pod[:, :10], rock.pod[:, :10])
    assert np.array_equal(mixed.pod[:, 10:], grass.pod[:, 10:])
    assert np.abs(rock.pod - grass.pod).max() > 0.01


def test_after_clear_the_same_looks_give_the_same():
    cells = cells_over(grid())
    pose = CameraPose(np.array([30.0, 20.0, 40.0]), rotation_camera_to_enu(0.3, -1.4))
    cells.look(pose, STILL)
    first = cells.pod
    cells.clear()
    assert not cells.pod.any()
    cells.look(pose, STILL)
    assert np.array_equal(cells.pod, first)


def test_a_class_that_the_model_does_not_know_is_refused():
    with pytest.raises(UserError, match="needs a sensor model of 'walrus'"):
        cells_over(grid(), name="walrus")
