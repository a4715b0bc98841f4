"""What the detector reports in flights with pictures, and what is drawn without pictures from the same poses.

python tools/compare_looks.py              # three flights of belief in person-wilderness: 10 minutes
python tools/compare_looks.py 70001        # the seeds to fly

Prints the table in docs/statistical-sensor.md: the share of looks at each kind that is reported, by height.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

import skysweep as ss
from skysweep.experiments.sweep.spec import load_spec, scenarios_of
from skysweep.flights.build import build_mission, make_detector
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import CameraPose, project
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.model import Scenario
from skysweep.sensing.cameras.rendered import RenderedCamera
from skysweep.types import Detections, Detector, Frame, Truth, VehicleState
from skysweep.worlds.occlusion import middle_enu_m
from skysweep.worlds.world import World

SWEEP, LABEL = Path(__file__).parent.parent / "examples" / "belief.yaml", "person-wilderness-belief"
SEEDS = (70001, 70010, 70011)
HEIGHTS_M = (0.0, 20.0, 30.0)
BEYOND = 0.6  # of an object's pixels, at least 8 px: then a report is not of the object
GROUND = "nothing"


class Watched:
    """A camera and a detector of one flight that keep the true pose, what was reported, and what is drawn."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self._scenario, self._seed = scenario, seed
        self._detector: Detector = make_detector(scenario, threads=1)
        self.class_names = self._detector.class_names
        self.world = ss.build_world(scenario, seed)
        self.looks: dict[float, tuple[CameraPose, Detections]] = {}  # true pose, drawn; by time of exposure
        self.reported: dict[float, Detections] = {}

    def camera(self, world: World, eye: Truth) -> Watched:
        self._eye = eye
        self._camera = RenderedCamera(world, self._scenario.camera, eye, self._seed)
        return self

    def capture(self, state: VehicleState) -> Frame:
        pose, (velocity_mps, _) = self._eye.true_camera_pose(), self._eye.true_camera_motion()
        self.looks[state.time_s] = pose, self.world.detect(pose, pose.R_camera_to_enu @ velocity_mps)
        return self._camera.capture(state)

    def detect(self, frame: Frame) -> Detections:
        self.reported[frame.time_s] = self._detector.detect(frame)
        return self.reported[frame.time_s]

    def close(self) -> None:
        self._camera.close()


def main() -> None:
    scenario = dict(scenarios_of(load_spec(SWEEP)))[LABEL]
    counts: defaultdict[tuple[str, int], np.ndarray] = defaultdict(lambda: np.zeros(3))  # looks, both reports
    for seed in map(int, sys.argv[1:] or SEEDS):
        watched = Watched(scenario, seed)
        rig = Rig("imaging", make_camera=watched.camera, detector=watched)
        fly(build_mission(scenario, seed, rig), MemoryJournal())
        count(watched, counts)
    print("| | height | looks | reported | drawn |")
    print("|---|---|---|---|---|")
    for (kind, band), (looks, reported, drawn) in sorted(counts.items()):
        between = f"{HEIGHTS_M[band]:g} to {HEIGHTS_M[band + 1]:g} m"
        rates = f"{reported:.0f} | {drawn:.0f}"
        if kind != GROUND:
            rates = f"{reported / looks:.2f} | {drawn / looks:.2f}"
        print(f"| {kind} | {between} | {looks:.0f} | {rates} |")


def count(watched: Watched, counts: defaultdict[tuple[str, int], np.ndarray]) -> None:
    world = watched.world
    places = np.array([middle_enu_m(thing) for thing in world.objects])
    sizes_m = np.array([thing.size_m for thing in world.objects])
    names = [f"{thing.kind}, {thing.pose}" for thing in world.objects]
    for time_s, found in watched.reported.items():
        pose, drawn = watched.looks[time_s]
        x, y, z = pose.position_enu_m.tolist()
        band = int(np.digitize(z - world.ground_m(x, y), HEIGHTS_M)) - 1
        if band >= len(HEIGHTS_M) - 1:
            continue
        lens = found.lens
        pixels, depths_m = project(lens, pose, places)
        ahead = depths_m > 0.0
        inside = ahead & ((pixels >= 0.0) & (pixels < [lens.width_px, lens.height_px])).all(axis=1)
        for index in np.flatnonzero(inside).tolist():
            counts[names[index], band][0] += 1
        counts[GROUND, band][0] += 1
        reach_px = np.maximum(BEYOND * lens.focal_px * sizes_m / np.maximum(depths_m, 0.1), 8.0)
        for column, reports in ((1, found), (2, drawn)):
            centres = (reports.boxes_xyxy_px[:, :2] + reports.boxes_xyxy_px[:, 2:]) / 2.0
            for centre in centres:
                away_px = np.hypot(*(pixels - centre).T)
                near = ahead & (away_px <= reach_px)
                name = names[int(np.where(near, away_px, np.inf).argmin())] if near.any() else GROUND
                counts[name, band][column] += 1


if __name__ == "__main__":
    main()
