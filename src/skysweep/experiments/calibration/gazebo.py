"""The recall of a detector trained on our renderer, in Gazebo's pictures of the same views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skysweep.errors import UserError
from skysweep.gazebo.lockstep import GazeboRenderer
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import Scenario
from skysweep.sensing.cameras.effects import CameraEffects
from skysweep.types import F64, Detections, Detector, Frame
from skysweep.worlds.rendering.renderer import Painter, Renderer, make_renderer
from skysweep.worlds.world import World, build_world

VISIBLE_MIN = 0.5  # share of a target's pixels that must be seen for it to count
TILT_STD_RAD = np.radians(2.0)
_EDGE_SHARE = 0.4  # greatest distance of a target from the picture's middle, as a share of its height
_SLACK_PX = 1.0


@dataclass(slots=True)
class TransferScore:
    """Counts of one renderer at one altitude."""

    renderer: str
    altitude_agl_m: float
    n_pictures: int = 0
    n_targets: int = 0
    n_found: int = 0
    n_confirming: int = 0  # found with a confidence of the scenario's c_t or more
    n_false: int = 0

    @property
    def recall(self) -> float:
        """Share of the visible targets that were found."""
        return self.n_found / self.n_targets


@dataclass(frozen=True, slots=True)
class _Seen:
    """A target in a picture."""

    kind: str
    box_px: F64  # (4,) x, y, x, y
    counts: bool  # not cut by the edge, and mostly unhidden


def transfer(
    scenario: Scenario,
    detector: Detector,
    pictures: int,
    seed: int,
    progress: Callable[[], None] = lambda: None,
) -> list[TransferScore]:
    """Recall at h_S and h_C on ``pictures`` views each, by our renderer and by Gazebo from the same poses.

    Each view has a target near its middle. All targets that are uncut and at most half hidden count. A target
    is found when the centre of a box of its class lies in it. A box with its centre in no target is false.
    Raises UserError without targets or Gazebo.
    """
    world = build_world(scenario, seed)
    if scenario.camera.kind == "thermal":
        raise UserError("camera.kind: Gazebo draws no thermal pictures; write visible")
    if not world.targets:
        raise UserError(f"{scenario.name}: has no targets to look for; write some under targets")
    camera, search = scenario.camera, scenario.search
    ours = make_renderer(world)
    gazebo = GazeboRenderer(world, scenario, min(scenario.detector.rate_hz, camera.rate_hz))
    painters: tuple[Painter, ...] = (ours, gazebo)
    scores = []
    try:
        for altitude in (search.scan_altitude_agl_m, search.check_altitude_agl_m):
            pair = [TransferScore(p.backend, altitude) for p in painters]
            scores += pair
            rng = np.random.default_rng([seed, round(altitude * 100), 59])
            look = (camera.lens, camera.exposure_s, camera.noise_std, camera.jpeg_quality)
            effects = CameraEffects(*look, int(rng.integers(2**31)))
            for number in range(pictures):
                pose = _view(world, camera.lens, altitude, rng)
                boxes = _visible(world, ours, camera.lens, pose)
                for score, painter in zip(pair, painters, strict=True):
                    clean = painter.render(camera.lens, pose)
                    image = effects.apply(clean, number, pose, np.zeros(3), np.zeros(3), altitude)
                    found = detector.detect(Frame(0.0, image, pose, camera.lens))
                    _count(score, found, boxes, search.c_t)
                progress()
    finally:
        ours.close()
        gazebo.close()
    return scores


def _view(world: World, lens: Lens, altitude_agl_m: float, rng: np.random.Generator) -> CameraPose:
    """Roughly nadir, with a target in the middle part of the picture."""
    target = world.targets[int(rng.integers(len(world.targets)))]
    reach = _EDGE_SHARE * lens.footprint_m(altitude_agl_m)[1]
    xy = target.position_enu_m[:2] + rng.uniform(-reach, reach, 2)
    z = float(world.terrain.height_m(xy)[0]) + altitude_agl_m
    yaw = float(rng.uniform(-np.pi, np.pi))
    pitch, roll = rng.normal(0.0, TILT_STD_RAD, 2)
    return CameraPose(np.array([*xy, z]), rotation_camera_to_enu(yaw, -np.pi / 2 + float(pitch), float(roll)))


def _visible(world: World, renderer: Renderer, lens: Lens, pose: CameraPose) -> list[_Seen]:
    seen = renderer.render_ids(lens, pose)
    alone = renderer.render_ids(lens, pose, occluders=False)
    boxes = []
    for number, thing in enumerate(world.objects, start=1):
        rows, columns = np.nonzero(alone == number)
        if not thing.is_target or len(rows) == 0:
            continue
        box = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], dtype=float)
        uncut = box[:2].min() > 0 and box[2] < lens.width_px and box[3] < lens.height_px
        counts = uncut and np.count_nonzero(seen == number) >= VISIBLE_MIN * len(rows)
        boxes.append(_Seen(thing.kind, box, bool(counts)))
    return boxes


def _count(score: TransferScore, found: Detections, targets: list[_Seen], c_t: float) -> None:
    """Each target takes the most confident box in it; those that count choose first."""
    score.n_pictures += 1
    free = list(range(len(found)))
    centres = 0.5 * (found.boxes_xyxy_px[:, :2] + found.boxes_xyxy_px[:, 2:])
    for target in sorted(targets, key=lambda t: not t.counts):
        low, high = target.box_px[:2] - _SLACK_PX, target.box_px[2:] + _SLACK_PX
        inside = [
            k
            for k in free
            if found.class_names[k] == target.kind and ((centres[k] >= low) & (centres[k] <= high)).all()
        ]
        best = max(inside, key=lambda k: found.confidences[k], default=None)
        if best is not None:
            free.remove(best)
        if target.counts:
            score.n_targets += 1
            score.n_found += best is not None
            score.n_confirming += best is not None and bool(found.confidences[best] >= c_t)
    score.n_false += len(free)
