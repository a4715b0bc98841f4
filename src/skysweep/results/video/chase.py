"""The 3-D view: the scenario as its renderer draws it, from behind and above the vehicle."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import shapely
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from skysweep.arrays import F64, U8
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.results.reporting.style import ORANGE
from skysweep.results.video import pen
from skysweep.results.video.pen import Label, Rgb, rgb
from skysweep.results.video.story import STANDING_COLOURS, Moment, Story, mode_colour
from skysweep.worlds.obstacles import Obstacles
from skysweep.worlds.rendering.renderer import Painter

_HFOV_RAD = 1.1
_NEAR_M = 0.5
_NEAREST_M, _AWAY = 12.5, 1.3  # distance from the vehicle on the ground, and more for each metre of height
_ELEVATIONS_RAD = tuple(np.radians([17.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 85.0]).tolist())
_RISES_S = 0.6  # of the video, before and after something that is in the way
_BORDER_STEP_M = 4.0  # a border follows the ground in such steps
_TRAIL = 240  # states
_WHITE, _DARK = rgb("white"), rgb("0.12")
_VEHICLE_PX = 46.0  # of its arms, on a view 800 pixels wide: drawn larger than life
_ARMS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]) / np.sqrt(2.0)
_ROUND = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
_CIRCLE = np.column_stack([np.cos(_ROUND), np.sin(_ROUND)])


class Chase:
    """Draws the view; ``painter`` belongs to it alone, so that its shadows are kept from frame to frame."""

    def __init__(self, story: Story, painter: Painter, width_px: int, height_px: int) -> None:
        self._story, self._painter = story, painter
        self._lens = Lens(width_px, height_px, _HFOV_RAD)
        self._terrain = story.run.world.terrain
        area = shapely.segmentize(story.run.scenario.area_enu_m, _BORDER_STEP_M)
        self._borders = [self._on_ground(np.array(r.coords)) for r in (area.exterior, *area.interiors)]
        self._elevation_rad = self._elevations()
        self._flown = story.flown_enu_m
        self._colours = [mode_colour(mode) for mode in story.flown_modes]

    def draw(self, moment: Moment, scale: float) -> tuple[U8, list[Label]]:
        """The view and its labels; ``scale`` is that of lines and letters."""
        pose = self._pose(moment, float(self._elevation_rad[moment.index]))
        picture = self._painter.render(self._lens, pose, moment.time_s).copy()
        view = _View(self._lens, pose)
        for border in self._borders:
            view.line(picture, border, _WHITE, 1.5 * scale)
        self._draw_trail(picture, view, moment, scale)
        self._draw_frustum(picture, view, moment, scale)
        labels = self._draw_targets(picture, view, moment, scale)
        self._draw_vehicle(picture, view, moment)
        return picture, labels

    def _pose(self, moment: Moment, elevation_rad: float) -> CameraPose:
        """Behind and above, farther back when the vehicle is high, so that the ground below stays in view."""
        up_m = max(moment.altitude_agl_m, 0.0)
        ahead = np.array([np.cos(moment.heading_rad), np.sin(moment.heading_rad), 0.0])
        away = np.sin(elevation_rad) * np.array([0.0, 0.0, 1.0]) - np.cos(elevation_rad) * ahead
        eye = moment.position_enu_m + (_NEAREST_M + _AWAY * up_m) * away
        eye[2] = max(eye[2], self._terrain.height_at_m(*eye[:2].tolist()) + 2.0)
        gaze = moment.position_enu_m - [0.0, 0.0, 0.55 * up_m] - eye
        pitch_rad = float(np.arctan2(gaze[2], np.hypot(gaze[0], gaze[1])))
        return CameraPose(eye, rotation_camera_to_enu(moment.heading_rad, pitch_rad))

    def _elevations(self) -> F64:
        """(K,) how steeply each moment is looked down on: as flat as crowns and buildings leave it in sight.

        The view rises before something comes between, and moves smoothly.
        """
        world = self._story.run.world
        obstacles = Obstacles(world.terrain, world.trees, world.buildings)
        flattest = np.full(len(self._story), _ELEVATIONS_RAD[0])
        if not obstacles.exist:
            return flattest
        for k in range(len(flattest)):
            moment = self._story.moment(k)
            eyes = ((e, self._pose(moment, e).position_enu_m) for e in _ELEVATIONS_RAD)
            free = (e for e, eye in eyes if not obstacles.hide(moment.position_enu_m, eye))
            flattest[k] = next(free, _ELEVATIONS_RAD[-1])
        around = 2 * round(_RISES_S * self._story.fps) + 1
        return np.asarray(uniform_filter1d(maximum_filter1d(flattest, around), around, mode="nearest"))

    def _draw_trail(self, picture: U8, view: _View, moment: Moment, scale: float) -> None:
        first = max(moment.n_states - _TRAIL, 0)
        track = np.vstack([self._flown[first : moment.n_states], moment.position_enu_m])
        colours = [*self._colours[first + 1 : moment.n_states], self._colours[moment.n_states - 1]]
        view.segments(picture, track, colours, 2.5 * scale)

    def _draw_frustum(self, picture: U8, view: _View, moment: Moment, scale: float) -> None:
        """The detector's camera: its picture on the ground, tinted, and the edges of its view."""
        corners = self._story.footprint_enu_m(moment)
        if corners is None:
            return
        footprint, colour = self._on_ground(corners), rgb(ORANGE)
        view.area(picture, footprint, colour, 0.22)
        view.line(picture, np.vstack([footprint, footprint[:1]]), colour, 2.0 * scale)
        for corner in footprint:
            view.line(picture, np.array([moment.camera.position_enu_m, corner]), colour, 1.0 * scale)

    def _draw_targets(self, picture: U8, view: _View, moment: Moment, scale: float) -> list[Label]:
        labels = []
        for target in self._story.targets(moment.time_s):
            colour = rgb(STANDING_COLOURS[target.standing])
            x, y, _ = target.position_enu_m.tolist()
            radius_m = max(target.radius_95_m, 0.8)
            ring = np.array([x, y]) + radius_m * _CIRCLE
            ground = self._on_ground(np.vstack([ring, ring[:1]]))
            view.area(picture, ground, colour, 0.25)
            view.line(picture, ground, colour, 2.0 * scale)
            if target.standing in ("confirmed", "rejected"):
                top = ground[0] * [0, 0, 1] + [x, y, 0.12 * moment.altitude_agl_m + 1.5]
                foot = np.array([x, y, ground[0, 2]])
                view.line(picture, np.array([foot, top]), colour, 1.5 * scale)
                place = view.pixel(top)
                if place is not None:
                    words = f"{target.id} {target.standing}"
                    labels.append(Label(*place, words, 11 * scale, _WHITE, "ms", chip=True))
        return labels

    def _draw_vehicle(self, picture: U8, view: _View, moment: Moment) -> None:
        """A quadrotor, its front rotors in another colour, larger than life."""
        depth = view.depth(moment.position_enu_m)
        arm = 0.5 * _VEHICLE_PX * self._lens.width_px / 800.0 * depth / self._lens.focal_px
        top = moment.camera.R_camera_to_enu
        ahead = -top[:, 1] + top[:, 2]
        yaw = float(np.arctan2(ahead[1], ahead[0]))
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])

        def level(xy: F64, up: float = 0.0) -> F64:
            return np.column_stack([xy @ turn.T * arm, np.full(len(xy), up * arm)]) + moment.position_enu_m

        spar_px = 0.16 * arm * self._lens.focal_px / depth
        rotor, body = 0.48 * _CIRCLE, _CIRCLE * [0.34, 0.24]
        for tip in _ARMS:
            view.line(picture, level(np.array([[0.0, 0.0], tip])), _DARK, spar_px)
        for tip in _ARMS:
            disc = level(tip + rotor, 0.12)
            view.area(picture, disc, rgb(ORANGE) if tip[0] > 0 else _WHITE, 0.75)
            view.line(picture, np.vstack([disc, disc[:1]]), _DARK, 1.0)
        view.area(picture, level(body, 0.1), _DARK, 1.0)

    def _on_ground(self, xy_enu_m: F64) -> F64:
        return np.column_stack([xy_enu_m, self._terrain.height_m(xy_enu_m) + 0.05])


class _View:
    """Draws shapes in ENU as a camera sees them, cut off at its near plane."""

    def __init__(self, lens: Lens, pose: CameraPose) -> None:
        self._f, self._centre = lens.focal_px, np.array([lens.width_px, lens.height_px]) / 2
        self._pose = pose

    def depth(self, point_enu_m: F64) -> float:
        return max(float(self._seen(point_enu_m[None])[0, 2]), _NEAR_M)

    def pixel(self, point_enu_m: F64) -> tuple[float, float] | None:
        """Where a point is, or None if it is not in the picture."""
        seen = self._seen(point_enu_m[None])
        if seen[0, 2] < _NEAR_M:
            return None
        x, y = self._pixels(seen)[0].tolist()
        inside = 0 <= x < 2 * self._centre[0] and 0 <= y < 2 * self._centre[1]
        return (x, y) if inside else None

    def line(self, picture: U8, points_enu_m: F64, colour: Rgb, width_px: float) -> None:
        self.segments(picture, points_enu_m, [colour] * (len(points_enu_m) - 1), width_px)

    def segments(self, picture: U8, points_enu_m: F64, colours: list[Rgb], width_px: float) -> None:
        """A line through points (N, 3), whose pieces (N - 1) have colours of their own."""
        seen = self._seen(points_enu_m)
        in_front = (seen[:, 2] >= _NEAR_M).tolist()
        alike = groupby(range(len(colours)), lambda k: (colours[k], in_front[k], in_front[k + 1]))
        for (colour, begins, ends), pieces in alike:
            first, *others = pieces
            run = seen[first : first + len(others) + 2]
            if begins and ends:
                pen.line(picture, self._pixels(run), colour, width_px)
            elif begins or ends:  # one piece, as the next begins on the other side
                a, b = run
                pen.line(picture, self._pixels(np.array([_cut(a, b), _cut(b, a)])), colour, width_px)

    def area(self, picture: U8, corners_enu_m: F64, colour: Rgb, opacity: float) -> None:
        seen = self._seen(corners_enu_m)
        cut = [
            place
            for a, b in zip(seen, np.roll(seen, -1, axis=0), strict=True)
            if a[2] >= _NEAR_M or b[2] >= _NEAR_M
            for place in (_cut(a, b), _cut(b, a))
        ]
        if cut:
            pen.area(picture, self._pixels(np.array(cut)), colour, opacity)

    def _seen(self, points_enu_m: F64) -> F64:
        """Points (N, 3) in the camera's optical axes."""
        return np.asarray((points_enu_m - self._pose.position_enu_m) @ self._pose.R_camera_to_enu)

    def _pixels(self, seen: F64) -> F64:
        return np.asarray(self._f * seen[:, :2] / seen[:, 2:] + self._centre)


def _cut(a: F64, b: F64) -> F64:
    """``a``, or where the way from it to ``b`` comes through the near plane."""
    if a[2] >= _NEAR_M:
        return a
    return np.asarray(a + (b - a) * (_NEAR_M - a[2]) / (b[2] - a[2]))
