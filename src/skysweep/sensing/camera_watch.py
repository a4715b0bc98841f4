"""Whether a camera shows what lies below its estimated place.

Every picture is judged by itself (repeated, black, white, out of focus) and by how the ground moved since
the ones before (docs/safety.md lists what that detects). Without texture or overlap nothing is judged. The
motion in a thermal camera's pictures is not: one warm straight edge outshines all texture there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from typing import NamedTuple

import cv2
import numpy as np

from skysweep.arrays import F64
from skysweep.scenarios.model import CameraKind
from skysweep.sensing.ground_motion import CELLS, GroundMotion, Mask, View, looks_down, motion, view_of
from skysweep.types import U8, Doubt, Frame
from skysweep.worlds.obstacles import Obstacles

MEMORY_LOOKS = 30  # trusted ones: earlier looks do not affect the next judgement
REPEATED = "shows the same picture again"
BLACK, WHITE, BLURRED = "shows black", "shows white", "is out of focus"
NOISY = "shows little but noise"
OF_ITSELF = (REPEATED, BLACK, WHITE, BLURRED, NOISY)  # faults of a picture whatever its pose
_STEPS, _LONG = 25, 75  # from look to look: to doubt a camera, to trust it again
_DARK, _BRIGHT = 8, 247  # grey levels
_BLIND_SHARE = 0.6  # of the picture
_SPARSE = 4  # every fourth pixel is enough for that
_SPECKS_PX = 5  # of these; a median, so that noise does not brighten black
_NOISY = 0.05  # of the brightness
_BLURRED, _SHARP_AGAIN = 0.22, 0.45  # of the sharpness of earlier looks
_ANOTHER_VIEW_RAD = 0.05  # of the pitch between two pictures: their sharpness does not compare
_STALL_S = 1.5  # of repeated pictures, after which new ones may be late
_COMMON, _TEXTURED = 0.4, 0.3  # least shares for a comparison
_ALIKE = 0.5  # least share of the texture in two pictures that fit
_STRANGE, _STRANGE_ROUGH = 0.15, 0.005  # with less they do not show the same place; rough ground needs less
_ROUGH = 0.2  # relief
_HARD_RAD = 0.1  # by which a vehicle tilts from look to look in a hard manoeuvre: its gimbal may lag
_STRANGE_STEPS_UNSURE = 2  # and no fit between: low over trees or in such a manoeuvre, one tells little
_WAVES_MPS = 1.5
_OFF_M, _OFF_SHARE = 0.5, 0.03  # explained by GNSS, and by attitude as a share of the height
_OFF_MPS, _ACROSS, _ALONG = 0.05, 0.03, 0.12  # explained drift: with time, and with the way
_FORGIVEN = 2
_JUMP, _JUMP_HARD = 4.0, 0.2  # times that, and share of the height, which a gimbal explains in one look
_CHANGE_MPS, _PROOF_S = 1.5, 2.0  # a change of velocity that late pictures would not follow
_PLAIN = 3.0  # times what is explained: such a fault would be seen
_DIRT_STEPS, _MOVING = 5, 0.5  # looks, and how much of the picture moved in each
_NEARLY_ALWAYS = 0.8
_DIRT_SHARE, _CLEAN_SHARE = 0.03, 0.01  # of the picture
_TALLEST = 0.6  # of the height: above taller obstacles nothing is compared
_UP = np.array([0.0, 0.0, 1.0])


class _Step(NamedTuple):
    exposed_s: float
    moved: GroundMotion
    off_m: float  # what is explained whatever the duration
    relief: float  # the share by which what stands on the ground may seem faster
    shows_tops_again: bool  # both pictures show what stands highest, wherever it is
    drift_mps: float  # of the surface itself
    height_m: float
    is_hard: bool = False  # a manoeuvre

    @property
    def is_rough(self) -> bool:
        return self.relief > _ROUGH

    @property
    def is_unsure(self) -> bool:
        return self.is_rough or self.is_hard

    @property
    def jump_m(self) -> float:
        """What a gimbal explains in this step alone; more in a manoeuvre, where it lags by an angle."""
        return max(_JUMP * self.off_m, _JUMP_HARD * self.height_m if self.is_hard else 0.0)

    @property
    def tells_alone(self) -> bool:
        """Whether a jump in this step alone is a fault; waves in a manoeuvre pass for one."""
        return not (self.is_hard and self.drift_mps)

    @property
    def is_strange(self) -> bool:
        """Whether the two pictures do not show the same place."""
        if self.drift_mps or (self.is_rough and not self.shows_tops_again):
            return False
        return self.moved.alike < (_STRANGE_ROUGH if self.is_rough else _STRANGE)


class _Fault(NamedTuple):
    """How the pictures differed from the estimated way."""

    why: str
    since_s: float
    off_per_m: float  # of the way
    off_mps: float

    def least(self, other: _Fault | None) -> _Fault:
        """The lesser of both differences."""
        if other is None:
            return self
        return self._replace(
            off_per_m=min(self.off_per_m, other.off_per_m), off_mps=min(self.off_mps, other.off_mps)
        )


class CameraWatch:
    """Judges the pictures of one camera, in their order. Deterministic; keeps a few small pictures."""

    def __init__(self, obstacles: Obstacles, kind: CameraKind = "visible") -> None:
        self._obstacles = obstacles
        self._compares = kind == "visible"
        self._drift_mps = _WAVES_MPS if obstacles.terrain.surface == "water" else 0.0
        self._image: U8 | None = None
        self._fresh_s = self._repeated_s = -math.inf
        self._before: View | None = None
        self._up_enu = _UP  # the vehicle's, at that
        self._tilted_rad = 0.0  # since the view before that
        self._trusted: View | None = None  # the newest
        self._steps: deque[_Step | None] = deque(maxlen=_LONG)  # None: told nothing
        self._sharpness: deque[float] = deque(maxlen=_STEPS)  # of trusted pictures
        self._pitch_rad = math.nan  # of the newest picture
        self._is_blurred = False
        self._strange: Doubt | None = None  # until motion proves the camera right
        self._follows = False  # since the newest doubt
        self._least: _Fault | None = None  # of the faults meanwhile
        self._dirt: Doubt | None = None
        self._dirty = np.zeros(CELLS, dtype=np.bool_)

    def judge(self, frame: Frame, up_enu: F64) -> Doubt | None:
        """Why not to trust a picture; None: no reason. ``up_enu`` (3,) is where the vehicle's top points."""
        grey = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), np.uint8)
        unlit = _unlit(grey)
        if unlit:
            return Doubt(unlit, frame.time_s)
        if self._image is not None and np.array_equal(frame.image, self._image):
            self._repeated_s = frame.time_s
            return Doubt(REPEATED, frame.time_s)
        stood_s = self._repeated_s - self._fresh_s
        self._image, self._fresh_s = frame.image, frame.time_s
        view = view_of(frame, grey)
        if view.noise > _NOISY * view.brightness:
            return Doubt(NOISY, frame.time_s)
        self._take_pitch(frame.camera.pitch_rad)
        if self._blurs(view.sharpness):
            return Doubt(BLURRED, frame.time_s)
        if self._compares and looks_down(view.lens, view.camera):
            if stood_s >= _STALL_S:
                self._doubt("stood still and may be late now", frame.time_s)
            self._compare(view, up_enu)
        doubt = self._strange or self._dirt
        if doubt is None:
            self._trusted = view
            self._sharpness.append(view.sharpness)
        return doubt

    def _take_pitch(self, pitch_rad: float) -> None:
        """Forget how sharp pictures were when the gimbal has turned, unless they are blurred now."""
        if abs(pitch_rad - self._pitch_rad) > _ANOTHER_VIEW_RAD and not self._is_blurred:
            self._sharpness.clear()
        self._pitch_rad = pitch_rad

    def _blurs(self, sharpness: float) -> bool:
        share = _SHARP_AGAIN if self._is_blurred else _BLURRED
        self._is_blurred = sharpness < share * min(filter(math.isfinite, self._sharpness), default=0.0)
        return self._is_blurred

    def _compare(self, view: View, up_enu: F64) -> None:
        """Judge by the motion since the view before."""
        tilted_rad = math.acos(min(1.0, float(up_enu @ self._up_enu)))
        is_hard = max(tilted_rad, self._tilted_rad) >= _HARD_RAD  # of either view the pose may be off
        step = self._step(self._before, view)
        if step is not None:
            step = step._replace(is_hard=is_hard)
            view = replace(view, remembered=step.moved.remembered)
        self._before, self._up_enu, self._tilted_rad = view, up_enu, tilted_rad
        self._steps.append(step)
        told = [s for s in [*self._steps][-_STEPS:] if s is not None]
        if step is not None and _is_elsewhere(told):
            self._doubt("shows something else than what lies there", view.time_s)
            return
        steps = [s for s in told if s.moved.alike >= _ALIKE]
        fault = _disagreement(steps)
        if fault is not None:
            self._trusted = None  # it may date from the fault, or look right on a return there
            self._least = fault.least(self._least)
            self._doubt(fault.why, fault.since_s)
        elif self._strange is not None and (self._is_right_again(steps) or self._is_where_it_was(view)):
            self._strange = None
            self._least = None
        self._look_for_dirt(told)

    def _is_right_again(self, steps: Sequence[_Step]) -> bool:
        """Whether the ground followed a change of velocity, and the fault is refuted."""
        self._follows = self._follows or _proves(steps)
        if not self._follows or self._least is None:
            return self._follows
        return _refutes([s for s in self._steps if s is not None and s.moved.alike >= _ALIKE], self._least)

    def _look_for_dirt(self, steps: Sequence[_Step]) -> None:
        """Doubt a lens of which a large part stands still while the rest moves, until it shows ground."""
        over_ground = [s for s in steps if s.moved.moved.mean() >= _MOVING and not s.drift_mps]
        moving = over_ground[-_DIRT_STEPS:]
        if len(moving) < _DIRT_STEPS:
            return
        if self._dirt is not None:
            if (self._dirty & ~_shows_ground([s.moved for s in moving])).mean() < _CLEAN_SHARE:
                self._dirt = None
            return
        self._dirty = _stuck(moving)
        share = self._dirty.mean()
        if share >= _DIRT_SHARE:
            why = f"has something on its lens: {share:.0%} of its picture stands still"
            self._dirt = Doubt(why, moving[0].exposed_s)

    def _doubt(self, why: str, since_s: float) -> None:
        """Start over: new comparisons have to prove the camera right."""
        self._strange = self._strange or Doubt(why, since_s)
        self._follows = False
        self._steps.clear()

    def _step(self, before: View | None, now: View) -> _Step | None:
        """Compare two views; None if that is inconclusive."""
        x, y, z = now.camera.position_enu_m.tolist()
        ground_m = self._obstacles.terrain.height_at_m(x, y)
        height_m = z - ground_m
        if before is None or height_m <= 0.0 or not looks_down(before.lens, before.camera):
            return None
        footprint_m = now.lens.footprint_m(height_m)
        relief = self._relief(np.array([x, y]), ground_m, height_m, footprint_m)
        if relief is None:
            return None
        moved = motion(before, now, ground_m)
        if moved.overlap < _COMMON or moved.textured < _TEXTURED:
            return None
        of_tops_m = min(footprint_m) / (1.0 + relief)
        again = math.hypot(*moved.believed_m) <= (1.0 - _COMMON) * of_tops_m
        off_m = _OFF_M + _OFF_SHARE * height_m
        return _Step(now.time_s, moved, off_m, relief, again, self._drift_mps, height_m)

    def _relief(
        self, xy: F64, ground_m: float, height_m: float, footprint_m: tuple[float, float]
    ) -> float | None:
        """The share by which things in sight may seem faster or slower than the ground right below."""
        corners = xy + 0.5 * np.array(footprint_m) * [[-1, -1], [-1, 1], [1, -1], [1, 1]]
        around_m = self._obstacles.terrain.height_m(corners) - ground_m
        tops_m = self._obstacles.top_within_m(xy[None], 0.5 * math.hypot(*footprint_m)) - ground_m
        top_m = max(0.0, float(around_m.max()), float(tops_m[0]))
        if top_m > _TALLEST * height_m:
            return None
        low_m = max(0.0, -float(around_m.min()))
        return max(top_m / (height_m - top_m), low_m / (height_m + low_m))

    def _is_where_it_was(self, view: View) -> bool:
        """Whether the newest trusted picture shows the same ground, where it should be."""
        step = self._step(self._trusted, view)
        if step is None or step.moved.alike < _ALIKE:
            return False
        return math.hypot(*step.moved.excess_m) <= step.off_m


def _unlit(grey: U8) -> str:
    """The fault of a picture's exposure (H, W); empty if there is none."""
    some = cv2.medianBlur(np.ascontiguousarray(grey[::_SPARSE, ::_SPARSE]), _SPECKS_PX)
    if (some <= _DARK).mean() > _BLIND_SHARE:
        return BLACK
    if (some >= _BRIGHT).mean() > _BLIND_SHARE:
        return WHITE
    return ""


def _is_elsewhere(steps: Sequence[_Step]) -> bool:
    """Whether the pictures do not show what lies there; of what is unsure one comparison is not enough."""
    if not steps[-1].is_strange or not steps[-1].is_unsure:
        return steps[-1].is_strange
    since_a_fit = takewhile(lambda s: s.moved.alike < _ALIKE, reversed(steps))
    return sum(s.is_strange for s in since_a_fit) >= _STRANGE_STEPS_UNSURE


def _disagreement(steps: Sequence[_Step]) -> _Fault | None:
    """How the pictures differ from the estimated way; None: they do not.

    Sums the last step, the last two, three ... A gimbal or an attitude lags in a hard manoeuvre: the worst
    steps of each sum are forgiven, or all of manoeuvres, unless that makes it larger: they were ways back.
    What stands on the ground seems faster along each step, which is across the whole way where that turns.
    """
    if not steps:
        return None
    back = steps[::-1]
    elapsed_s = np.array([s.moved.elapsed_s for s in back])
    off_m = np.array([s.moved.excess_m for s in back])
    way_m = np.array([s.moved.believed_m for s in back])
    off_each_m, way_each_m = np.hypot(*off_m.T), np.hypot(*way_m.T)
    sums_m, calm_m = np.cumsum(off_m, axis=0), off_m * [[not s.is_hard] for s in back]
    each_m = np.stack([sums_m, _forgiving(off_m), np.cumsum(calm_m, axis=0), _forgiving(calm_m)])
    covered_m = np.cumsum(way_m, axis=0)
    ahead = covered_m / np.maximum(np.hypot(*covered_m.T), 1e-6)[:, None]
    along_m = np.abs((each_m * ahead).sum(axis=-1)).min(axis=0)
    across_m = np.abs(each_m[..., 0] * ahead[:, 1] - each_m[..., 1] * ahead[:, 0]).min(axis=0)
    flown_m, lasted_s = np.cumsum(way_each_m), np.cumsum(elapsed_s)
    allowed_m = np.array([s.off_m for s in back])
    explained_m = allowed_m.max() + (_OFF_MPS + back[0].drift_mps) * lasted_s
    relief = np.array([s.relief for s in back])
    relief_each_m = way_each_m * relief
    relief_m = np.cumsum(relief_each_m)
    way_across_m = np.abs(np.outer(ahead[:, 0], way_m[:, 1]) - np.outer(ahead[:, 1], way_m[:, 0]))
    relief_across_m = (np.tril(way_across_m) * relief).sum(axis=1)
    false = across_m > explained_m + _ACROSS * flown_m + relief_across_m
    false |= along_m > explained_m + _ALONG * flown_m + relief_m
    tells_alone = np.array([s.tells_alone for s in back])
    jump_m = np.array([s.jump_m for s in back])
    false |= (off_each_m > jump_m + relief_each_m) & tells_alone
    if not false.any():
        return None
    k = int(np.argmax(false))
    off_mps, believed_mps = sums_m[k] / lasted_s[k], covered_m[k] / lasted_s[k]
    seen_mps = believed_mps + off_mps
    return _Fault(
        f"sees the ground pass at {_velocity(seen_mps)}, not at {_velocity(believed_mps)}: "
        "height, position, heading or the pictures' dates are wrong",
        back[k].exposed_s,
        math.hypot(*off_mps) / max(math.hypot(*believed_mps), 1e-6),
        math.hypot(*off_mps),
    )


def _forgiving(off_m: F64) -> F64:
    """The sums (N, 2) of the first, the first two, three ... without the worst of each."""
    worst = [np.argsort(np.hypot(*off_m[: k + 1].T))[-_FORGIVEN:] for k in range(len(off_m))]
    return np.asarray(np.cumsum(off_m, axis=0) - [off_m[of].sum(axis=0) for of in worst])


def _velocity(of_camera_mps: F64) -> str:
    heading_deg = round(math.degrees(math.atan2(*of_camera_mps))) % 360
    return f"{math.hypot(*of_camera_mps):.1f} m/s to {heading_deg} degrees"


def _proves(steps: Sequence[_Step]) -> bool:
    """Whether the estimated velocity changed and the ground followed; in late pictures it does not."""
    before = [s.moved.believed_mps for s in steps if s.exposed_s <= steps[-1].exposed_s - _PROOF_S]
    off_m = _adds_up_m([s.moved.excess_m for s in steps])
    if not before or off_m.max() > steps[-1].off_m:  # the sum alone would cancel there and back
        return False
    return bool(np.hypot(*(np.array(before) - before[-1]).T).max() >= _CHANGE_MPS)


def _refutes(steps: Sequence[_Step], fault: _Fault) -> bool:
    """Whether the ground moved as estimated over a way on which the fault would have been plain."""
    if not steps:
        return False
    explained_m = steps[-1].off_m
    right = np.maximum.accumulate(_adds_up_m([s.moved.excess_m for s in steps])) <= explained_m
    covered_m = _adds_up_m([s.moved.believed_m for s in steps])
    lasted_s = np.cumsum([s.moved.elapsed_s for s in reversed(steps)])
    expected_m = np.minimum(fault.off_per_m * covered_m, fault.off_mps * lasted_s)
    return bool((right & (expected_m >= _PLAIN * explained_m)).any())


def _adds_up_m(steps_m: Sequence[F64]) -> F64:
    """(N,) lengths of the sums of the last step, the last two, three ..."""
    return np.asarray(np.hypot(*np.cumsum(steps_m[::-1], axis=0).reshape(-1, 2).T))


def _stuck(steps: Sequence[_Step]) -> Mask:
    """CELLS of the largest connected part of the picture that nearly always stood still instead of moving.

    Where the ground is rough, a plain roof may move in front of texture: only what shows something stands.
    """
    moved = np.sum([s.moved.moved & s.moved.tells for s in steps], axis=0)
    stood = [s.moved.moved & ~s.moved.followed & _stands(s) for s in steps]
    stuck = (moved >= len(steps) // 2) & (np.sum(stood, axis=0) >= _NEARLY_ALWAYS * moved)
    _, parts, sizes, _ = cv2.connectedComponentsWithStats(stuck.astype(np.uint8), connectivity=4)
    sizes[0, cv2.CC_STAT_AREA] = 0
    return np.asarray(stuck & (parts == sizes[:, cv2.CC_STAT_AREA].argmax()))


def _stands(step: _Step) -> Mask:
    return step.moved.same if step.is_rough else step.moved.still


def _shows_ground(motions: Sequence[GroundMotion]) -> Mask:
    """CELLS that in half of the pictures show something that has moved."""
    moved = np.sum([m.moved & (m.followed | (m.tells & ~m.still)) for m in motions], axis=0)
    return np.asarray(moved >= len(motions) / 2)
