"""One frame of a video: 3-D view, map and detector's view, figures, altitude profile and the last events."""

from __future__ import annotations

from contextlib import ExitStack
from typing import NamedTuple

import numpy as np

from skysweep.arrays import F64, U8
from skysweep.results.reporting.wording import clock
from skysweep.results.video import pen
from skysweep.results.video.chart import Chart
from skysweep.results.video.chase import Chase
from skysweep.results.video.eye import Eye
from skysweep.results.video.pen import Label, rgb
from skysweep.results.video.story import Moment, Story, mode_colour
from skysweep.ros.targets import KnownTarget
from skysweep.types import EventKind
from skysweep.worlds.rendering.renderer import Backend, make_renderer

SMALLEST_PX = (320, 180)

_DESIGNED_PX = (1280, 720)  # the size that all lengths below are for
_INK, _SOFT, _TINT, _LINE = rgb("#1d2327"), rgb("#5b6670"), rgb("#f5f7f8"), rgb("#dde2e6")  # as in reports
_WHITE = rgb("white")
_FIGURES = 7
_EVENTS = 3  # last ones, shown
_FRESH_S = 2.5  # of the video, that an event stands out


class Room(NamedTuple):
    """A part of the frame, in pixels."""

    left: int
    top: int
    width: int
    height: int

    def show(self, frame: U8, picture: U8, labels: list[Label], title: str, scale: float) -> list[Label]:
        """Put a picture into its middle, and return its labels, moved there, with its title."""
        height, width = picture.shape[:2]
        chip = Label(
            12 * scale, 10 * scale, title, 11 * scale, _WHITE, "la", chip=True, most_px=width - 24 * scale
        )
        left, top = self.left + (self.width - width) // 2, self.top + (self.height - height) // 2
        frame[top : top + height, left : left + width] = picture
        return [label._replace(x_px=label.x_px + left, y_px=label.y_px + top) for label in (*labels, chip)]


class Layout(NamedTuple):
    """Where everything is in a frame."""

    scene: Room
    map: Room
    view: Room
    tiles: tuple[Room, ...]  # of the figures
    profile: Room
    events: Room

    @classmethod
    def of(cls, width: int, height: int) -> Layout:
        scale = scale_of(width, height)
        margin, gap, tile_height = round(16 * scale), round(12 * scale), round(58 * scale)
        top, low = round(48 * scale), height - round(162 * scale)
        side = round(0.345 * width)
        wide = width - 2 * margin - gap - side
        right, upper = margin + wide + gap, (low - top - gap) * 53 // 100
        tile = (width - 2 * margin - (_FIGURES - 1) * gap) // _FIGURES
        rest = low + gap + tile_height + gap
        last = height - rest - round(14 * scale)
        return cls(
            scene=Room(margin, top, wide, low - top),
            map=Room(right, top, side, upper),
            view=Room(right, top + upper + gap, side, low - top - upper - gap),
            tiles=tuple(
                Room(margin + k * (tile + gap), low + gap, tile, tile_height) for k in range(_FIGURES)
            ),
            profile=Room(margin, rest, wide, last),
            events=Room(right, rest, side, last),
        )


def scale_of(width_px: int, height_px: int) -> float:
    """Of all lengths and letters, in a frame of this size."""
    return min(width_px / _DESIGNED_PX[0], height_px / _DESIGNED_PX[1])


class Page:
    """Draws the frames of a story, whose moments must come in their order. Close it at the end.

    Raises UserError if no renderer runs here.
    """

    def __init__(self, story: Story, width_px: int, height_px: int, renderer: Backend = "auto") -> None:
        self._story, self._width_px = story, width_px
        self._scale = scale_of(width_px, height_px)
        self._layout = layout = Layout.of(width_px, height_px)
        with ExitStack() as stack:
            painters = [make_renderer(story.run.world, renderer) for _ in range(2)]
            for painter in painters:
                stack.callback(painter.close)
            self._chase = Chase(story, painters[0], layout.scene.width, layout.scene.height)
            self._eye = Eye(story, painters[1], layout.view.width, layout.view.height)
            self._chart = Chart(story, layout.map.width, layout.map.height, renderer)
            self._close = stack.pop_all().close
        self._blank = np.full((height_px, width_px, 3), 255, np.uint8)
        for room in (layout.view, *layout.tiles):
            self._fill(room)
        self._profile_ahead, self._profile_flown = self._profiles()

    def close(self) -> None:
        self._close()

    def draw(self, moment: Moment) -> U8:
        """The frame (H, W, 3) RGB of a moment."""
        frame, scale = self._blank.copy(), self._scale
        targets = self._story.targets(moment.time_s)
        labels = self._layout.scene.show(frame, *self._chase.draw(moment, scale), "3-D view", scale)
        labels += self._layout.map.show(frame, *self._chart.draw(moment, scale), "Map", scale)
        labels += self._layout.view.show(frame, *self._eye.draw(moment, scale), scale)
        labels += self._titles() + self._figures(moment, targets) + self._events(moment)
        self._draw_profile(frame, moment)
        return pen.write(frame, labels)

    def _fill(self, room: Room) -> None:
        self._blank[room.top : room.top + room.height, room.left : room.left + room.width] = _TINT

    def _titles(self) -> list[Label]:
        run, scale, y = self._story.run, self._scale, 31 * self._scale
        search = run.scenario.search
        n_c = f"{search.n_c:g}".replace("inf", "∞")
        how = f", n_c = {n_c}" if run.strategy == "scan-check" else ""
        title = f"{run.scenario.name}: {run.strategy}{how}, seed {run.seed}"
        speed = f"{self._story.speed:g} × the speed of the flight"
        right = self._width_px - 16 * scale
        return [
            Label(16 * scale, y, title, 17 * scale, _INK, "ls", bold=True, most_px=0.7 * self._width_px),
            Label(right, y, speed, 12 * scale, _SOFT, "rs"),
        ]

    def _figures(self, moment: Moment, targets: tuple[KnownTarget, ...]) -> list[Label]:
        standing = [target.standing for target in targets]
        n_confirmed, n_rejected = standing.count(EventKind.CONFIRMED), standing.count(EventKind.REJECTED)
        listed = n_confirmed + n_rejected + standing.count(EventKind.SCANNED)
        battery = "–" if np.isnan(moment.battery) else f"{moment.battery:.0%}"
        figures = {
            "Time": clock(moment.time_s),
            "Mode": moment.mode,
            "Above ground": f"{max(moment.altitude_agl_m, 0.0):.1f} m",
            "Battery": battery,
            "Area seen": f"{self._chart.seen_share:.0%}",
            "Candidates listed": f"{listed}",
            "Confirmed, rejected": f"{n_confirmed}, {n_rejected}",
        }
        labels, scale = [], self._scale
        for room, (name, value) in zip(self._layout.tiles, figures.items(), strict=True):
            x, y = room.left + 12 * scale, room.top
            colour = mode_colour(moment.mode) if name == "Mode" else _INK
            labels.append(Label(x, y + 31 * scale, value, 20 * scale, colour, "ls", bold=True))
            labels.append(Label(x, y + 48 * scale, name, 11 * scale, _SOFT, "ls"))
        return labels

    def _events(self, moment: Moment) -> list[Label]:
        scale, room = self._scale, self._layout.events
        labels = []
        for k, (time_s, words) in enumerate(reversed(self._story.happened(moment.time_s)[-_EVENTS:])):
            y = room.top + (k + 0.5) * room.height / _EVENTS
            fresh = moment.time_s - time_s < _FRESH_S * self._story.speed
            colour, size = (_INK if fresh else _SOFT), 13 * scale
            labels.append(Label(room.left + 34 * scale, y, clock(time_s), size, _SOFT, "rm"))
            x = room.left + 44 * scale
            most_px = room.width - 44 * scale
            labels.append(Label(x, y, words, size, colour, "lm", bold=fresh and k == 0, most_px=most_px))
        return labels

    def _profiles(self) -> tuple[U8, U8]:
        """The altitude over the mission: still to come, pale, and flown, in the colours of the modes."""
        room, story, scale = self._layout.profile, self._story, self._scale
        pale = np.full((room.height, room.width, 3), 255, np.uint8)
        points = np.column_stack([self._profile_x(story.states_s), self._profile_y(story)])
        pen.line(pale, np.array([[0, room.height - 1], [room.width, room.height - 1]]), _LINE, 1.0)
        flown = pale.copy()
        pen.line(pale, points, _LINE, 2.0 * scale)
        for k, mode in enumerate(story.flown_modes[1:]):
            pen.line(flown, points[k : k + 2], mode_colour(mode), 2.0 * scale)
        return pale, flown

    def _draw_profile(self, frame: U8, moment: Moment) -> None:
        room = self._layout.profile
        x = int(np.clip(self._profile_x(np.array([moment.time_s]))[0], 0, room.width - 1))
        part = frame[room.top : room.top + room.height, room.left : room.left + room.width]
        part[:, :x], part[:, x:] = self._profile_flown[:, :x], self._profile_ahead[:, x:]
        part[:, x : x + max(1, round(self._scale))] = _INK

    def _profile_x(self, times_s: F64) -> F64:
        span_s = max(float(self._story.states_s[-1]), 1.0)
        return np.asarray(times_s * ((self._layout.profile.width - 1) / span_s))

    def _profile_y(self, story: Story) -> F64:
        flown = story.flown_enu_m
        height = flown[:, 2] - story.run.world.terrain.height_m(flown[:, :2])
        most = max(float(height.max()), 1.0)
        return np.asarray(
            self._layout.profile.height - 2 - (self._layout.profile.height - 6) * np.maximum(height, 0) / most
        )
