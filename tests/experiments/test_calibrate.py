"""The experiment behind the statistical sensor, with the real renderer and the shipped detector."""

from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.experiments.calibration.looks import (
    CLASSES,
    CONFIDENCE_FLOOR,
    LAYOUTS,
    PICTURES_PER_WORLD,
    PIXELS,
    SUBJECTS,
    Scorer,
    look_around,
    observe,
    plan_jobs,
)
from skysweep.experiments.calibration.run import calibrate
from skysweep.geometry.camera import CameraMotion, CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import CameraModel, DetectorModel, DistractorClass, Light, TargetClass
from skysweep.sensing.exposures import Exposures
from skysweep.sensing.statistical.factors import BLUR_MAX, HIDDEN_MAX, VIEW_MAX
from skysweep.sensing.statistical.model import StatisticalModel
from skysweep.sensing.statistical.sensor import StatisticalSensor
from skysweep.types import Detections, VehicleState
from skysweep.worlds.world import TerrainSurface, World, WorldObject
from warm import run_skysweep

CAMERA = CameraModel(hfov_rad=1.2)


def test_every_kind_of_a_scenario_is_looked_at():
    assert {kind for kind, _ in SUBJECTS} == {*get_args(TargetClass), *get_args(DistractorClass)}


def test_worlds_are_shared_out_as_planned():
    jobs = plan_jobs("skysweep", CAMERA, 6000, 0)
    assert sum(job.n_pictures for job in jobs) == 6000
    of_nothing = sum(job.n_pictures for job in jobs if job.empty_share == 1.0)
    assert abs(of_nothing - 2000) < PICTURES_PER_WORLD
    for layout in LAYOUTS:
        share = sum(job.layout == layout for job in jobs) / len(jobs)
        assert abs(share - layout.share) < 0.02
    n = PICTURES_PER_WORLD
    assert [j.n_pictures for j in plan_jobs("skysweep", CAMERA, n + 10, 0)] == [n, 10]


@pytest.mark.parametrize("layout", range(len(LAYOUTS)))
def test_a_world_gives_the_same_looks_again(layout):
    job = next(j for j in plan_jobs("skysweep", CAMERA, 1200, 0) if j.layout == LAYOUTS[layout])
    few = replace(job, n_pictures=4)
    (looks, background), (again, background_again) = look_around(few), look_around(few)
    for name in type(looks).__slots__:
        np.testing.assert_array_equal(getattr(looks, name), getattr(again, name))
    np.testing.assert_array_equal(background.confidences, background_again.confidences)
    assert len(looks.pixels) >= 2
    assert looks.pixels.min() >= PIXELS[0]
    assert looks.pixels.max() <= PIXELS[1]
    for share in (looks.hidden, looks.cut):
        assert 0 <= share.min() <= share.max() <= HIDDEN_MAX
    assert 0 <= looks.view.min() <= looks.view.max() <= VIEW_MAX
    assert (looks.blur_px <= BLUR_MAX * looks.pixels).all()
    assert len(background.hectares) == 4
    assert (background.hectares > 0).all()
    assert {*looks.picture.tolist()} <= set(range(4))
    found = looks.confidences > 0
    assert (looks.confidences[found] >= CONFIDENCE_FLOOR).all()
    np.testing.assert_array_equal(np.isfinite(looks.offsets_px).all(axis=2), found)
    assert {SUBJECTS[s] for s in looks.subject} <= set(LAYOUTS[layout].subjects)
    assert looks.confidences.shape[1] == len(CLASSES)


@pytest.mark.parametrize(("kind", "size_m"), [("person", 1.75), ("stop sign", 0.75)])
@pytest.mark.parametrize("away_m", [0.5, 1.0])
def test_the_sensor_draws_as_many_pixels_as_were_measured(kind, size_m, away_m):
    standing = WorldObject(kind, np.array([away_m, 0.0, 0.0]), 0.0, size_m, "standing", True, 1000)
    ground = TerrainSurface(np.zeros((2, 2)), (-50, -50, 50, 50), "grass")
    world = World(ground, (standing,), (), (), Light(), 0)
    pose = CameraPose(np.array([0.0, 0.0, 5.0]), rotation_camera_to_enu(np.pi / 2, -np.pi / 2))
    job = plan_jobs("skysweep", CAMERA, 1, 0)[0]
    still = CameraMotion(np.zeros(3), np.zeros(3))
    scorer = Scorer(world, CAMERA.lens, CAMERA.exposure_s, 0.0)
    nothing = Detections(0.0, np.zeros((0, 4)), np.zeros(0), (), pose, CAMERA.lens)
    scorer.score(0, False, nothing, np.zeros(3), np.zeros(3))
    shipped = StatisticalModel.load()
    kinds = [
        k.model_copy(update={"score": [9.0] * len(k.score), "lapse": [0.0] * len(k.lapse)})
        for k in shipped.kinds
    ]
    sure = shipped.model_copy(update={"kinds": kinds, "background": []})
    exposures = Exposures(10.0, 0.0)
    eye = SimpleNamespace(true_camera_pose=lambda: pose, true_camera_motion=lambda: still)
    sensor = StatisticalSensor(world, CAMERA, DetectorModel(), eye, exposures, [kind], 0, sure)
    state = VehicleState(CAMERA.latency_s, pose.position_enu_m, np.zeros(3), np.eye(3), pose, 1.0, 0.0, True)
    sensor.sense(state._replace(time_s=0.0))
    found = sensor.sense(state)
    measured = scorer.packed(job)[0]
    x0, y0, x1, y1 = found.boxes_xyxy_px[0]
    assert measured.cut[0] < 1e-9
    assert (x1 - x0, y1 - y0) == pytest.approx((measured.pixels[0],) * 2, rel=1e-6)


@pytest.mark.slow
def test_the_file_does_not_depend_on_the_number_of_workers(tmp_path):
    seen = []
    for workers in (1, 2):
        out = tmp_path / str(workers) / "sensor.yaml"
        model = calibrate(
            "skysweep", CAMERA, out, 24, 3, workers, lambda done, total: seen.append((done, total))
        )
        assert StatisticalModel.load(out) == model
        assert out.with_suffix(".png").stat().st_size > 20_000
        assert model.camera.hfov_rad == CAMERA.hfov_rad
        assert model.differences(CAMERA, DetectorModel()) == []
    one, two = (tmp_path / str(w) / "sensor.yaml" for w in (1, 2))
    assert one.read_bytes() == two.read_bytes()
    assert seen[-1] == (24, 24)


def test_a_missing_detector_is_told_before_anything_is_rendered(tmp_path):
    with pytest.raises(UserError, match=r"gone\.onnx"):
        observe(str(tmp_path / "gone.onnx"), CAMERA, 60, 0)


@pytest.mark.parametrize(
    ("out", "words"),
    [
        (["--out", "folder"], ["--out folder", "no YAML file"]),
        (["--out", "sensor.png"], ["--out sensor.png", "no YAML file"]),
        (["--out", "file/sensor.yaml"], ["--out file", "cannot be made or written to"]),
        (["--out", "taken.yaml"], ["taken.yaml is there and cannot be replaced"]),
        (["validate", "--out", "file"], ["--out file", "cannot be made or written to"]),
    ],
)
def test_where_nothing_can_be_written_nothing_is_rendered(tmp_path, out, words):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "taken.yaml").mkdir()
    result = run_skysweep("calibrate", *out, cwd=tmp_path, timeout_s=60)
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    for word in words:
        assert word in result.stderr
