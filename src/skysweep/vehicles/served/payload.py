"""Gimbal and camera as MAVLink shows them.

The gimbal follows the vehicle's heading. It keeps the scenario's pitch until it is pointed elsewhere, if the
vehicle can do that. Like a gimbal manager it reports its limits and cuts requests to them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from skysweep.scenarios.model import GIMBAL_PITCH_DEG, CameraModel
from skysweep.types import VehicleState
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import AUTOPILOT, quaternion
from skysweep.vehicles.mavlink.wire import Message

_DEVICE = 1  # a gimbal that is part of the autopilot's component
_SENSOR_WIDTH_MM = 6.3
_FLAGS = m.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | m.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
_IN_VEHICLE_FRAME = m.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
_FIXED = 0.0, 0.0  # limits of roll and yaw
_ITSELF, _LEAVE, _RELEASE = -2.0, -1.0, -3.0  # ids in DO_GIMBAL_MANAGER_CONFIGURE


class Payload:
    """Messages about gimbal and camera, and the control of the gimbal.

    ``look`` points it to a pitch in rad; None if the vehicle cannot.
    """

    def __init__(self, camera: CameraModel, look: Callable[[float], None] | None, system_id: int) -> None:
        self._camera, self._look, self._system_id = camera, look, system_id
        pitch = camera.gimbal.pitch_deg
        self._limits_rad = tuple(map(math.radians, (pitch, pitch) if look is None else GIMBAL_PITCH_DEG))
        self.control = (0, 0)  # system and component in control

    def configure(self, params: tuple[float, ...], sender: tuple[int, int]) -> bool:
        """DO_GIMBAL_MANAGER_CONFIGURE: gives or releases control. As in PX4, "itself" is the vehicle."""
        system, component = params[0], params[1]
        if (system, component) == (_ITSELF, _ITSELF):
            self.control = self._system_id, AUTOPILOT
        elif (system, component) == (_RELEASE, _RELEASE):
            self.control = (0, 0) if self.control == sender else self.control
        elif 0.0 <= system <= 255.0 and 0.0 <= component <= 255.0:
            self.control = (int(system), int(component))
        else:
            return (system, component) == (_LEAVE, _LEAVE)
        return True

    def point(self, pitch_deg: float, sender: tuple[int, int]) -> bool:
        """DO_GIMBAL_MANAGER_PITCHYAW: points it; NaN leaves it. False if the sender is not in control."""
        if self.control != sender:
            return False
        if self._look is not None and math.isfinite(pitch_deg):
            low, high = self._limits_rad
            self._look(min(max(math.radians(pitch_deg), low), high))
        return True

    def manager_information(self, boot_ms: int) -> Message:
        can = (
            m.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS
            | m.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_LOCK
            | m.GIMBAL_MANAGER_CAP_FLAGS_HAS_ROLL_LOCK
            | m.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_FOLLOW
        )
        return m.MAVLink_gimbal_manager_information_message(
            boot_ms, can, _DEVICE, *_FIXED, *self._limits_rad, *_FIXED
        )

    def manager_status(self, boot_ms: int) -> Message:
        return m.MAVLink_gimbal_manager_status_message(boot_ms, _FLAGS, _DEVICE, *self.control, 0, 0)

    def device_information(self, boot_ms: int) -> Message:
        names, versions = (b"skysweep", b"embedded", b""), (0, 0, 0)
        can = m.GIMBAL_DEVICE_CAP_FLAGS_HAS_PITCH_AXIS | m.GIMBAL_DEVICE_CAP_FLAGS_HAS_YAW_FOLLOW
        return m.MAVLink_gimbal_device_information_message(
            boot_ms, *names, *versions, can, 0, *_FIXED, *self._limits_rad, *_FIXED, _DEVICE
        )

    def gimbal_attitude(self, state: VehicleState, boot_ms: int) -> Message:
        """The estimated attitude of the camera: pitch about the horizon, yaw from the vehicle's nose."""
        R, body = state.camera.R_camera_to_enu, state.R_body_to_enu
        yaw_enu = math.atan2(R[0, 0], -R[1, 0])
        turn = math.remainder(math.atan2(body[1, 0], body[0, 0]) - yaw_enu, 2.0 * math.pi)
        q = quaternion(0.0, state.camera.pitch_rad, turn)
        return m.MAVLink_gimbal_device_attitude_status_message(
            0, 0, boot_ms, _FLAGS | _IN_VEHICLE_FRAME, q, 0.0, 0.0, 0.0, 0, 0.0, 0.0, _DEVICE
        )

    def camera_heartbeat(self) -> Message:
        kind = m.MAV_TYPE_CAMERA, m.MAV_AUTOPILOT_INVALID
        return m.MAVLink_heartbeat_message(*kind, 0, 0, m.MAV_STATE_ACTIVE, 3)

    def camera_information(self, boot_ms: int) -> Message:
        lens, width_mm = self._camera.lens, _SENSOR_WIDTH_MM
        names, resolution_px = (_padded("skysweep"), _padded("embedded")), (lens.width_px, lens.height_px)
        focal_mm, height_mm = (width_mm * px / lens.width_px for px in (lens.focal_px, lens.height_px))
        return m.MAVLink_camera_information_message(
            boot_ms, *names, 1, focal_mm, width_mm, height_mm, *resolution_px, 0, 0, 0, b""
        )


def _padded(text: str) -> list[int]:
    return list(text.encode().ljust(32, b"\x00"))
