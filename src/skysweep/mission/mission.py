"""Everything that a mission is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from skysweep.arrays import F64
from skysweep.mission.witness import Witness
from skysweep.planning.following import Following
from skysweep.scenarios.model import Scenario
from skysweep.types import (
    XY,
    Detections,
    LookPeriod,
    Mode,
    PictureSensor,
    Sensor,
    Strategy,
    Tracker,
    Vehicle,
    VehicleState,
)
from skysweep.worlds.obstacles import Obstacles

Watch = Callable[[VehicleState, Mode, Detections | None], None]

_COVERS = 0.8  # of the plan's height


@dataclass(frozen=True, slots=True)
class Mission:
    """Everything that a mission is made of."""

    scenario: Scenario
    seed: int
    sensor_name: str
    vehicle: Vehicle
    sensor: Sensor
    tracker: Tracker
    strategy: Strategy
    waypoints_xy_enu_m: F64  # (N, 2), F
    cover_altitude_agl_m: float
    yaw_rad: float
    ground_at_m: Callable[[float, float], float]  # height at east and north
    look_period: LookPeriod  # of the sensor
    obstacles: Obstacles  # known ones
    pictures: PictureSensor | None = None  # the sensor, if it takes pictures
    witness: Witness | None = None  # of a simulated vehicle
    caveat: str = ""  # of what the strategy may believe, for the journal
    replays: bool = True  # deterministic; otherwise snapshots are journaled
    change_battery: Callable[[], None] | None = None  # of a simulated vehicle; None: a person changes it
    regain: Callable[[str | None], str] | None = None  # a taken vehicle from its holder; why not, or empty
    following: Following | None = None  # along the plan's transects
    blind_legs: tuple[tuple[XY, XY], ...] = ()  # flown blind before an interruption

    @property
    def return_altitude_agl_m(self) -> float:
        """Height above ground on the way home."""
        return max(self.cover_altitude_agl_m, self.scenario.search.scan_altitude_agl_m)

    def covers_from(self, altitude_agl_m: float) -> bool:
        """Whether a search at this height covers ground as planned, whatever the strategy calls it."""
        return altitude_agl_m >= _COVERS * self.cover_altitude_agl_m
