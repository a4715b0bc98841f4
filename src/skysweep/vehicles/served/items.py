"""Mission, fence and rally items of the mission protocol, and which of them the vehicle accepts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely

from skysweep.types import F64
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import Refused, Site, finite, whole
from skysweep.vehicles.mavlink.wire import Message

MISSION, FENCE, RALLY = 0, 1, 2  # MAV_MISSION_TYPE
MAX_ITEMS = {MISSION: 500, FENCE: 64, RALLY: 32}

AMSL, ABOVE_HOME = {0, 5}, {3, 6}  # MAV_FRAME
_UNSET = 2**31 - 1  # MAVLink's integer for NaN
_PLACES = {
    m.MAV_CMD_NAV_WAYPOINT,
    m.MAV_CMD_NAV_LOITER_UNLIM,
    m.MAV_CMD_NAV_LOITER_TIME,
    m.MAV_CMD_NAV_LAND,
    m.MAV_CMD_NAV_TAKEOFF,
}
_ACTED_ON = {
    m.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    m.MAV_CMD_NAV_DELAY,
    m.MAV_CMD_DO_JUMP,
    m.MAV_CMD_DO_CHANGE_SPEED,
}
_PASSED_OVER = {  # accepted as in PX4, but for parts that this vehicle does not have
    m.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
    m.MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL,
    m.MAV_CMD_DO_TRIGGER_CONTROL,
    m.MAV_CMD_DO_DIGICAM_CONTROL,
    m.MAV_CMD_DO_CONTROL_VIDEO,
    m.MAV_CMD_IMAGE_START_CAPTURE,
    m.MAV_CMD_IMAGE_STOP_CAPTURE,
    m.MAV_CMD_VIDEO_START_CAPTURE,
    m.MAV_CMD_VIDEO_STOP_CAPTURE,
    m.MAV_CMD_SET_CAMERA_MODE,
    m.MAV_CMD_SET_CAMERA_ZOOM,
    m.MAV_CMD_SET_CAMERA_FOCUS,
    m.MAV_CMD_DO_MOUNT_CONFIGURE,
    m.MAV_CMD_DO_MOUNT_CONTROL,
    m.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
    m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE,
    m.MAV_CMD_DO_SET_ROI,
    m.MAV_CMD_DO_SET_ROI_LOCATION,
    m.MAV_CMD_DO_SET_ROI_NONE,
    m.MAV_CMD_DO_LAND_START,
    m.MAV_CMD_OBLIQUE_SURVEY,
}
_CORNERS = {
    m.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    m.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_CIRCLES = {m.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True, m.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False}


@dataclass(frozen=True, slots=True)
class Item:
    """One item with its numbers as received, so that it is read back unchanged."""

    frame: int
    command: int
    autocontinue: int
    params: tuple[float, float, float, float]
    x: int  # latitude, 1e-7 degrees, in frames with a place
    y: int
    z: float

    @classmethod
    def of(cls, message: Message) -> Item:
        """The item of MISSION_ITEM_INT, or of MISSION_ITEM, whose place is in degrees."""
        kind = message.frame, message.command, message.autocontinue
        params = (message.param1, message.param2, message.param3, message.param4)
        x, y = message.x, message.y
        if message.get_type() == "MISSION_ITEM":
            unit = 1e7 if message.frame in AMSL | ABOVE_HOME else 1.0
            x, y = (_UNSET if (n := whole(v * unit)) is None else n for v in (x, y))
        return cls(*kind, params, x, y, message.z)

    def message(self, system: int, component: int, seq: int, kind: int) -> Message:
        """MISSION_ITEM_INT to a program."""
        head = system, component, seq, self.frame, self.command, 0, self.autocontinue
        place = self.x, self.y, self.z
        return m.MAVLink_mission_item_int_message(*head, *self.params, *place, kind)

    @property
    def is_place(self) -> bool:
        return self.command in _PLACES

    def position_enu_m(self, site: Site, home_enu_m: F64) -> F64:
        """Its position (3,). Raises Refused if its coordinates are invalid."""
        above = site.geodetic(home_enu_m)[2] if self.frame in ABOVE_HOME else 0.0
        return site.enu(self.x * 1e-7, self.y * 1e-7, above + self.z)


def refusal(item: Item, kind: int) -> int | None:
    """MAV_MISSION_RESULT of a refused item; None for a valid one."""
    known = {
        MISSION: _PLACES | _ACTED_ON | _PASSED_OVER,
        FENCE: _CORNERS.keys() | _CIRCLES.keys(),
        RALLY: {m.MAV_CMD_NAV_RALLY_POINT},
    }[kind]
    if item.command not in known:
        return int(m.MAV_MISSION_UNSUPPORTED)
    if item.is_place or kind != MISSION:
        if item.frame not in AMSL | ABOVE_HOME:
            return int(m.MAV_MISSION_UNSUPPORTED_FRAME)
        if abs(item.x) > 900_000_000:
            return int(m.MAV_MISSION_INVALID_PARAM5_X)
        if abs(item.y) > 1_800_000_000:
            return int(m.MAV_MISSION_INVALID_PARAM6_Y)
        if not abs(item.z) < 20_000.0:
            return int(m.MAV_MISSION_INVALID_PARAM7)
    if kind == FENCE and not 0.0 < item.params[0] < 1e6:
        return int(m.MAV_MISSION_INVALID_PARAM1)
    if item.command == m.MAV_CMD_DO_JUMP and not finite(*item.params[:2]):
        return int(m.MAV_MISSION_INVALID_PARAM1)
    return None


@dataclass(frozen=True, slots=True)
class UploadedFence:
    """The allowed area in plan view."""

    inside: tuple[shapely.Geometry, ...]
    outside: tuple[shapely.Geometry, ...]

    def allows(self, position_enu_m: F64) -> bool:
        """Whether a position is inside every inclusion and outside every exclusion."""
        point = shapely.Point(position_enu_m[:2])
        excluded = any(shape.covers(point) for shape in self.outside)
        return not excluded and all(shape.covers(point) for shape in self.inside)


NO_FENCE = UploadedFence((), ())


def fence_of(items: tuple[Item, ...], site: Site) -> UploadedFence:
    """The fence of its items. Raises Refused if they are not valid polygons and circles."""
    shapes: dict[bool, list[shapely.Geometry]] = {True: [], False: []}
    left = list(items)
    while left:
        first = left[0]
        if first.command in _CIRCLES:
            count, shape = 1, shapely.Point(_xy(first, site)).buffer(first.params[0], quad_segs=32)
        else:
            count = whole(first.params[0]) or 0
            corners = left[:count]
            alike = all((c.command, c.params[0]) == (first.command, first.params[0]) for c in corners)
            if count < 3 or len(corners) < count or not alike:
                raise Refused("a fence polygon has at least 3 corners, one after the other")
            shape = shapely.Polygon([_xy(corner, site) for corner in corners])
            if not shape.is_valid:
                raise Refused("a fence polygon crosses itself")
        shapely.prepare(shape)
        shapes[(_CIRCLES | _CORNERS)[first.command]].append(shape)
        del left[:count]
    return UploadedFence(tuple(shapes[True]), tuple(shapes[False]))


def _xy(item: Item, site: Site) -> F64:
    return site.enu(item.x * 1e-7, item.y * 1e-7, site.frame.altitude_m)[:2]


def heading_towards(from_enu_m: F64, to_enu_m: F64, otherwise_rad: float) -> float:
    """ENU yaw from one place to another; ``otherwise_rad`` within 2 m."""
    gap = to_enu_m - from_enu_m
    return math.atan2(gap[1], gap[0]) if np.hypot(gap[0], gap[1]) > 2.0 else otherwise_rad
