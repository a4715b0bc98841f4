"""How many persons a 4K picture shows the detector whole, halved and quartered: a table in docs/detector.md.

python tools/picture_sizes.py          # 5 worlds: 10 minutes
python tools/picture_sizes.py 2        # 2 worlds

Worlds of examples/valley-crop.yaml; each of their persons is looked at from each height, straight down.
"""

from __future__ import annotations

import math
import sys
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import binomtest

from skysweep.detection.halving import HalvingDetector
from skysweep.detection.yolo import YoloDetector
from skysweep.experiments.sweep.spec import load_spec, scenarios_of
from skysweep.geometry.camera import CameraPose, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.sensing.cameras.exposing import exposing
from skysweep.types import Frame
from skysweep.worlds.occlusion import Occluders, middle_enu_m
from skysweep.worlds.rendering.renderer import make_renderer
from skysweep.worlds.world import build_world

SWEEP = Path(__file__).parents[1] / "examples" / "valley-crop.yaml"
SCENARIO = next(scenario for _, scenario in scenarios_of(load_spec(SWEEP)))
HEIGHTS_M = (20.0, 28.0, 40.0, 60.0, 80.0)
SIZES = ("whole", "half", "quarter")
OFF_CENTRE = 0.3  # of the picture, at most
NEAR = 0.7  # of what the thing spans: so near to its middle a box is of it
Key = tuple[float, str, str]  # height, size, what


def looks_in(seed: int, reported: dict[Key, list[bool]], false: dict[Key, int]) -> None:
    """Add whether the clearly visible persons of one world are reported, and the boxes on nothing."""
    camera, world = SCENARIO.camera, build_world(SCENARIO, seed)
    lens, terrain, rng = camera.lens, world.terrain, np.random.default_rng(seed)
    renderer = make_renderer(world)
    expose = exposing(camera, renderer, seed)
    classes, floor = SCENARIO.target_classes, SCENARIO.detector.confidence_min
    plain = YoloDetector("skysweep", classes, confidence_min=floor, threads=2)
    finders = [HalvingDetector(plain, (math.inf,) * n, terrain.height_at_m) for n in range(len(SIZES))]
    places, occluders = np.array([middle_enu_m(thing) for thing in world.objects]), Occluders(world)
    for thing in world.objects:
        for height_m in HEIGHTS_M if thing.kind == "person" else ():
            across, along = rng.uniform(-OFF_CENTRE, OFF_CENTRE, 2) * lens.footprint_m(height_m)
            x, y = thing.position_enu_m[0] + across, thing.position_enu_m[1] + along
            eye = np.array([x, y, terrain.height_at_m(x, y) + height_m])
            pose = CameraPose(eye, rotation_camera_to_enu(np.pi / 2, -np.pi / 2, 0.0))
            image = expose(0, pose, 0.0, np.zeros(3), np.zeros(3), height_m)
            pixels, depths = project(lens, pose, places)
            spans_px = np.array([lens.pixels_on_target(o.size_m, height_m) for o in world.objects])
            inside = (depths > 0.0) & ((pixels > 0) & (pixels < [lens.width_px, lens.height_px])).all(axis=1)
            for size, finder in zip(SIZES, finders, strict=True):
                boxes = finder.detect(Frame(0.0, image, pose, lens)).boxes_xyxy_px
                centres = (boxes[:, :2] + boxes[:, 2:]) / 2.0
                away = np.hypot(*np.moveaxis(centres[:, None] - pixels[None], -1, 0)) / spans_px
                for i in np.flatnonzero(inside).tolist():
                    o = world.objects[i]
                    if o is thing and occluders.visible_fraction(eye, o) > 0.9:
                        reported[height_m, size, o.pose].append(bool((away[:, i] < NEAR).any()))
                false[height_m, size, "boxes"] += int((away > 1.5).all(axis=1).sum())
                false[height_m, size, "pictures"] += 1
    renderer.close()


def main() -> None:
    cv2.setNumThreads(1)
    worlds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    reported: dict[Key, list[bool]] = defaultdict(list)
    false: dict[Key, int] = defaultdict(int)
    for seed in range(worlds):
        looks_in(1_700_000 + seed, reported, false)
    print("| from | persons | " + " | ".join(SIZES) + " |")
    print("|---|---|" + "---|" * len(SIZES))
    for height_m in HEIGHTS_M:
        for pose in ("lying", "standing"):
            cells = []
            for size in SIZES:
                hits = reported[height_m, size, pose]
                low, high = binomtest(sum(hits), len(hits)).proportion_ci()
                cells.append(f"{np.mean(hits):.2f} ({low:.2f} to {high:.2f})")
            print(f"| {height_m:g} m | {len(hits)} {pose} | " + " | ".join(cells) + " |", flush=True)
        per_picture = [false[height_m, s, "boxes"] / false[height_m, s, "pictures"] for s in SIZES]
        print(
            f"| {height_m:g} m | boxes on nothing a picture | "
            + " | ".join(f"{n:.2f}" for n in per_picture)
            + " |"
        )


if __name__ == "__main__":
    main()
