"""The small immutable values that flow through a mission, and the Protocols of its four parts.

Data flows one way: sense -> track -> decide -> fly. Arrays are float64 and never written to after they
were handed on. Frames: ENU metres; body FLU; camera optical (x right, y down, z forward).

What is made at every step is a named tuple: those are made four times as fast as frozen dataclasses.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np

from skysweep.arrays import F64 as F64
from skysweep.arrays import U8 as U8
from skysweep.errors import DetectorError
from skysweep.geometry.camera import CameraMotion, CameraPose, Lens, project, rays_enu

XY = tuple[float, float]


class _Word(str, Enum):
    """Written as its value, whatever the version of Python."""

    def __str__(self) -> str:
        return str(self.value)

    def __format__(self, format_spec: str) -> str:
        return format(str(self.value), format_spec)


class Mode(_Word):
    """What a mission is doing."""

    TAKEOFF = "TAKEOFF"
    SCAN = "SCAN"  # covers the area from high up
    CHECK = "CHECK"  # comes down to look at candidates
    LOOK = "LOOK"  # flies to, or hovers at, a place that the operator asked for
    TRANSIT = "TRANSIT"  # flies back, with another battery, to where the search was left
    HOLD = "HOLD"  # or is flown by somebody else
    RETURN = "RETURN"
    LAND = "LAND"
    SWAP = "SWAP"  # stands at home while its battery is changed


SEARCHING = (Mode.SCAN, Mode.CHECK)  # the modes of a strategy: names, on which nothing depends that is flown


class EventKind(_Word):
    """What a strategy decides, as the journal says it."""

    SCANNED = "scanned"
    REASSESSED = "reassessed"  # its probability has moved
    MISFIT = "misfit"  # what is seen differs from what the strategy's model says
    CHECK_STARTED = "check_started"
    CONFIRMED = "confirmed"
    REJECTED = "rejected"
    UNCHECKED = "unchecked"
    SCAN_RESUMED = "scan_resumed"
    LOOKS_AGAIN = "looks_again"  # at ground that was searched too weakly
    WAYPOINT_REACHED = "waypoint_reached"
    FINISHED = "finished"


SETTLING = (EventKind.CONFIRMED, EventKind.REJECTED, EventKind.UNCHECKED)  # what becomes of a candidate
NO_VERDICTS: Mapping[int, EventKind] = MappingProxyType({})


class VehicleState(NamedTuple):
    """What the vehicle believes about itself (its estimator's output, not the truth)."""

    time_s: float
    position_enu_m: F64  # (3,)
    velocity_enu_mps: F64  # (3,)
    R_body_to_enu: F64  # (3, 3) FLU -> ENU
    camera: CameraPose  # where the vehicle believes its camera is and looks, now
    battery_remaining: float  # 0..1; NaN: the vehicle does not say
    energy_used_wh: float
    airborne: bool
    position_std_m: float = 0.0  # horizontal, 1 sigma, that the estimator claims; inf: no position
    silent_s: float = 0.0  # since telemetry was last heard
    wind_enu_mps: F64 | None = None  # (3,) estimated mean wind; None: unknown
    taken_over: str = ""  # why somebody else flies it now, in words; empty: nobody does
    ground_below_m: float | None = None  # measured straight down, by a rangefinder; None: it measures nothing
    waits: str = ""  # why it hovers until a person says continue, in a sentence, though nobody flies it


class Setpoint(NamedTuple):
    """Where to go: PX4 offboard semantics (position plus optional velocity feed-forward).

    ``speed_mps`` limits the horizontal speed; vertical limits are the vehicle's own. A vehicle that cannot
    point its camera ignores ``gimbal_pitch_rad`` and keeps reporting where the camera does look.
    """

    position_enu_m: F64  # (3,)
    speed_mps: float
    yaw_rad: float  # ENU: 0 = east, counter-clockwise
    velocity_enu_mps: F64 | None = None  # (3,) feed-forward, for moving setpoints
    gimbal_pitch_rad: float | None = None  # of the camera above the horizon; None: as it is


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture and what the mission believes about it."""

    time_s: float  # of exposure
    image: U8  # (H, W, 3) RGB
    camera: CameraPose  # believed, not true
    lens: Lens


class Doubt(NamedTuple):
    """Why a picture is not trusted to show what lies before the camera."""

    why: str  # what the camera does, in words
    since_s: float  # exposure of the first look that is not trusted


@dataclass(frozen=True, slots=True)
class Detections:
    """Boxes found in one frame, in pixels, with the camera pose that the mission believes.

    Pixel coordinates: (0, 0) is the top left corner of the top left pixel.
    """

    time_s: float  # of exposure
    boxes_xyxy_px: F64  # (N, 4)
    confidences: F64  # (N,) 0..1
    class_names: tuple[str, ...]  # (N,)
    camera: CameraPose  # believed, at exposure
    lens: Lens
    doubt: Doubt | None = None  # of the picture: then this is no look at what is there

    def __len__(self) -> int:
        return len(self.confidences)


@dataclass(frozen=True, slots=True)
class Answer:
    """What the detector said to one picture, without the pose, which a mission knows."""

    boxes_xyxy_px: F64  # (N, 4)
    confidences: F64  # (N,)
    class_names: tuple[str, ...]  # (N,)
    failure: str | None = None  # instead of an answer
    doubt: Doubt | None = None  # of the picture

    def to(self, frame: Frame) -> Detections:
        """The detections of ``frame``. Raises DetectorError where there was no answer."""
        if self.failure is not None:
            raise DetectorError(self.failure)
        return Detections(
            frame.time_s,
            self.boxes_xyxy_px,
            self.confidences,
            self.class_names,
            frame.camera,
            frame.lens,
            self.doubt,
        )


class Candidate(NamedTuple):
    """A possible target on the ground, merged from sightings."""

    id: int
    class_name: str
    position_enu_m: F64  # (3,)
    covariance_m2: F64  # (2, 2) horizontal
    first_seen_s: float
    last_seen_s: float
    confidences: tuple[float, ...]  # of every sighting, oldest first


class Sighting(NamedTuple):
    """One detection on the ground, assigned to a candidate."""

    candidate_id: int
    is_new: bool  # this sighting opened the candidate
    time_s: float  # of exposure
    position_enu_m: F64  # (3,) of this sighting alone
    confidence: float
    camera_altitude_agl_m: float  # believed height of the camera above the sighting at exposure
    box_xyxy_px: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    is_cut: bool = False  # the box reaches an edge of the picture, so that the object may reach beyond it


class Look(NamedTuple):
    """One picture that was answered: from where it was taken, and what was found in it."""

    time_s: float  # of exposure
    camera: CameraPose  # believed, at exposure
    lens: Lens
    hits: tuple[Sighting, ...] = ()

    def footprint_enu_m(self, ground_m: float) -> F64:
        """Corners (4, 3) of the picture on level ground, in order around it; NaN where a corner sees none."""
        u, v = self.lens.width_px, self.lens.height_px
        rays = rays_enu(self.lens, self.camera, [(0, 0), (u, 0), (u, v), (0, v)])
        drop = np.where(rays[:, 2] < -1e-6, rays[:, 2], np.nan)
        eye = self.camera.position_enu_m
        return np.asarray(eye + rays * ((ground_m - eye[2]) / drop)[:, None])

    def misses(self, candidates: Mapping[int, Candidate]) -> tuple[int, ...]:
        """Candidates whose place lies in the picture, and that were not found in it."""
        found = {hit.candidate_id for hit in self.hits}
        others = [c for k, c in candidates.items() if k not in found]
        if not others:
            return ()
        uv, depth = project(self.lens, self.camera, [c.position_enu_m for c in others])
        inside = (uv >= 0.0).all(axis=1) & (uv <= (self.lens.width_px, self.lens.height_px)).all(axis=1)
        return tuple(c.id for c, seen in zip(others, inside & (depth > 0.0), strict=True) if seen)


class Observation(NamedTuple):
    """Everything a strategy may know at one step. ``time_s`` is the vehicle's."""

    vehicle: VehicleState
    altitude_agl_m: float  # believed
    looks: tuple[Look, ...]  # answered since the last step, oldest first
    candidates: dict[int, Candidate]  # all that the tracker keeps, by id
    unsearched: tuple[tuple[XY, XY], ...] = ()  # legs that turned out, since then, to be flown blind
    refused: str = ""  # why the waypoint of the last command is not flown to; do not ask for it again
    lookout: Waypoint | None = None  # where that waypoint is looked at from, where not from itself
    verdicts: Mapping[int, EventKind] = NO_VERDICTS  # the operator's, by candidate: CONFIRMED or REJECTED
    elsewhere: bool = False  # the vehicle was sent away since the last step, and looks may be from there

    @property
    def time_s(self) -> float:
        """The vehicle's time."""
        return self.vehicle.time_s

    @property
    def sightings(self) -> tuple[Sighting, ...]:
        """The hits of all looks."""
        return tuple(hit for look in self.looks for hit in look.hits)


@dataclass(frozen=True, slots=True)
class Event:
    """Something the strategy decided, for the journal."""

    kind: EventKind
    candidate_id: int | None = None
    position_enu_m: tuple[float, float, float] | None = None
    probability: float | None = None  # that the candidate is a target, as the strategy believes
    reason: str = ""  # in words
    alternatives: tuple[tuple[str, float], ...] = ()  # what could be decided, cheapest first; cost in seconds


class Waypoint(NamedTuple):
    """Where a strategy wants to be: above the ground, because terrain is the loop's business."""

    xy_enu_m: XY
    altitude_agl_m: float
    speed_mps: float  # horizontal
    to_look: bool = False  # flown to for what is seen there: the vehicle may be sent beside it or higher
    then_xy_enu_m: XY | None = None  # flown through, towards this place; None: the vehicle stops there
    yaw_rad: float | None = None  # ENU; None: that of the plan
    gimbal_pitch_rad: float | None = None  # of the camera above the horizon; None: that of the scenario


class Command(NamedTuple):
    """A strategy's answer. ``waypoint`` is None when the search is over."""

    mode: Mode  # SCAN or CHECK
    waypoint: Waypoint | None
    events: tuple[Event, ...] = ()


class Truth(Protocol):
    """What a simulation knows of its vehicle at this moment: for simulated sensors and results alone."""

    @property
    def true_position_enu_m(self) -> F64:
        """(3,) of the body origin."""

    def true_camera_pose(self) -> CameraPose:
        """Where the camera really is and looks."""

    def true_camera_motion(self) -> CameraMotion:
        """How the camera really moves."""


class Vehicle(Protocol):
    """Flies. Time is its own: nothing in a mission reads a wall clock.

    ``truth`` is of a vehicle that is simulated in this process; None of every other. A simulated vehicle may
    also have ``change_battery()``, which puts in a full one on the ground. Every other one waits there until
    the operator says that its battery was changed. One that somebody else may fly has ``regain(holder)``: the
    operator takes it back from whom ``taken_over`` named, or from anybody (None). It says why not, or ''.
    """

    truth: Truth | None

    def state(self) -> VehicleState:
        """What the vehicle believes of itself now."""

    def command(self, setpoint: Setpoint) -> None:
        """Fly towards a setpoint from now on."""

    def advance(self, duration_s: float) -> None:
        """Let this much of its time pass."""

    def takeoff(self, altitude_agl_m: float) -> None:
        """Climb straight up to this height above the ground below, and wait there."""

    def land(self) -> None:
        """Descend here until it stands."""

    def hold(self) -> None:
        """Stop and stay here until the next command. Called whenever our side ends early."""


class Sensor(Protocol):
    """Looks. To be shown every state of the mission, in their order."""

    def sense(self, state: VehicleState) -> Detections | None:
        """The newest finished look, or None when there is nothing new."""

    def close(self) -> None:
        """Let go of what it holds; it is not asked again."""


class LookPeriod(Protocol):
    """How often a sensor looks: every ``period_s``, which is ``usual_period_s`` where it can keep that."""

    usual_period_s: float
    period_s: float


class PictureSensor(Sensor, Protocol):
    """A sensor whose looks are pictures: what a detector said to them is taken down in flight.

    ``last_look`` is the newest frame that was answered, with the answer.
    """

    camera: Camera
    last_look: tuple[Frame, Detections] | None

    def recall(self, answers: Iterable[Answer]) -> None:
        """Give these answers to the first pictures, as in an earlier flight, and do not ask the detector."""


class Camera(Protocol):
    """Takes pictures. ``renderer`` draws them where they show the scenario's world; None: they do not."""

    renderer: str | None

    def capture(self, state: VehicleState) -> Frame:
        """The picture of this moment, with the pose that the mission believes."""

    def close(self) -> None:
        """Let go of what it holds; it is not asked again."""


class Detector(Protocol):
    """Finds boxes in pictures. ``class_names`` are all that it may report."""

    class_names: tuple[str, ...]

    def detect(self, frame: Frame) -> Detections:
        """Boxes in the frame's pixels, with its time, pose and lens. Raises UserError where it cannot."""


class Tracker(Protocol):
    """Puts detections on the ground and keeps one candidate per thing seen. Its state is plain data."""

    def update(self, detections: Detections) -> tuple[Sighting, ...]:
        """The sightings of one look, each assigned to a candidate."""

    def candidates(self) -> dict[int, Candidate]:
        """All that it keeps, by id."""

    def snapshot(self) -> dict[str, Any]:
        """Its state, as JSON holds it."""

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a state that ``snapshot`` gave."""


class Strategy(Protocol):
    """Decides. Pure: no I/O, no clock, no truth. Its state is plain data, so a mission can resume."""

    def step(self, observation: Observation) -> Command:
        """Where to fly now, and what was decided since the last step."""

    def snapshot(self) -> dict[str, Any]:
        """Its state, as JSON holds it."""

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a state that ``snapshot`` gave."""
