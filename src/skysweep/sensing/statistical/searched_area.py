"""How probably a target in each square cell of a scenario's area would have been reported by now."""

from __future__ import annotations

import math

import numpy as np
import shapely

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraMotion, CameraPose
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.cells import SearchedCells
from skysweep.sensing.statistical.model import StatisticalModel
from skysweep.worlds.occlusion import known_occluders
from skysweep.worlds.world import build_terrain

_FINEST_M = 0.25


class SearchedArea:
    """``cells`` over the area of a scenario, row 0 the southernmost.

    ``cells_across`` of them span the shorter side of a picture from the scan's height, unless there would be
    more than about ``max_cells``. ``bounds_enu_m`` are west, south, east and north; ``inside`` (R, C) are the
    cells that touch the area. Raises UserError where the model does not know what is searched for.
    """

    def __init__(
        self, scenario: Scenario, model: StatisticalModel, cells_across: int, max_cells: int
    ) -> None:
        area, search = scenario.area_enu_m, scenario.search
        west, south, east, north = area.bounds
        across_m = min(scenario.camera.lens.footprint_m(search.scan_altitude_agl_m))
        sides_m = east - west, north - south
        coarse_m = max(math.sqrt(math.prod(sides_m) / max_cells), max(sides_m) / max_cells)
        self.cell_m = max(across_m / cells_across, coarse_m, _FINEST_M)
        columns, rows = (max(1, math.ceil(side_m / self.cell_m - 1e-9)) for side_m in sides_m)
        self.bounds_enu_m = (west, south, west + columns * self.cell_m, south + rows * self.cell_m)
        x, y = np.meshgrid(
            west + (np.arange(columns) + 0.5) * self.cell_m, south + (np.arange(rows) + 0.5) * self.cell_m
        )
        half_m = 0.5 * self.cell_m
        self.inside = shapely.intersects(area, shapely.box(x - half_m, y - half_m, x + half_m, y + half_m))
        terrain = build_terrain(scenario)
        z = terrain.height_m(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
        self.centres_enu_m = np.stack([x, y, z], axis=-1)
        self.cells = SearchedCells(
            self.centres_enu_m,
            self.inside,
            terrain,
            known_occluders(scenario, terrain).solids,
            scenario.light,
            scenario.camera,
            scenario.detector,
            model,
            scenario.target_sizes_m,
            scenario.target_poses,
            scenario.smallest_size_m,
        )


def motion_between(
    before: CameraPose, after: CameraPose, R_camera_to_enu: F64, lasted_s: float
) -> CameraMotion:
    """The mean motion from one pose to another, in the axes of a camera that looks as R says."""
    moved_m = after.position_enu_m - before.position_enu_m
    turned = before.R_camera_to_enu.T @ after.R_camera_to_enu
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = turned.tolist()
    rates = np.array([zy - yz, xz - zx, yx - xy])
    return CameraMotion(R_camera_to_enu.T @ moved_m / lasted_s, 0.5 * rates / lasted_s)
