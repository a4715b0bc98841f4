"""The map: the ground from above, what the camera has seen of it, the path so far and the candidates."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import shapely

from skysweep.arrays import F64, U8
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.results.metrics import seen_footprints
from skysweep.results.reporting.style import ORANGE, VERMILLION
from skysweep.results.video import pen
from skysweep.results.video.pen import Label, rgb
from skysweep.results.video.story import STANDING_COLOURS, Moment, Story, mode_colour
from skysweep.worlds.rendering.renderer import Backend, make_renderer
from skysweep.worlds.world import World

_MARGIN = 0.05  # of the map's larger side
_CLEAR_AIR_M = 1e7
_SIDES_ABOVE, _HIGHEST_M = 8.0, 5000.0  # from where the ground is drawn
_UNSEEN = 0.5  # brightness of ground not seen yet
_OUTSIDE = 0.7  # and of ground outside the area
_WHITE, _BLACK = rgb("white"), rgb("black")


class Chart:
    """Draws the map. Moments must come in their order, since the ground seen only grows."""

    def __init__(self, story: Story, width_px: int, height_px: int, renderer: Backend) -> None:
        run = story.run
        self._story = story
        self.bounds_enu_m = _bounds(story, width_px / height_px)
        self._px_per_m = width_px / (self.bounds_enu_m[2] - self.bounds_enu_m[0])
        photo = _ground_from_above(run.world, self.bounds_enu_m, width_px, height_px, renderer)
        inside = np.zeros((height_px, width_px), np.uint8)
        area = run.scenario.area_enu_m
        for ring, value in ((area.exterior, 1), *((hole, 0) for hole in area.interiors)):
            cv2.fillPoly(inside, [np.round(self.pixels(np.array(ring.coords))).astype(np.int32)], value)
        self._inside, self._photo = inside, photo
        shade = np.where(inside[..., None] == 1, _UNSEEN, _OUTSIDE)
        self._ground = np.round(photo * shade).astype(np.uint8)
        self._seen_s, footprints = seen_footprints(run)
        self._footprints = [self.pixels(corners) for corners in footprints]
        self._n_seen = 0
        self._path_px = self.pixels(story.flown_enu_m[:, :2])
        modes = [mode_colour(mode) for mode in story.flown_modes]
        changes = [k for k in range(1, len(modes)) if modes[k] != modes[k - 1]]
        self._pieces = [(a, b, modes[a]) for a, b in zip([0, *changes], [*changes, len(modes)], strict=True)]

    @property
    def seen_share(self) -> float:
        """Share of the area that was in the picture so far."""
        inside = int(np.count_nonzero(self._inside))
        return int(np.count_nonzero(self._inside == 2)) / max(inside, 1)

    def pixels(self, xy_enu_m: F64) -> F64:
        """Places (N, 2) on the map, in pixels from its upper left corner."""
        west, _, _, north = self.bounds_enu_m
        return np.column_stack([xy_enu_m[:, 0] - west, north - xy_enu_m[:, 1]]) * self._px_per_m

    def draw(self, moment: Moment, scale: float) -> tuple[U8, list[Label]]:
        """The map and its labels; ``scale`` is that of lines and letters."""
        self._see(moment.time_s)
        picture = self._ground.copy()
        self._draw_still_life(picture)
        self._draw_truth(picture, moment.time_s)
        here_px = self.pixels(moment.position_enu_m[None, :2])[0]
        for first, end, colour in self._pieces:
            if first < moment.n_states:
                piece = self._path_px[first : min(end + 1, moment.n_states)]
                if end >= moment.n_states:
                    piece = np.vstack([piece, here_px])
                pen.line(picture, piece, colour, 2.0 * scale)
        self._draw_frustum(picture, moment, scale)
        for target in self._story.targets(moment.time_s):
            self._draw_target(
                picture, target.standing, self.pixels(target.position_enu_m[None, :2])[0], scale
            )
        self._draw_vehicle(picture, here_px, moment.heading_rad, scale)
        return picture, [self._draw_scale(picture, scale)]

    def _see(self, time_s: float) -> None:
        """Lighten the ground that came into the picture."""
        while self._n_seen < len(self._seen_s) and self._seen_s[self._n_seen] <= time_s:
            corners = self._footprints[self._n_seen]
            self._n_seen += 1
            height, width = self._inside.shape
            low = np.clip(np.floor(corners.min(axis=0)), 0, (width, height)).astype(int)
            high = np.clip(np.ceil(corners.max(axis=0)) + 1, 0, (width, height)).astype(int)
            if (high <= low).any():
                continue
            part = np.s_[low[1] : high[1], low[0] : high[0]]
            now = np.zeros(self._inside[part].shape, np.uint8)
            cv2.fillPoly(now, [np.round(corners - low).astype(np.int32)], 1)
            news = (now == 1) & (self._inside[part] == 1)
            self._ground[part][news] = self._photo[part][news]
            self._inside[part][news] = 2

    def _draw_still_life(self, picture: U8) -> None:
        scenario = self._story.run.scenario
        for ring in (scenario.area_enu_m.exterior, *scenario.area_enu_m.interiors):
            pen.line(picture, self.pixels(np.array(ring.coords)), _WHITE, 1.0, closed=True)
        for corners in scenario.safety.no_fly_enu_m:
            outline = self.pixels(np.array(corners, dtype=float))
            pen.area(picture, outline, rgb(VERMILLION), 0.3)
            pen.line(picture, outline, rgb(VERMILLION), 1.5, closed=True)
        x, y = self.pixels(np.array([scenario.home.position_enu_m], dtype=float))[0]
        square = np.array([[x - 4, y - 4], [x + 4, y - 4], [x + 4, y + 4], [x - 4, y + 4]])
        pen.area(picture, square, _WHITE, 1.0)
        pen.line(picture, square, _BLACK, 1.0, closed=True)

    def _draw_truth(self, picture: U8, time_s: float) -> None:
        run = self._story.run
        for thing in run.world.targets if run.has_truth else ():
            place = run.world.position(thing, time_s)
            pen.disc(picture, self.pixels(place[None, :2])[0], 6.0, _WHITE, 1)

    def _draw_frustum(self, picture: U8, moment: Moment, scale: float) -> None:
        ground = self._story.footprint_enu_m(moment)
        if ground is not None:
            pen.area(picture, self.pixels(ground), rgb(ORANGE), 0.25)
            pen.line(picture, self.pixels(ground), rgb(ORANGE), 1.5 * scale, closed=True)

    @staticmethod
    def _draw_target(picture: U8, standing: str, place_px: F64, scale: float) -> None:
        """As on the report's map: a disc if confirmed, a cross if rejected, else a ring."""
        colour = rgb(STANDING_COLOURS[standing])
        if standing == "confirmed":
            pen.disc(picture, place_px, 4.5 * scale, colour)
            pen.disc(picture, place_px, 4.5 * scale, _WHITE, 1)
        elif standing == "rejected":
            for slope in (1.0, -1.0):
                arm = 4.5 * scale * np.array([1.0, slope])
                pen.line(picture, np.array([place_px - arm, place_px + arm]), _BLACK, 4.0 * scale)
                pen.line(picture, np.array([place_px - arm, place_px + arm]), colour, 2.0 * scale)
        else:
            pen.disc(picture, place_px, 4.0 * scale, colour, max(1, round(2.0 * scale)))

    @staticmethod
    def _draw_vehicle(picture: U8, place_px: F64, heading_rad: float, scale: float) -> None:
        ahead = np.array([math.cos(heading_rad), -math.sin(heading_rad)])
        aside = np.array([-ahead[1], ahead[0]])
        arrow = np.array([1.0 * ahead, -0.8 * ahead + 0.7 * aside, -0.4 * ahead, -0.8 * ahead - 0.7 * aside])
        points = place_px + 9.0 * scale * arrow
        pen.area(picture, points, _WHITE, 1.0)
        pen.line(picture, points, _BLACK, 1.0, closed=True)

    def _draw_scale(self, picture: U8, scale: float) -> Label:
        """A bar of a round length, lower right."""
        height, width = picture.shape[:2]
        most_m = 0.28 * width / self._px_per_m
        unit = 10.0 ** math.floor(math.log10(most_m))
        length_m = max(k * unit for k in (1, 2, 5) if k * unit <= most_m)
        x1, y = width - 12.0 * scale, height - 10.0 * scale
        x0 = x1 - length_m * self._px_per_m
        bar = np.array([[x0, y], [x1, y]])
        pen.line(picture, bar, _BLACK, 4.0 * scale)
        pen.line(picture, bar, _WHITE, 2.0 * scale)
        words = f"{length_m:g} m"
        return Label((x0 + x1) / 2, y - 6.0 * scale, words, 11 * scale, _WHITE, "ms", chip=True)


def _bounds(story: Story, aspect: float) -> tuple[float, float, float, float]:
    """West, south, east, north around area, home and path, of the panel's aspect."""
    area = np.array(shapely.get_coordinates(story.run.scenario.area_enu_m))
    home = np.array([story.run.scenario.home.position_enu_m], dtype=float)
    points = np.concatenate([area, home, story.flown_enu_m[:, :2]])
    low, high = points.min(axis=0), points.max(axis=0)
    centre, size = (low + high) / 2, np.maximum(high - low, 1.0) * (1.0 + 2.0 * _MARGIN)
    width_m = max(size[0], aspect * size[1])
    half = np.array([width_m, width_m / aspect]) / 2
    west, south = (centre - half).tolist()
    east, north = (centre + half).tolist()
    return west, south, east, north


def _ground_from_above(
    world: World, bounds: tuple[float, float, float, float], width_px: int, height_px: int, renderer: Backend
) -> U8:
    """The ground (H, W, 3), north up, without targets, through clear air."""
    west, south, east, north = bounds
    bare = replace(world, objects=(), light=world.light.model_copy(update={"visibility_m": _CLEAR_AIR_M}))
    above_m = min(_SIDES_ABOVE * max(east - west, north - south), _HIGHEST_M)
    lens = Lens(width_px, height_px, 2.0 * math.atan((east - west) / 2.0 / above_m))
    x, y = (west + east) / 2, (south + north) / 2
    place = np.array([x, y, world.terrain.height_at_m(x, y) + above_m])
    painter = make_renderer(bare, renderer)
    try:
        return painter.render(lens, CameraPose(place, rotation_camera_to_enu(math.pi / 2, -math.pi / 2)))
    finally:
        painter.close()
