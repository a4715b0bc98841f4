"""Where, when and through which lens a picture was taken, as far as anybody knows."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from datetime import datetime

import numpy as np

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_camera_to_enu, yaw_from_heading


@dataclass(frozen=True, slots=True)
class Taken:
    """What is known of one exposure; None: not known. Angles are those of the camera, not of the vehicle."""

    latitude_deg: float | None = None
    longitude_deg: float | None = None
    altitude_amsl_m: float | None = None  # as the aircraft says it: often tens of metres wrong
    height_m: float | None = None  # above the take-off place
    altitude_agl_m: float | None = None  # above the ground below, where it was measured
    heading_deg: float | None = (
        None  # where the picture's top points if the camera looks down: 0 north, 90 east
    )
    pitch_deg: float | None = None  # of the optical axis above the horizon: -90 straight down
    roll_deg: float | None = None  # clockwise, seen from behind the camera
    hfov_rad: float | None = None
    time_s: float | None = None  # on the camera's clock
    utc: datetime | None = None

    def filled_from(self, other: Taken) -> Taken:
        """This, with what it does not know from another; a height that it knows is not measured elsewhere."""
        gaps = {f.name: getattr(other, f.name) for f in fields(self) if getattr(self, f.name) is None}
        if self.height_m is not None:
            gaps.pop("altitude_agl_m", None)
        return replace(self, **gaps)

    @property
    def lat_lon_deg(self) -> tuple[float, float]:
        """The place, which is known."""
        assert self.latitude_deg is not None
        assert self.longitude_deg is not None
        return self.latitude_deg, self.longitude_deg

    @property
    def over_ground_m(self) -> float | None:
        """Height above level ground: as measured, or else above the take-off place."""
        return self.height_m if self.altitude_agl_m is None else self.altitude_agl_m

    @property
    def R_camera_to_enu(self) -> F64 | None:
        """The camera's attitude (3, 3); None where its heading or pitch is not known."""
        if self.pitch_deg is None or self.heading_deg is None:
            return None
        return rotation_camera_to_enu(
            yaw_from_heading(self.heading_deg),
            math.radians(self.pitch_deg),
            math.radians(self.roll_deg or 0.0),
        )

    def ground_m2(self, width_px: int, height_px: int) -> float | None:
        """Level ground in a picture of this size, as ``Lens.seen_ground_m2``; None where not known."""
        height_m = self.over_ground_m
        if height_m is None or height_m <= 0.0 or self.hfov_rad is None or self.pitch_deg is None:
            return None
        R = rotation_camera_to_enu(0.0, math.radians(self.pitch_deg), math.radians(self.roll_deg or 0.0))
        pose = CameraPose(np.array([0.0, 0.0, height_m]), R)
        return Lens(width_px, height_px, self.hfov_rad).seen_ground_m2(pose, height_m)
