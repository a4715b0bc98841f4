"""The thermal camera: its noise and gain, and what cannot serve it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from skysweep.errors import UserError
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraMotion, CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import CameraModel, Light
from skysweep.sensing.cameras.exposing import exposing
from skysweep.sensing.cameras.rendered import RenderedCamera
from skysweep.sensing.cameras.thermal import ThermalEffects
from skysweep.sensing.statistical.model import own_sensor_path
from skysweep.types import VehicleState
from skysweep.worlds.rendering.white_hot import white_hot
from skysweep.worlds.world import TerrainSurface, World, WorldObject

LENS = Lens(320, 256, 0.554)
DOWN = rotation_camera_to_enu(np.pi / 2, -np.pi / 2)
STILL = np.zeros(3)
POSE = CameraPose(np.array([0.0, 0.0, 30.0]), DOWN)
NIGHT = Light(sun_elevation_deg=-20, sun_heading_deg=345, air_temperature_c=8.0)


def take(heat_c: np.ndarray, index: int = 0, seed: int = 0, netd_k: float = 0.05, speed_mps: float = 0.0):
    effects = ThermalEffects(LENS, 0.01, netd_k, 95, seed)
    velocity = np.array([speed_mps, 0.0, 0.0])
    return effects.apply(heat_c.astype(np.float32), index, POSE, velocity, STILL, 30.0)


def ramp(span_k: float) -> np.ndarray:
    return np.tile(np.linspace(10.0, 10.0 + span_k, 320), (256, 1))


@given(arrays.arrays(np.float32, (20, 30), elements=st.floats(-40, 90, width=32)))
def test_warmer_is_never_darker(heat_c: np.ndarray) -> None:
    grey = white_hot(heat_c).ravel()[np.argsort(heat_c, axis=None)]
    assert (np.diff(grey.astype(int)) >= 0).all()


def test_gain_follows_the_scene_but_has_an_end() -> None:
    wide, narrow = (white_hot(ramp(k).astype(np.float32)).astype(int) for k in (40.0, 0.3))
    assert np.ptp(wide) > 160
    assert np.ptp(narrow) < 30
    hot = np.full((256, 320), 5.0, np.float32)
    hot[100:110, 100:110] = 9.0
    hot[104:106, 104:106] = 25.0
    grey = white_hot(hot).astype(int)
    assert 100 < grey[0, 0] < 150
    assert grey[105, 105] > grey[101, 101] > grey[0, 0] + 60  # a head is brighter than its clothes


def test_noise_is_the_netd() -> None:
    flat = np.full((256, 320), 15.0)
    flat[:, 0], flat[:, -1] = 0.0, 30.0  # holds the gain
    quiet, noisy = (take(flat + ramp(3.0) - 10.0, netd_k=k).astype(float)[..., 0] for k in (0.0, 0.1))
    grey_per_k = 165.0 / (3.0 * 0.98)
    noise = (noisy - quiet)[:, 40:280]
    assert noise.std() == pytest.approx(0.1 * np.sqrt(1.25) * grey_per_k, rel=0.25)


def test_a_seed_and_an_index_give_the_same_bytes_in_three_equal_channels() -> None:
    heat_c = ramp(5.0)
    first = take(heat_c, index=7, seed=5)
    assert first.shape == (256, 320, 3)
    assert first.dtype == np.uint8
    assert (first == first[..., :1]).all()
    assert np.array_equal(first, take(heat_c, index=7, seed=5))
    assert not np.array_equal(first, take(heat_c, index=8, seed=5))
    assert not np.array_equal(first, take(heat_c, index=7, seed=6))


def test_motion_smears_within_the_sensors_time_constant() -> None:
    edge = np.full((256, 320), 5.0)
    edge[:, 160:] = 15.0
    half_grey = [
        np.count_nonzero(np.abs(take(edge, netd_k=0.0, speed_mps=v)[128, :, 0] - 122.0) < 60) for v in (0, 60)
    ]
    assert half_grey[0] <= 2
    assert 4 <= half_grey[1] <= 11  # 60 m/s x 10 ms are 11 pixels from 30 m


class Hovering:
    """The truth of a vehicle that stands still. Implements ``types.Truth``."""

    true_position_enu_m = POSE.position_enu_m

    def true_camera_pose(self) -> CameraPose:
        return POSE

    def true_camera_motion(self) -> CameraMotion:
        return CameraMotion(STILL, STILL)


def night_world() -> World:
    terrain = TerrainSurface(np.zeros((2, 2)), (-60.0, -60.0, 60.0, 60.0), "grass")
    person = WorldObject("person", np.zeros(3), 0.4, 1.75, "lying", True, 5)
    return World(terrain, (person,), (), (), NIGHT, 3)


def test_the_rendered_camera_shows_a_person_white_at_night() -> None:
    camera = RenderedCamera(night_world(), CameraModel(kind="thermal"), Hovering(), 0, "gl")
    frame = camera.capture(VehicleState(0.0, POSE.position_enu_m, STILL, np.eye(3), POSE, 1.0, 0.0, True))
    camera.close()
    assert frame.image.shape == (512, 640, 3)
    assert frame.image[246:266, 310:330].max() > 230
    assert 80 < np.median(frame.image) < 170


class Simulator:
    """A painter that knows colours only, as Gazebo does."""

    backend = "gazebo"

    def render(self, lens, pose, time_s=0.0):
        return np.zeros((lens.height_px, lens.width_px, 3), np.uint8)

    def close(self):
        pass


THERMAL = {
    "camera.kind": "thermal",
    "detector.model": "skysweep-thermal",
    "detector.statistical_model": str(own_sensor_path("visible")),
}


def test_what_cannot_serve_a_thermal_camera_says_so() -> None:
    with pytest.raises(UserError, match="gazebo draws no thermal pictures"):
        exposing(CameraModel(kind="thermal"), Simulator(), 0)
    thermal = change_scenario(load_scenario("person-wilderness"), THERMAL)
    for rig, words in (
        (Rig("statistical"), "camera.kind is thermal, not visible"),
        (Rig(renderer="gazebo"), "--renderer gazebo: draws no thermal pictures"),
        (Rig(renderer="gz"), "--renderer gz: draws no thermal pictures"),
    ):
        with pytest.raises(UserError, match=words):
            build_mission(thermal, 0, rig)
