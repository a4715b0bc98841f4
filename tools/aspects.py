"""How alike two looks at one person are: the table of aspects in docs/statistical-sensor.md.

python tools/aspects.py              # 44 worlds through each lens: 8 minutes on two cores
python tools/aspects.py 8            # 8 worlds

A camera looks at persons beside no crown, so that one who lies spans 20, 50 or 120 pixels; then again with
one thing changed. The scores of both looks are standardised by all looks of their sort. Printed is their most
likely correlation, and in brackets its 95 % interval (worlds drawn with replacement).
"""

from __future__ import annotations

import math
import sys
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr

from skysweep.detection.yolo import YoloDetector
from skysweep.experiments.calibration.fit import FLOOR_SCORE
from skysweep.experiments.calibration.looks import CONFIDENCE_FLOOR, LAYOUTS, make_world
from skysweep.experiments.calibration.shares import Pairs
from skysweep.geometry.camera import CameraPose, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import CameraModel
from skysweep.sensing.cameras.exposing import exposing
from skysweep.sensing.statistical.model import score_of
from skysweep.types import F64, Frame
from skysweep.worlds.occlusion import Occluders, middle_enu_m
from skysweep.worlds.rendering.renderer import make_renderer

FOCALS_PX = (2807.0, 380.0)  # of `valley`'s camera, and of the calibration's
SPANS_PX = (20.0, 50.0, 120.0)
PERSONS = 6  # of one world
JITTER_PX = 25.0
LAPSE, LAPSE_SHARE = 0.02, 0.5
CORRELATIONS = np.linspace(0.0, 0.98, 50)
PEOPLE = LAYOUTS[0], LAYOUTS[3]
GROUPS = {
    "lying": ("lying",),
    "standing, walking, waving": ("standing", "walking", "waving"),
    "sitting, crouching": ("sitting", "crouching"),
}


class Change(NamedTuple):
    """What is different in the second look."""

    turned_deg: float = 0.0  # of the line of sight, from straight down
    smaller: float = 1.0  # times
    rotated_deg: float = 0.0  # of the picture


BASE = Change()
CHANGES = (
    BASE,
    *(Change(turned_deg=degrees) for degrees in (10.0, 24.0, 35.0)),
    *(Change(smaller=times) for times in (1.4, 2.0, 3.0)),
    Change(rotated_deg=90.0),
)


Scores = dict[tuple[int, float, "Change"], list[tuple[float, bool]]]


class Seen(NamedTuple):
    """One look."""

    person: int
    pose: str
    span_px: float
    change: Change
    confidence: float  # 0 where nothing was reported


def look_around(focal_px: float, seed: int) -> list[Seen]:
    """The looks in one world."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, 99])
    world = make_world(PEOPLE[seed % len(PEOPLE)], rng, "visible")
    camera = CameraModel(hfov_rad=2.0 * math.atan(320.0 / focal_px))
    renderer, occluders = make_renderer(world), Occluders(world)
    expose = exposing(camera, renderer, seed)
    detector = YoloDetector("skysweep", confidence_min=CONFIDENCE_FLOOR)
    free = [
        (k, thing)
        for k, thing in enumerate(world.objects)
        if thing.kind == "person" and not occluders.is_beside_a_crown(thing.position_enu_m, thing.size_m)
    ]
    found = list[Seen]()
    for k in rng.permutation(len(free))[:PERSONS].tolist():
        number, person = free[k]
        middle = middle_enu_m(person)
        for span_px in SPANS_PX:
            towards_rad, yaw_rad = rng.uniform(-np.pi, np.pi, 2).tolist()
            for change in (BASE, *CHANGES):
                depth_m = focal_px * person.size_m * change.smaller / span_px
                pose = _pose(middle, depth_m, focal_px, towards_rad, yaw_rad, change, rng)
                image = expose(len(found), pose, 0.0, np.zeros(3), rng.normal(0.0, 0.02, 3), depth_m)
                reports = detector.detect(Frame(0.0, image, pose, camera.lens))
                place = project(camera.lens, pose, middle[None])[0][0]
                boxes = reports.boxes_xyxy_px
                away = np.linalg.norm((boxes[:, :2] + boxes[:, 2:]) / 2.0 - place, axis=1)
                is_of_it = (away < max(6.0, 0.6 * span_px)) & (np.array(reports.class_names) == "person")
                confidence = float(reports.confidences[is_of_it].max(initial=0.0))
                found.append(Seen(1000 * seed + number, person.pose, span_px, change, confidence))
    renderer.close()
    return found


def _pose(
    middle: F64,
    depth_m: float,
    focal_px: float,
    towards_rad: float,
    yaw_rad: float,
    change: Change,
    rng: np.random.Generator,
) -> CameraPose:
    """From so far away, with the middle near the picture's."""
    turned = math.radians(change.turned_deg)
    level = math.sin(turned) * np.array([math.cos(towards_rad), math.sin(towards_rad), 0.0])
    away = level + np.array([0.0, 0.0, math.cos(turned)])
    x, y, _ = axis = np.array([-away[1], away[0], 0.0])
    cross = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    tilt = np.eye(3) + cross + cross @ cross / (1.0 + away[2]) if axis.any() else np.eye(3)
    R = tilt @ rotation_camera_to_enu(yaw_rad + math.radians(change.rotated_deg), -np.pi / 2.0, 0.0)
    aside = rng.uniform(-JITTER_PX, JITTER_PX, 2) * depth_m / focal_px
    return CameraPose(middle + away * depth_m + R @ np.array([*aside, 0.0]), R)


def standardised(looks: list[Seen]) -> Scores:
    """Of each person, span and change the scores of its looks, or the floor, and whether it was reported."""
    alike, scores = defaultdict[tuple[str, float, Change], list[Seen]](list), defaultdict(list)
    for look in looks:
        alike[look.pose, look.span_px, look.change].append(look)
    for (_, span_px, change), sort in alike.items():
        mean, std = _normal(np.array([look.confidence for look in sort]))
        for look in sort:
            seen = look.confidence > 0.0
            score = float(score_of(look.confidence)) if seen else FLOOR_SCORE
            scores[look.person, span_px, change].append(((score - mean) / std, seen))
    return scores


def _normal(confidences: F64) -> tuple[float, float]:
    """Mean and standard deviation of scores of which those below the floor are not known."""
    seen = confidences > 0.0
    score = score_of(confidences[seen])

    def cost(x: F64) -> float:
        std = math.exp(x[1])
        known = seen.sum() * x[1] + 0.5 * float((((score - x[0]) / std) ** 2).sum())
        unknown = (~seen).sum() * float(log_ndtr((FLOOR_SCORE - x[0]) / std))
        return float(known - unknown + 0.5 * ((x[1] + 0.6) / 0.4) ** 2 + 0.5 * ((x[0] - 0.3) / 1.5) ** 2)

    mean, log_std = minimize(cost, [0.3, -0.6], method="Nelder-Mead").x
    return float(mean), math.exp(log_std)


def pairs(scores: Scores, change: Change) -> Iterator[tuple[int, F64]]:
    """Person, scores and whether they were reported, of a look without the change and one with it."""
    for (person, span_px, what), found in scores.items():
        if what == BASE and change == BASE:
            yield person, np.array(found[:2])
        elif what == BASE:
            for other in scores[person, span_px, change]:
                for one in found:
                    yield person, np.array([one, other])


def correlation(scores: Scores, change: Change) -> str:
    """Of looks without the change and with it, and its interval."""
    persons, both = zip(*pairs(scores, change), strict=True)
    (first, was_seen), (second, is_seen) = np.array(both).transpose(1, 2, 0)
    lapses, same = np.full(len(first), LAPSE), np.zeros(len(first))
    found = Pairs(first, second, was_seen > 0, is_seen > 0, same, same, lapses, lapses)
    table = np.stack([found.log_likelihoods(r, LAPSE_SHARE) for r in CORRELATIONS])
    worlds = np.array(persons) // 1000
    of_worlds = np.stack([table[:, worlds == w].sum(axis=1) for w in np.unique(worlds)])
    n, rng = len(of_worlds), np.random.default_rng(0)
    drawn = [CORRELATIONS[of_worlds[rng.integers(n, size=n)].sum(axis=0).argmax()] for _ in range(1000)]
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{CORRELATIONS[of_worlds.sum(axis=0).argmax()]:.2f} ({low:.2f} to {high:.2f})"


def main() -> None:
    worlds = int(sys.argv[1]) if len(sys.argv) > 1 else 44
    heads = ["same place", *(f"turned by {c.turned_deg:g}°" for c in CHANGES if c.turned_deg)]
    heads += [f"{c.smaller:g} times smaller" for c in CHANGES if c.smaller > 1.0] + ["rotated by 90°"]
    print("| lens, persons | " + " | ".join(heads) + " |")
    print("|---|" + "---|" * len(heads))
    for focal_px in FOCALS_PX:
        with ProcessPoolExecutor(2) as pool:
            looks = [
                look for some in pool.map(partial(look_around, focal_px), range(worlds)) for look in some
            ]
        for name, poses in GROUPS.items():
            scores = standardised([look for look in looks if look.pose in poses])
            row = " | ".join(correlation(scores, change) for change in CHANGES)
            print(f"| {focal_px:g} px: {name} | {row} |", flush=True)
        n = len({look.person for look in looks})
        print(
            f"<!-- {n} persons in {worlds} worlds, {len(looks)} looks through {focal_px:g} px -->", flush=True
        )


if __name__ == "__main__":
    main()
