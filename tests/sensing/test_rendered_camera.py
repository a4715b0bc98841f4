"""The camera: effects that can be measured, and a believed pose that is late."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.geometry.camera import CameraMotion, CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import CameraModel, Light
from skysweep.sensing.believed import DelayedPose
from skysweep.sensing.cameras import effects
from skysweep.sensing.cameras.effects import CameraEffects, blur_kernel
from skysweep.sensing.cameras.rendered import RenderedCamera
from skysweep.types import VehicleState
from skysweep.worlds.world import TerrainSurface, World, WorldObject

LENS = Lens(320, 180, 1.2)
DOWN = rotation_camera_to_enu(np.pi / 2, -np.pi / 2)  # picture's top is north, right is east
STILL = np.zeros(3)


def pose(x: float = 0.0, z: float = 10.0) -> CameraPose:
    return CameraPose(np.array([x, 0.0, z]), DOWN)


def state(time_s: float, camera: CameraPose) -> VehicleState:
    return VehicleState(time_s, camera.position_enu_m, STILL, np.eye(3), camera, 1.0, 0.0, True)


def photograph(image: np.ndarray, seed: int = 0, index: int = 0, **settings: object) -> np.ndarray:
    options = {"exposure_s": 1 / 500, "noise_std": 0.0, "jpeg_quality": 95} | settings
    camera = CameraEffects(LENS, seed=seed, **options)  # type: ignore[arg-type]
    return camera.apply(image, index, pose(), STILL, STILL, 10.0)


GREY = np.full((180, 320, 3), 120, np.uint8)


def test_noise_has_the_standard_deviation_that_was_asked_for() -> None:
    camera = CameraEffects(LENS, 1 / 500, noise_std=4.0, jpeg_quality=100, seed=1)
    noise = camera.apply(GREY, 0, pose(), STILL, STILL, 10.0).astype(float)
    assert noise.std() == pytest.approx(4.0, rel=0.35)


def test_frames_differ_but_a_seed_and_an_index_give_the_same_bytes() -> None:
    first = photograph(GREY, seed=5, index=7, noise_std=3.0)
    assert np.array_equal(first, photograph(GREY, seed=5, index=7, noise_std=3.0))
    assert not np.array_equal(first, photograph(GREY, seed=5, index=8, noise_std=3.0))
    assert not np.array_equal(first, photograph(GREY, seed=6, index=7, noise_std=3.0))


def test_a_large_picture_made_in_bands_is_as_if_made_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    lens = Lens(300, 2260, 0.3)  # three bands, the last of 84 rows
    image = np.random.default_rng(2).integers(0, 255, (2260, 300, 3), dtype=np.uint8)

    def made() -> np.ndarray:
        camera = CameraEffects(lens, 1 / 500, 3.0, jpeg_quality=80, seed=1)
        return camera.apply(image, 3, pose(), np.array([9.0, 0.0, 0.0]), STILL, 10.0)

    in_bands = made()
    monkeypatch.setattr(effects, "_BAND_PX", 4096)
    np.testing.assert_array_equal(in_bands, made())


def test_exposure_wanders_by_a_few_percent() -> None:
    levels = [photograph(GREY, index=k).mean() for k in range(0, 200, 5)]
    assert 1.0 < np.std(levels) < 15.0


@given(dx=st.floats(-20, 20), dy=st.floats(-20, 20))
def test_blur_kernel_is_centred_and_keeps_the_light(dx: float, dy: float) -> None:
    kernel = blur_kernel(dx, dy)
    half = kernel.shape[0] // 2
    offsets = np.arange(-half, half + 1)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-5)
    assert kernel.sum(axis=0) @ offsets == pytest.approx(0.0, abs=1e-3)
    assert kernel.sum(axis=1) @ offsets == pytest.approx(0.0, abs=1e-3)
    spread = kernel.sum(axis=0) @ offsets**2
    assert spread == pytest.approx(dx**2 / 12, rel=0.05, abs=0.5)


@pytest.mark.parametrize(
    ("velocity", "rate", "axis"),
    [
        ((6.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1),  # east: along the rows
        ((0.0, 6.0, 0.0), (0.0, 0.0, 0.0), 0),
        ((0.0, 0.0, 0.0), (0.0, 0.6, 0.0), 1),  # turning about north sweeps the view east or west
        ((0.0, 0.0, 0.0), (0.6, 0.0, 0.0), 0),
    ],
)
def test_motion_blurs_along_the_motion(velocity: tuple, rate: tuple, axis: int) -> None:
    dot = np.zeros((180, 320, 3), np.uint8)
    dot[85:95, 155:165] = 255
    effects = CameraEffects(LENS, exposure_s=1 / 20, noise_std=0.0, jpeg_quality=100, seed=0)
    blurred = effects.apply(dot, 0, pose(), np.array(velocity), np.array(rate), 10.0)[..., 1].astype(float)
    weight = blurred / blurred.sum()
    spread = [
        np.sqrt(weight.sum(axis=1 - k) @ (np.arange(weight.shape[k]) - c) ** 2)
        for k, c in ((0, 89.5), (1, 159.5))
    ]
    assert spread[axis] > spread[1 - axis] + 0.5


def test_effects_are_cheap() -> None:
    image = np.random.default_rng(0).integers(0, 255, (360, 640, 3), dtype=np.uint8)
    effects = CameraEffects(Lens(640, 360, 2.0), 1 / 100, 2.0, 90, seed=0)
    start = time.process_time()
    for k in range(20):
        effects.apply(image, k, pose(), np.array([5.0, 0, 0]), STILL, 10.0)
    assert (time.process_time() - start) / 20 < 0.03


@given(delay_s=st.floats(0, 1), at_s=st.floats(0, 10), step_s=st.floats(0.02, 0.4))
def test_believed_pose_of_steady_flight_lags_by_speed_times_delay(
    delay_s: float, at_s: float, step_s: float
) -> None:
    believed = DelayedPose(delay_s)
    times = np.arange(0.0, at_s + step_s, step_s)
    for t in times:
        believed.push(
            float(t), CameraPose(np.array([5.0 * t, 0.0, 30.0]), rotation_camera_to_enu(0.2 * t, -1.2))
        )
    seen = believed.at(float(times[-1]))
    then = max(float(times[-1]) - delay_s, 0.0)
    assert seen.position_enu_m == pytest.approx([5.0 * then, 0.0, 30.0], abs=1e-6)
    assert seen.R_camera_to_enu == pytest.approx(rotation_camera_to_enu(0.2 * then, -1.2), abs=1e-4)


def sign_world() -> World:
    terrain = TerrainSurface(np.zeros((2, 2)), (-50.0, -50.0, 50.0, 50.0), "grass")
    sign = WorldObject("stop sign", np.zeros(3), 0.0, 0.75, "face-up", True, 1000)
    return World(terrain, (sign,), (), (), Light(), 0)


class Eye:
    """Stays in one place, as if it moved. Implements ``types.Truth``."""

    def __init__(self, at, velocity_mps=STILL):
        self.at, self.velocity_mps = at, velocity_mps

    def true_camera_pose(self):
        return self.at

    def true_camera_motion(self):
        return CameraMotion(self.velocity_mps, STILL)


MODEL = CameraModel(width_px=320, height_px=180, hfov_rad=1.2)


def test_capture_shows_the_truth_and_hands_on_the_belief() -> None:
    camera = RenderedCamera(sign_world(), MODEL, Eye(pose(0.0, 6.0)), seed=1)
    frame = camera.capture(state(0.4, pose(4.0)))
    assert frame.camera.position_enu_m[0] == 4.0
    assert frame.time_s == 0.4
    red = frame.image[..., 0].astype(int) - frame.image[..., 1] > 60
    rows, columns = np.nonzero(red)
    assert np.hypot(columns.mean() - 160, rows.mean() - 90) < 3  # the true camera hangs above the sign


def test_a_seed_gives_the_same_frames() -> None:
    def film(seed: int) -> list[bytes]:
        eye = Eye(pose(), np.array([5.0, 0, 0]))
        camera = RenderedCamera(sign_world(), MODEL, eye, seed)
        return [camera.capture(state(0.1 * k, pose())).image.tobytes() for k in range(3)]

    assert film(3) == film(3)
    assert film(3) != film(4)
