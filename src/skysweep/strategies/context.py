"""What a strategy may know before take-off: everything but the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.geometry.camera import Lens
from skysweep.planning.flight_plan import leg_time_s
from skysweep.scenarios.model import Model, Scenario, Search, VehicleLimits
from skysweep.sensing.statistical.model import StatisticalModel, model_for
from skysweep.sensing.statistical.searched_area import SearchedArea
from skysweep.sensing.statistical.view import View
from skysweep.types import XY
from skysweep.worlds.obstacles import Obstacles, keep_m
from skysweep.worlds.occlusion import Occluders, known_occluders
from skysweep.worlds.world import TerrainSurface

_SEEN_THROUGH = 0.2  # probability that a look shows what is thought to be hidden: nobody knows every leaf


@dataclass(frozen=True)
class MissionContext:
    """The mission as it is known on the ground, for a strategy that is about to fly it.

    Nothing in it says where targets are or how many there are.
    """

    search: Search
    waypoints_xy_enu_m: tuple[XY, ...]  # F: from there everything is seen
    look_s: float  # from arriving at a place until two looks from there are answered
    looks_hz: float
    lens: Lens
    yaw_rad: float  # of nose and camera, ENU
    gimbal_pitch_rad: float  # -pi / 2 looks straight down
    area_enu_m: shapely.Polygon
    home_xy_enu_m: XY
    sizes_m: Mapping[str, tuple[float, float]]  # smallest and largest of each class that is searched for
    poses: Mapping[str, tuple[str, ...]]  # how they may lie or stand
    confidence_min: float  # of what the detector reports
    exposure_s: float
    vehicle: VehicleLimits
    surface: str  # of most of the ground
    obstacles: Obstacles  # known trees and buildings, and the ground
    keep_m: float  # distance that the vehicle keeps from them
    load_sensor_model: Callable[[], StatisticalModel]
    load_sensor_view: Callable[[], View]
    load_occluders: Callable[[], Occluders]
    searched_area: Callable[[int, int], SearchedArea]  # nothing looked at yet; arguments as ``SearchedArea``
    parameters: Model  # the strategy's own

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        waypoints_xy_enu_m: NDArray[np.float64],
        yaw_rad: float,
        obstacles: Obstacles,
        parameters: Model,
    ) -> MissionContext:
        """The context of one mission of a scenario."""
        camera = scenario.camera

        def load() -> StatisticalModel:
            return model_for(scenario, "write another search.strategy")

        looks_hz = min(scenario.detector.rate_hz, camera.rate_hz)
        return cls(
            scenario.search,
            tuple((float(x), float(y)) for x, y in waypoints_xy_enu_m),
            camera.latency_s + camera.pose_delay_s + 2.0 / looks_hz,
            looks_hz,
            camera.lens,
            yaw_rad,
            camera.gimbal.pitch_rad,
            scenario.area_enu_m,
            scenario.home.position_enu_m,
            scenario.target_sizes_m,
            scenario.target_poses,
            scenario.detector.confidence_min,
            camera.exposure_s,
            scenario.vehicle,
            _commonest_surface(obstacles.terrain),
            obstacles,
            keep_m(scenario),
            load,
            lambda: load().view_of(camera, scenario.detector, scenario.smallest_size_m),
            lambda: known_occluders(scenario, obstacles.terrain),
            lambda cells_across, max_cells: SearchedArea(scenario, load(), cells_across, max_cells),
            parameters,
        )

    @cached_property
    def sensor_model(self) -> StatisticalModel:
        """How well this detector sees what, as it was calibrated.

        Raises UserError where it was not calibrated with this camera.
        """
        return self.load_sensor_model()

    @cached_property
    def sensor_view(self) -> View:
        """The camera's pictures in the pixels of that model. Raises UserError as ``sensor_model``."""
        return self.load_sensor_view()

    @cached_property
    def occluders(self) -> Occluders:
        """What shades and hides, of the trees and buildings that are known."""
        return self.load_occluders()

    def ground_at_m(self, xy: XY) -> float:
        """Height of the ground, ENU."""
        return self.obstacles.terrain.height_at_m(*xy)

    def shown(self, place_enu_m: F64, eye_enu_m: F64) -> float:
        """How probably a look from an eye (3,) shows what is at a place (3,), past known crowns and walls."""
        return max(self.obstacles.shown_share(place_enu_m, eye_enu_m), _SEEN_THROUGH)

    def leg_s(self, distance_m: float, climb_m: float, speed_mps: float) -> float:
        """Seconds from standing to standing; ``climb_m`` is negative downwards."""
        vertical_mps = self.vehicle.climb_speed_mps if climb_m > 0.0 else self.vehicle.descent_speed_mps
        return max(float(leg_time_s(distance_m, speed_mps)), abs(climb_m) / vertical_mps)


def _commonest_surface(terrain: TerrainSurface) -> str:
    cover = terrain.cover
    return terrain.surface if cover is None else cover.names[int(np.bincount(cover.codes.ravel()).argmax())]
