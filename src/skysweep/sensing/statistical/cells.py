"""How probably a target in each cell of a grid would have been reported by now: its probability of detection.

Every look at a cell is taken as one that missed: the chance that all of them miss a target there is what is
left to 1. The sensor model says how well a look sees a target that stands alone; what looks of one target
have in common is kept by the belief of its luck (``luck.py``), so that ten looks from one side count less
than ten independent ones.

A target is one of several *variants*, equally probable within its class: a pose, its smallest and largest
size and, standing with a front that matters, the four sides it may face. All classes count alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64, I64
from skysweep.geometry.camera import CameraMotion, CameraPose
from skysweep.geometry.point_tree import PointTree, in_view
from skysweep.scenarios.model import CameraModel, DetectorModel, Light
from skysweep.sensing.statistical.factors import (
    CONTRAST_LIMITS,
    CONTRAST_UNIT,
    CONTRAST_USUAL,
    CUT_MIN,
    FACTORS,
    HIDDEN_MAX,
    TOO_SMALL,
    factors_of_look,
)
from skysweep.sensing.statistical.luck import WEIGHT, unseen, update
from skysweep.sensing.statistical.model import KindModel, StatisticalModel, score_of
from skysweep.worlds.grid import Grid, around
from skysweep.worlds.occlusion import (
    FLAT,
    SHAPES,
    is_behind_a_hill,
    middle_above_ground_m,
    pixels_on_target,
    relief,
    shades,
    visible_share,
)
from skysweep.worlds.world import TerrainSurface

_MIN_DEPTH_M = 0.1
_FRONT_MATTERS = 0.5  # in the score, from front to side
_N_FACTORS = len(FACTORS)
STILL = CameraMotion(np.zeros(3), np.zeros(3))
_NOT_KNOWN = -1.0

VARIANT = np.dtype(
    [
        ("size", float),
        ("shape", np.int64),
        ("middle", float),  # height above ground
        ("facing", float, 2),  # cosine and sine of its yaw; 0 where its front does not matter
        ("contrast", float),
        ("object_share", float),
        ("aspect_share", float),
        ("fade_rad", float),
        ("lapse_object_share", float),
        ("lapse_aspect_share", float),
        ("unsure", float),  # of the mean score, the same in every look of a target
        ("factors", float, _N_FACTORS),
    ]
)


class SearchedCells:
    """The chance of a report of a target in the middle of each cell of a grid, updated by every look.

    ``centres_enu_m`` (R, C, 3) are on the ground, by row from south to north; ``wanted`` (R, C) are the cells
    that count; ``solids`` those of ``worlds.occlusion``, which cast their shadows in the ``light``;
    ``sizes_m`` and ``poses`` those of each searched class, of which the smallest is ``smallest_m``. Raises
    UserError where the model does not know one of the classes.
    """

    def __init__(
        self,
        centres_enu_m: F64,
        wanted: NDArray[np.bool_],
        terrain: TerrainSurface,
        solids: F64,
        light: Light,
        camera: CameraModel,
        detector: DetectorModel,
        model: StatisticalModel,
        sizes_m: Mapping[str, tuple[float, float]],
        poses: Mapping[str, Sequence[str]],
        smallest_m: float,
    ) -> None:
        self._wanted, self._centres = wanted, centres_enu_m[wanted]
        self._solids, self._grid, self._relief = solids, Grid.of(solids[:, :2], solids[:, 9]), relief(terrain)
        self._largest_m = max(high for _, high in sizes_m.values())
        self._shades_by: dict[tuple[float, float, float], F64] = {}
        self.light_by(light)
        cover = terrain.cover
        names = (terrain.surface,) if cover is None else cover.names
        self._ground = np.zeros(len(self._centres), dtype=np.int64)
        if cover is not None:
            self._ground[:] = cover.codes_at(self._centres[:, :2])
        view = self._view = model.view_of(camera, detector, smallest_m)
        self._exposure_s, self._ground_at_m = camera.exposure_s, terrain.height_at_m
        self._fade_scale = model.fade_scale
        self._threshold = float(score_of(detector.confidence_min))
        self._log_pixels = np.log(model.pixels)
        octaves = model.lens_octaves(view)
        found = [list(_variants(model, surface, octaves, sizes_m, poses)) for surface in names]
        self._weights = np.array([weight for weight, _, _ in found[0]])
        self._tables = np.array([[table for _, table, _ in on_one] for on_one in found])
        variants = np.array([[variant for _, _, variant in on_one] for on_one in found], dtype=VARIANT)
        self._variants = variants.view(np.float64)
        self._tree = PointTree.of(self._centres, float(variants["middle"].max()))
        self._room = np.empty(len(self._centres) + 2 * len(solids), dtype=np.int64)
        self.clear()

    def light_by(self, light: Light) -> None:
        """The next looks are under this sun."""
        to_sun = light.to_sun_enu
        if to_sun not in self._shades_by:
            self._shades_by[to_sun] = shades(
                self._centres, self._largest_m, np.array(to_sun), self._solids, *self._grid
            )
        self._shades = self._shades_by[to_sun]

    def clear(self) -> None:
        """Forget all looks."""
        self._luck = unseen((len(self._centres), len(self._weights)))

    @property
    def pod(self) -> F64:
        """(R, C) 0..1; 0 where nothing was seen, and in cells that do not count."""
        pod = np.zeros(self._wanted.shape)
        pod[self._wanted] = -np.expm1(self._luck[..., WEIGHT]) @ self._weights
        return pod

    def promised(self, pose: CameraPose, n_looks: int) -> F64:
        """Share (R, C) of the targets that all looks missed that so many more from there would report."""
        missed, known = 1.0 - self.pod, self._luck
        self._luck = known.copy()
        for _ in range(n_looks):
            self.look(pose, STILL)
        still_missed = 1.0 - self.pod
        self._luck = known
        return np.asarray(1.0 - still_missed / np.maximum(missed, 1e-12))

    def look(self, pose: CameraPose, motion: CameraMotion) -> None:
        """Take in a picture from there, with this motion of the camera."""
        x, y, z = pose.position_enu_m.tolist()
        view = self._view.at(z - self._ground_at_m(x, y))
        _look(
            self._luck,
            self._centres,
            self._ground,
            self._shades,
            *self._tree,
            self._solids,
            *self._grid,
            *self._relief,
            self._room,
            self._tables,
            self._variants,
            self._log_pixels,
            view.tiles_px,
            (view.focal_px, view.width_px, view.height_px, self._exposure_s),
            self._fade_scale,
            self._threshold,
            pose.position_enu_m,
            pose.R_camera_to_enu,
            motion.velocity_mps,
            motion.rates_radps,
        )


def _variants(
    model: StatisticalModel,
    surface: str,
    lens_octaves: float,
    sizes_m: Mapping[str, tuple[float, float]],
    poses: Mapping[str, Sequence[str]],
) -> Iterator[tuple[float, list[float], tuple[Any, ...]]]:
    """Weight, tables of score, spread and lapses, and VARIANT of what a target may be."""
    for name, (low_m, high_m) in sizes_m.items():
        kinds = model.searched(name, poses[name])
        sizes = sorted({low_m, high_m})
        for kind, size_m in itertools.product(kinds, sizes):
            sides = _sides(kind)
            weight = 1.0 / (len(sizes_m) * len(kinds) * len(sizes) * len(sides))
            lapses = *kind.lapse, *kind.lapse_among
            table = [*kind.scores(surface, lens_octaves), *kind.spread, *lapses]
            mean, std = model.contrast(kind.kind, kind.pose, surface)
            contrast = float(np.clip((mean - CONTRAST_USUAL) / CONTRAST_UNIT, *CONTRAST_LIMITS))
            shares = kind.object_share, kind.aspect_share, kind.fade_rad
            of_lapses = kind.lapse_object_share, kind.lapse_aspect_share
            of_kind = contrast, *shares, *of_lapses, kind.contrast * std / CONTRAST_UNIT
            shape = SHAPES.get(kind.pose, FLAT), middle_above_ground_m(kind.kind, kind.pose, size_m)
            for side in sides:
                yield weight, table, (size_m, *shape, side, *of_kind, kind.factors)


def _sides(kind: KindModel) -> list[tuple[float, float]]:
    """Cosine and sine of the yaws that a target may have, as far as they matter."""
    if kind.pose == "standing" and abs(kind.front) + abs(kind.front_near) > _FRONT_MATTERS:
        return [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
    return [(0.0, 0.0)]


@njit(cache=True)
def _look(
    luck: F64,
    centres: F64,
    ground: I64,
    shade: F64,
    tree_boxes: F64,
    tree_nodes: I64,
    tree_order: I64,
    solids: F64,
    grid_frame: F64,
    grid_starts: I64,
    grid_order: I64,
    heights: F64,
    bounds: F64,
    room: I64,
    tables: F64,
    variant_floats: F64,
    log_pixels: F64,
    tiles: F64,
    optics: tuple[float, float, float, float],
    fade_scale: float,
    threshold: float,
    eye: F64,
    R: F64,
    velocity: F64,
    rates: F64,
) -> None:
    focal, width, height, exposure_s = optics
    variants_on = variant_floats.view(VARIANT)
    n_variants, g, largest = variants_on.shape[1], len(log_pixels), 0.0
    for k in range(n_variants):
        largest = max(largest, variants_on[0, k].size)
    across_1, up_1 = width / (2.0 * focal), height / (2.0 * focal)
    n_cells = in_view(room, tree_boxes, tree_nodes, tree_order, eye, R, across_1, up_1, largest)
    west, south, east, north = _span(room[:n_cells], centres, eye)
    n_gathered = around(
        room[n_cells:], grid_frame, grid_starts, grid_order, west, south, east, north, largest
    )
    gathered, near = room[n_cells : n_cells + n_gathered], room[n_cells + n_gathered :]
    for i in room[:n_cells]:
        centre, variants = centres[i], variants_on[ground[i]]
        n_near, beside_m = -1, math.inf
        for k in range(n_variants):
            variant = variants[k]
            dx, dy = centre[0] - eye[0], centre[1] - eye[1]
            dz = centre[2] + variant.middle - eye[2]
            depth = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
            if depth <= _MIN_DEPTH_M:
                continue
            u = focal * (R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz) / depth + width / 2
            v = focal * (R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz) / depth + height / 2
            pixels = pixels_on_target(focal, variant.shape, variant.size, dx, dy, dz, depth)
            half = pixels / 2
            if min(u + half, width) <= max(u - half, 0.0) or min(v + half, height) <= max(v - half, 0.0):
                continue
            at = math.log(pixels)
            if at < log_pixels[0] + math.log(TOO_SMALL):
                continue
            clear = _NOT_KNOWN
            blur = math.hypot(-velocity[0] / depth - rates[1], -velocity[1] / depth + rates[0])
            across = dx * dx + dy * dy
            away = max(across + dz * dz, 1e-9)
            distance = math.sqrt(away)
            x, y, z = -dx / distance, -dy / distance, -dz / distance
            node = 0
            while node < g - 2 and at > log_pixels[node + 1]:
                node += 1
            w = (at - log_pixels[node]) / (log_pixels[node + 1] - log_pixels[node])
            w = min(max(w, 0.0), 1.0)
            row = tables[ground[i], k]
            for tile in tiles:
                inside_x = (min(u + half, tile[2]) - max(u - half, tile[0])) / pixels
                inside_y = (min(v + half, tile[3]) - max(v - half, tile[1])) / pixels
                inside = inside_x * inside_y
                if inside_x <= 0.0 or inside_y <= 0.0 or inside < 1.0 - HIDDEN_MAX:
                    continue
                if clear == _NOT_KNOWN:
                    if n_near < 0:
                        n_near, beside_m = _near(near, gathered, solids, centre, eye, largest)
                    place = np.array((centre[0], centre[1], centre[2] + variant.middle))
                    clear = 1.0
                    if n_near > 0:
                        clear = visible_share(eye, place, variant.size, solids, near[:n_near])
                    if is_behind_a_hill(eye, place, heights, bounds):
                        clear = 0.0
                if inside * clear < 1.0 - HIDDEN_MAX:
                    continue
                is_beside = beside_m <= variant.size
                is_among = is_beside or shade[i] > 0.0 or clear < 1.0
                lapse = row[(3 if is_among else 2) * g :]
                factors = factors_of_look(
                    across / away,
                    variant.facing[0] * x + variant.facing[1] * y,
                    pixels,
                    1.0 - clear,
                    1.0 - inside,
                    inside_y < 1.0 - CUT_MIN,
                    1.0 if is_beside else 0.0,
                    shade[i],
                    blur * focal * exposure_s,
                    variant.contrast,
                    0.0,
                )
                mean = row[node] + w * (row[node + 1] - row[node])
                for f in range(_N_FACTORS):
                    mean += variant.factors[f] * factors[f]
                update(
                    luck[i, k],
                    pixels,
                    (x, y, z),
                    variant.fade_rad,
                    fade_scale,
                    mean,
                    row[g + node] + w * (row[g + node + 1] - row[g + node]),
                    lapse[node] + w * (lapse[node + 1] - lapse[node]),
                    variant.object_share,
                    variant.aspect_share,
                    variant.lapse_object_share,
                    variant.lapse_aspect_share,
                    variant.unsure,
                    math.nan,
                    threshold,
                )


@njit(cache=True)
def _span(cells: I64, centres: F64, eye: F64) -> tuple[float, float, float, float]:
    """West, south, east and north of the cells and the eye together: what hides a cell stands there."""
    west = east = eye[0]
    south = north = eye[1]
    for i in cells:
        west, east = min(west, centres[i, 0]), max(east, centres[i, 0])
        south, north = min(south, centres[i, 1]), max(north, centres[i, 1])
    return west, south, east, north


@njit(cache=True)
def _near(near: I64, gathered: I64, solids: F64, centre: F64, eye: F64, size_m: float) -> tuple[int, float]:
    """Write the solids that can hide a target there from the eye; and the distance to the nearest crown."""
    up = max(eye[2] - centre[2], 1e-3)
    flat = math.hypot(eye[0] - centre[0], eye[1] - centre[1]) / up
    n, beside_m = 0, math.inf
    for s in gathered:
        x, y = solids[s, 0] - centre[0], solids[s, 1] - centre[1]
        away = math.hypot(x, y) - solids[s, 9]
        if away <= max(solids[s, 8] - centre[2], 0.0) * flat + size_m:
            near[n] = s
            n += 1
        if solids[s, 10] == 0.0:
            beside_m = min(beside_m, away)
    return n, beside_m
