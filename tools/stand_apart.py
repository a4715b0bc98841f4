"""How often things are reported that stand 5.5 to 30 m apart: the table in docs/statistical-sensor.md.

python tools/stand_apart.py          # 12 worlds a distance: 10 minutes
python tools/stand_apart.py 4        # 4 worlds

Straight down from 26 m, through the camera and in the light of person-wilderness, on its ground, no trees.
"""

from __future__ import annotations

import sys

import numpy as np

from skysweep.flights.build import make_detector
from skysweep.geometry.camera import CameraMotion, CameraPose, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import DEFAULT_SIZE_M
from skysweep.sensing.cameras.rendered import RenderedCamera
from skysweep.types import F64, VehicleState
from skysweep.worlds.occlusion import middle_enu_m
from skysweep.worlds.world import HELD_OUT_VARIANTS, TerrainSurface, World, WorldObject

THINGS = (
    ("person", "lying"),
    ("person", "standing"),
    ("clothing", "face-up"),
    ("rock", "face-up"),
    ("stump", "face-up"),
)
APART_M = (5.5, 12.0, 20.0, 30.0)
HALF_M = 75.0  # of the ground that they stand on
HEIGHT_M, SPEED_MPS = 26.0, 5.0
LOOKS = 100  # at things in one world, or a few more
HIT_PX, BORDER_PX = 12.0, 10.0
SCENARIO = load_scenario("person-wilderness")


class Eye:
    """A camera that looks straight down. Implements ``types.Truth``."""

    def look_at(self, xy: F64, yaw_rad: float) -> None:
        self.true_position_enu_m = np.array([*xy, HEIGHT_M])
        self.pose = CameraPose(self.true_position_enu_m, rotation_camera_to_enu(yaw_rad, -np.pi / 2, 0.0))

    def true_camera_pose(self) -> CameraPose:
        return self.pose

    def true_camera_motion(self) -> CameraMotion:
        return CameraMotion(np.array([0.0, -SPEED_MPS, 0.0]), np.zeros(3))


def world_of(apart_m: float, seed: int) -> World:
    rng = np.random.default_rng(seed)
    places = np.arange(-HALF_M + apart_m / 2.0, HALF_M, apart_m)
    objects = []
    for x, y in np.stack(np.meshgrid(places, places), -1).reshape(-1, 2) + rng.uniform(-0.5, 0.5, 2):
        kind, pose = THINGS[int(rng.integers(len(THINGS)))]
        yaw_rad, variant = float(rng.uniform(0, 2 * np.pi)), HELD_OUT_VARIANTS + int(rng.integers(1000))
        place = np.array([x, y, 0.0])
        is_target = kind == "person"
        objects.append(WorldObject(kind, place, yaw_rad, DEFAULT_SIZE_M[kind], pose, is_target, variant))
    bounds = (-2 * HALF_M, -2 * HALF_M, 2 * HALF_M, 2 * HALF_M)
    terrain = TerrainSurface(np.zeros((2, 2)), bounds, SCENARIO.terrain.surface)
    return World(terrain, tuple(objects), (), (), SCENARIO.light, seed)


def looks_in(apart_m: float, seed: int) -> dict[tuple[str, str], list[bool]]:
    """Whether each look at each thing reports it."""
    world, rng = world_of(apart_m, seed), np.random.default_rng([seed, 1])
    lens, detector = SCENARIO.camera.lens, make_detector(SCENARIO, threads=2)
    places = np.array([middle_enu_m(thing) for thing in world.objects])
    found: dict[tuple[str, str], list[bool]] = {thing: [] for thing in THINGS}
    eye = Eye()
    camera = RenderedCamera(world, SCENARIO.camera, eye, seed)
    while sum(map(len, found.values())) < LOOKS:
        eye.look_at(rng.uniform(-HALF_M, HALF_M, 2), float(rng.uniform(-np.pi, np.pi)))
        state = VehicleState(0.0, eye.true_position_enu_m, np.zeros(3), np.eye(3), eye.pose, 1.0, 0.0, True)
        boxes = detector.detect(camera.capture(state)).boxes_xyxy_px
        centres = (boxes[:, :2] + boxes[:, 2:]) / 2.0
        pixels, _ = project(lens, eye.pose, places)
        size = np.array([lens.width_px, lens.height_px])
        inside = ((pixels > BORDER_PX) & (pixels < size - BORDER_PX)).all(axis=1)
        for index in np.flatnonzero(inside).tolist():
            away_px = np.hypot(*(centres - pixels[index]).T)
            thing = world.objects[index]
            found[thing.kind, thing.pose].append(bool(away_px.min(initial=np.inf) < HIT_PX))
    camera.close()
    return found


def main() -> None:
    worlds = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    print("| apart | " + " | ".join(", ".join(thing) for thing in THINGS) + " |")
    print("|---|" + "---|" * len(THINGS))
    for apart_m in APART_M:
        found = [looks_in(apart_m, seed) for seed in range(worlds)]
        cells = []
        for thing in THINGS:
            rates = np.array([np.mean(looks[thing]) for looks in found if looks[thing]])
            drawn = np.random.default_rng(0).choice(rates, (2000, len(rates))).mean(axis=1)
            low, high = np.quantile(drawn, [0.025, 0.975])
            cells.append(f"{rates.mean():.2f} ({low:.2f} to {high:.2f})")
        print(f"| {apart_m:g} m | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
