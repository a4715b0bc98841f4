"""A mission at the moments that a video shows, interpolated between the lines of its journal."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from skysweep.arrays import F64
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, rays_enu
from skysweep.mission.notes import NEXT_SORTIE, SORTIE
from skysweep.results.reporting.style import BLUE, GREY, ORANGE, VERMILLION
from skysweep.results.reporting.wording import is_said, safety_words, sortie_words
from skysweep.results.run_folder import Run
from skysweep.results.video.pen import Rgb, rgb
from skysweep.ros.targets import RGBA, KnownTarget, TargetBoard
from skysweep.text import printable
from skysweep.types import EventKind, Mode

_MODE_COLOURS: dict[str, str] = {Mode.SCAN: BLUE, Mode.CHECK: VERMILLION, Mode.HOLD: ORANGE}
STANDING_COLOURS = RGBA | {EventKind.REJECTED: "0.85"}  # its own colour is that of a check's path

_LINGER_S = 2.0  # of the video, on the last moment
_TURNS_S = 0.8  # of the video, that a view takes to turn after the vehicle
_HOVERS_MPS = 0.5
_LOW_M = 1.0  # a picture from lower shows nothing of the ground
_FLATTEST = -0.05  # vertical part of a unit ray that still meets the ground nearby


def mode_colour(mode: str) -> Rgb:
    """The colour of a path flown in a mode."""
    return rgb(_MODE_COLOURS.get(mode, GREY))


@dataclass(frozen=True, slots=True)
class Moment:
    """What a frame shows. Times count from the take-off command."""

    index: int
    time_s: float
    position_enu_m: F64  # (3,)
    altitude_agl_m: float
    heading_rad: float  # ENU, of the smoothed motion
    camera: CameraPose  # believed
    mode: str
    battery: float
    n_states: int  # of the journal, so far


class Story:
    """The moments of a run, ``speed`` times as fast as it flew, at ``fps`` frames a second.

    Raises UserError for a mission without a state of the vehicle.
    """

    def __init__(self, run: Run, speed: float, fps: int) -> None:
        self.run, self.speed, self.fps = run, speed, fps
        if len(run.states) == 0:
            raise UserError(f"{run.folder}: its journal has no position of the vehicle yet; try again later")
        self._states_s, self._kept = np.unique(run.states.time_s, return_index=True)
        end_s = max(float(self._states_s[-1]), run.last_s)
        flown_s = np.arange(self._states_s[0], end_s, speed / fps)
        self.times_s = np.append(flown_s, [end_s] * (1 + round(_LINGER_S * fps)))

    def __len__(self) -> int:
        return len(self.times_s)

    def moment(self, k: int) -> Moment:
        time_s = float(self.times_s[k])
        state = max(int(np.searchsorted(self._states_s, time_s, side="right")) - 1, 0)
        row = int(self._kept[state])
        states = self.run.states
        return Moment(
            k,
            time_s,
            self._positions_enu_m[k],
            float(self._altitudes_m[k]),
            float(self._headings_rad[k]),
            self.camera(time_s),
            states.mode[row],
            float(states.battery[row]),
            state + 1,
        )

    def camera(self, time_s: float) -> CameraPose:
        """The believed pose of the camera at any time."""
        inside = float(self._inside(time_s))
        return CameraPose(self._camera_track(inside), self._attitudes(inside))

    def footprint_enu_m(self, moment: Moment) -> F64 | None:
        """Corners (4, 2) of the camera's picture on level ground; None where it shows the horizon."""
        lens = self.run.scenario.camera.lens
        rays = rays_enu(lens, moment.camera, lens.corners_px[[0, 1, 3, 2]])
        if moment.altitude_agl_m < _LOW_M or rays[:, 2].max() > _FLATTEST:
            return None
        reach = moment.altitude_agl_m / -rays[:, 2:]
        return np.asarray((moment.camera.position_enu_m + rays * reach)[:, :2])

    @property
    def flown_enu_m(self) -> F64:
        """(S, 3) positions of the states, oldest first; a moment has seen its first ``n_states``."""
        return self.run.states.position_enu_m[self._kept]

    @property
    def flown_modes(self) -> list[str]:
        """(S,) modes of the same."""
        return [self.run.states.mode[k] for k in self._kept.tolist()]

    @property
    def states_s(self) -> F64:
        """(S,) times of the same."""
        return self._states_s

    def targets(self, time_s: float) -> tuple[KnownTarget, ...]:
        """Candidates known by then. Times must not decrease from call to call."""
        records, board = self._of_candidates
        while records and self.run.since_start(records[-1]) <= time_s:
            board.note(records.pop())
        return tuple(board.targets.values())

    def happened(self, time_s: float) -> list[tuple[float, str]]:
        """Time and words of all events so far, oldest first."""
        return self._told[: bisect_right(self._told, time_s, key=lambda told: told[0])]

    def _inside(self, times_s: ArrayLike) -> F64:
        """The same times, within those of the states."""
        return np.clip(times_s, self._states_s[0], self._states_s[-1])

    @cached_property
    def _of_candidates(self) -> tuple[list[Mapping[str, Any]], TargetBoard]:
        return sorted(self.run.records, key=self.run.since_start, reverse=True), TargetBoard()

    @cached_property
    def _told(self) -> list[tuple[float, str]]:
        told = [(self.run.since_start(r), words) for r in self.run.records if (words := event_words(r))]
        if not self.run.ended:
            told.append((self.run.last_s, "The journal ends here: broken off, or still flying"))
        return sorted(told, key=lambda event: event[0])

    @cached_property
    def _positions_enu_m(self) -> F64:
        return np.asarray(_track(self._states_s, self.flown_enu_m)(self._inside(self.times_s)))

    @cached_property
    def _altitudes_m(self) -> F64:
        position = self._positions_enu_m
        return np.asarray(position[:, 2] - self.run.world.terrain.height_m(position[:, :2]))

    @cached_property
    def _camera_track(self) -> Any:
        return _track(self._states_s, self.run.states.camera_position_enu_m[self._kept])

    @cached_property
    def _attitudes(self) -> Any:
        matrices = self.run.states.R_camera_to_enu[self._kept]
        if len(matrices) == 1:
            return lambda _time_s: matrices[0]
        turns = Slerp(self._states_s, Rotation.from_matrix(matrices))
        return lambda time_s: turns(time_s).as_matrix()

    @cached_property
    def _headings_rad(self) -> F64:
        """The direction of flight, as a view follows it: smoothly, and never while the vehicle hovers."""
        if len(self) == 1:
            return np.zeros(1)
        velocity = np.gradient(self._positions_enu_m[:, :2], self.speed / self.fps, axis=0)
        pace = np.hypot(*velocity.T)
        moving = pace > _HOVERS_MPS
        towards = velocity[int(np.argmax(moving))] if moving.any() else np.array([1.0, 0.0])
        follows = 1.0 - np.exp(-1.0 / (self.fps * _TURNS_S))
        headings = np.empty(len(self))
        heading = float(np.arctan2(towards[1], towards[0]))
        for k in range(len(self)):
            if moving[k]:
                turn = float(np.arctan2(velocity[k, 1], velocity[k, 0])) - heading
                heading += follows * float(np.arctan2(np.sin(turn), np.cos(turn)))
            headings[k] = heading
        return headings


def _track(times_s: F64, points: F64) -> Any:
    """Points (N, 3) as a smooth function of time that does not overshoot."""
    if len(times_s) == 1:
        return lambda t: np.broadcast_to(points[0], (*np.shape(t), 3))
    return PchipInterpolator(times_s, points)


def event_words(record: Mapping[str, Any]) -> str:
    """A line of the journal in words, or nothing if it is no event to show."""
    kind, who = record["kind"], f"candidate {record.get('candidate')}"
    if is_said(record):
        return printable(safety_words(record))
    if kind in (SORTIE, NEXT_SORTIE):
        return sortie_words(record)
    what = printable(str(record.get("class_name", "")))
    words = {
        "start": "Take-off",
        EventKind.SCANNED: f"{who.capitalize()} listed" + (f": {what}" if what else ""),
        EventKind.CHECK_STARTED: f"Going down to check {who}" if record.get("candidate") is not None else "",
        EventKind.CONFIRMED: f"{who.capitalize()} confirmed",
        EventKind.REJECTED: f"{who.capitalize()} rejected",
        EventKind.UNCHECKED: f"{who.capitalize()} left unchecked",
        EventKind.SCAN_RESUMED: "Check finished",
        EventKind.FINISHED: "Search finished",
        "landed": "Landed",
        "end": f"Mission ended: {printable(str(record.get('reason')))}",
        "resumed": "Mission resumed",
        "operator": f"Operator: {printable(str(record.get('word')))}",
    }
    return words.get(kind, "")
