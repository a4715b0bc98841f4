"""What flows in a mission as ROS 2 messages, and back.

Frames (REP-103, REP-105): ``map`` is the mission's local ENU; ``odom`` lies on it, because the vehicle's
estimate does not drift; ``base_link`` is the body, FLU; ``gimbal`` has x along the optical axis, y left and
z up; ``camera`` is optical: x right, y down, z forward. Stamps are the vehicle's time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.ros.interfaces import make
from skysweep.types import Detections, Frame, VehicleState

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

MAP, ODOM, BASE, GIMBAL, CAMERA = "map", "odom", "base_link", "gimbal", "camera"

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
DETECTIONS = "vision_msgs/msg/Detection2DArray"
IMAGE = "sensor_msgs/msg/Image"
LOG = "rcl_interfaces/msg/Log"
MARKERS = "visualization_msgs/msg/MarkerArray"
ODOMETRY = "nav_msgs/msg/Odometry"
PATH = "nav_msgs/msg/Path"
TF = "tf2_msgs/msg/TFMessage"

R_CAMERA_TO_GIMBAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

CUBE, SPHERE, CYLINDER, LINE_STRIP, TEXT = 1, 2, 3, 4, 9
_DELETE_ALL = 3
_DISCHARGING = 2
_INFO = 20
_UNKNOWN_VARIANCE = 1e6
_CHANNELS = {"rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1}


@dataclass(frozen=True, slots=True)
class Mark:
    """One thing to draw in ``map``. Lines have points (N, 3), everything else a position (3,)."""

    namespace: str
    id: int
    kind: int  # CUBE, SPHERE, CYLINDER, LINE_STRIP or TEXT
    where_enu_m: F64
    size_m: tuple[float, float, float]
    rgba: tuple[float, float, float, float]
    text: str = ""


def stamp(time_s: float) -> Any:
    """``builtin_interfaces/Time``."""
    seconds, nanoseconds = divmod(round(time_s * 1e9), 10**9)
    return make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def seconds(time: Any) -> float:
    """Seconds of a ``builtin_interfaces/Time``."""
    return float(time.sec + time.nanosec * 1e-9)


def header(time_s: float, frame_id: str) -> Any:
    """``std_msgs/Header``."""
    return make("std_msgs/msg/Header", stamp=stamp(time_s), frame_id=frame_id)


def clock(time_s: float) -> Any:
    """``rosgraph_msgs/Clock``."""
    return make("rosgraph_msgs/msg/Clock", clock=stamp(time_s))


def text(words: str) -> Any:
    """``std_msgs/String``."""
    return make("std_msgs/msg/String", data=words)


def log(time_s: float, words: str) -> Any:
    """``rcl_interfaces/Log`` at the level of information."""
    return make(LOG, stamp=stamp(time_s), level=_INFO, name="skysweep", msg=words)


# ---- where things are --------------------------------------------------------------------------------


def transforms(time_s: float, position_enu_m: F64, R_body_to_enu: F64, camera: CameraPose) -> Any:
    """``tf2_msgs/TFMessage``: odom -> base_link -> gimbal."""
    R_enu_to_body = R_body_to_enu.T
    offset_body_m = R_enu_to_body @ (camera.position_enu_m - position_enu_m)
    R_gimbal_to_body = R_enu_to_body @ camera.R_camera_to_enu @ R_CAMERA_TO_GIMBAL.T
    return make(
        TF,
        transforms=[
            _transform(time_s, ODOM, BASE, position_enu_m, R_body_to_enu),
            _transform(time_s, BASE, GIMBAL, offset_body_m, R_gimbal_to_body),
        ],
    )


def fixed_transforms() -> Any:
    """``tf2_msgs/TFMessage`` for ``/tf_static``: map -> odom and gimbal -> camera."""
    nowhere = np.zeros(3)
    return make(
        TF,
        transforms=[
            _transform(0.0, MAP, ODOM, nowhere, np.eye(3)),
            _transform(0.0, GIMBAL, CAMERA, nowhere, R_CAMERA_TO_GIMBAL),
        ],
    )


def pose_stamped(time_s: float, position_enu_m: ArrayLike, R_body_to_enu: F64) -> Any:
    """``geometry_msgs/PoseStamped`` in ``map``."""
    return make(
        "geometry_msgs/msg/PoseStamped",
        header=header(time_s, MAP),
        pose=_pose(position_enu_m, _quaternion(R_body_to_enu)),
    )


def path(time_s: float, poses: Sequence[Any]) -> Any:
    """``nav_msgs/Path`` through poses of ``pose_stamped``."""
    return make(PATH, header=header(time_s, MAP), poses=list(poses))


def planned_path(waypoints_enu_m: ArrayLike) -> Any:
    """``nav_msgs/Path`` through waypoints (N, 3), level and heading east."""
    waypoints = np.asarray(waypoints_enu_m, dtype=float).reshape(-1, 3)
    return path(0.0, [pose_stamped(0.0, waypoint, np.eye(3)) for waypoint in waypoints])


def odometry(state: VehicleState) -> Any:
    """``nav_msgs/Odometry``: pose of base_link in ``odom``, velocity in base_link."""
    position_variance = min(state.position_std_m**2, _UNKNOWN_VARIANCE)
    return make(
        ODOMETRY,
        header=header(state.time_s, ODOM),
        child_frame_id=BASE,
        pose=make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=_pose(state.position_enu_m, _quaternion(state.R_body_to_enu)),
            covariance=np.diag([position_variance] * 3 + [0.0] * 3).ravel(),
        ),
        twist=make(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=make(
                "geometry_msgs/msg/Twist", linear=_vector(state.R_body_to_enu.T @ state.velocity_enu_mps)
            ),
            covariance=np.diag([0.0] * 3 + [_UNKNOWN_VARIANCE] * 3).ravel(),
        ),
    )


@dataclass(frozen=True, slots=True)
class Pose:
    """What an ``nav_msgs/Odometry`` says, in ENU."""

    position_enu_m: F64  # (3,)
    velocity_enu_mps: F64  # (3,)
    R_body_to_enu: F64  # (3, 3)
    position_std_m: float  # horizontal


def read_odometry(message: Any, source: str) -> Pose:
    """A vehicle's pose. UserError when the frame is neither map nor odom, or a number is not finite."""
    if message.header.frame_id not in (MAP, ODOM):
        raise UserError(
            f"{source}: the odometry is in frame '{message.header.frame_id}'; "
            "publish it in 'map' or 'odom' (ENU)"
        )
    p, q, v = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist.linear
    numbers = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w, v.x, v.y, v.z])
    if not np.isfinite(numbers).all() or not np.any(numbers[3:7]):
        raise UserError(f"{source}: the odometry has a number that is not finite, or no orientation")
    R = np.asarray(Rotation.from_quat(numbers[3:7]).as_matrix())
    variances = np.asarray(message.pose.covariance, dtype=float).reshape(6, 6).diagonal()[:2]
    return Pose(numbers[:3], R @ numbers[7:], R, float(np.sqrt(max(variances.max(), 0.0))))


def fix(time_s: float, lat_lon_alt: ArrayLike) -> Any:
    """``sensor_msgs/NavSatFix`` of base_link: degrees, degrees, metres above the ellipsoid."""
    latitude, longitude, altitude = (float(v) for v in np.asarray(lat_lon_alt, dtype=float))
    return make(
        "sensor_msgs/msg/NavSatFix",
        header=header(time_s, BASE),
        latitude=latitude,
        longitude=longitude,
        altitude=altitude,
    )


def battery(time_s: float, remaining: float) -> Any:
    """``sensor_msgs/BatteryState``: what is left (0..1) and nothing else, which the message calls NaN."""
    unmeasured = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity")
    return make(
        "sensor_msgs/msg/BatteryState",
        header=header(time_s, BASE),
        percentage=remaining,
        power_supply_status=_DISCHARGING,
        present=True,
        **dict.fromkeys(unmeasured, float("nan")),
    )


# ---- pictures and what is in them --------------------------------------------------------------------


def image(frame: Frame) -> Any:
    """``sensor_msgs/Image``, rgb8, in ``camera``."""
    height, width, _ = frame.image.shape
    return make(
        IMAGE,
        header=header(frame.time_s, CAMERA),
        height=height,
        width=width,
        encoding="rgb8",
        step=3 * width,
        data=np.ascontiguousarray(frame.image).reshape(-1),
    )


def read_image(message: Any, source: str) -> U8:
    """The picture (H, W, 3) RGB. UserError naming ``source`` for an encoding or a size that is not right."""
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        raise UserError(
            f"{source}: the encoding '{message.encoding}' is not read; publish one of {', '.join(_CHANNELS)} "
            "(image_proc turns Bayer and YUV pictures into rgb8)"
        )
    height, width, step = message.height, message.width, message.step
    if not height or not width or step < channels * width or len(message.data) < height * step:
        raise UserError(
            f"{source}: the picture says {width}x{height}, step {step}, but brings {len(message.data)} "
            "bytes; mend its publisher"
        )
    rows = np.frombuffer(message.data, np.uint8)[: height * step].reshape(height, step)
    pixels = rows[:, : channels * width].reshape(height, width, channels)
    if channels == 1:
        return np.repeat(pixels, 3, axis=2)
    reversed_colours = message.encoding.startswith(("bgr", "8UC3"))
    return np.ascontiguousarray(pixels[..., 2::-1] if reversed_colours else pixels[..., :3])


def camera_info(time_s: float, lens: Lens) -> Any:
    """``sensor_msgs/CameraInfo`` of a lens without distortion."""
    return make(
        CAMERA_INFO,
        header=header(time_s, CAMERA),
        height=lens.height_px,
        width=lens.width_px,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=lens.K.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack([lens.K, np.zeros(3)]).ravel(),
    )


def detections(found: Detections) -> Any:
    """``vision_msgs/Detection2DArray``: a hypothesis (class, confidence) a box; stamp of the picture."""
    of_picture = header(found.time_s, CAMERA)
    return make(
        DETECTIONS,
        header=of_picture,
        detections=[
            make(
                "vision_msgs/msg/Detection2D",
                header=of_picture,
                results=[
                    make(
                        "vision_msgs/msg/ObjectHypothesisWithPose",
                        hypothesis=make(
                            "vision_msgs/msg/ObjectHypothesis", class_id=name, score=float(confidence)
                        ),
                    )
                ],
                bbox=make(
                    "vision_msgs/msg/BoundingBox2D",
                    center=make(
                        "vision_msgs/msg/Pose2D",
                        position=make("vision_msgs/msg/Point2D", x=float(x0 + x1) / 2, y=float(y0 + y1) / 2),
                    ),
                    size_x=float(x1 - x0),
                    size_y=float(y1 - y0),
                ),
            )
            for (x0, y0, x1, y1), confidence, name in _rows(found)
        ],
    )


def standard_detections(found: Detections) -> Any:
    """The same as ``visualization_msgs/MarkerArray``, for a ROS without vision_msgs.

    The first marker (action DELETEALL) carries the header, also of a picture with nothing in it. Then one
    CUBE a box: ``pose.position`` the centre and ``scale`` the size in pixels, ``text`` the class,
    ``color.a`` the confidence.
    """
    of_picture = header(found.time_s, CAMERA)
    boxes = [
        make(
            "visualization_msgs/msg/Marker",
            header=of_picture,
            ns="detections",
            id=k,
            type=CUBE,
            pose=_pose(((x0 + x1) / 2, (y0 + y1) / 2, 0.0), make("geometry_msgs/msg/Quaternion", w=1.0)),
            scale=_vector((x1 - x0, y1 - y0, 1.0)),
            color=_colour((1.0, 0.6, 0.0, float(confidence))),
            text=name,
        )
        for k, ((x0, y0, x1, y1), confidence, name) in enumerate(_rows(found))
    ]
    start = make("visualization_msgs/msg/Marker", header=of_picture, action=_DELETE_ALL)
    return make(MARKERS, markers=[start, *boxes])


def detections_stamp(message: Any) -> float | None:
    """Time of the picture that a message of either kind answers; None where it does not say."""
    if message.__msgtype__ == DETECTIONS:
        return seconds(message.header.stamp)
    return seconds(message.markers[0].header.stamp) if message.markers else None


def read_detections(message: Any, frame: Frame, source: str) -> Detections:
    """Boxes of either kind for the frame that they belong to; of each box the most confident class.

    Raises UserError for a number that is not finite, a box without size, or a confidence outside 0..1.
    """
    rows: list[tuple[float, float, float, float, float, str]] = []
    if message.__msgtype__ == DETECTIONS:
        for found in message.detections:
            if found.results:
                best = max((r.hypothesis for r in found.results), key=lambda h: h.score)
                at, box = found.bbox.center.position, found.bbox
                rows.append((at.x, at.y, box.size_x, box.size_y, best.score, best.class_id))
    else:
        for found in message.markers:
            if found.action == 0:
                at = found.pose.position
                rows.append((at.x, at.y, found.scale.x, found.scale.y, found.color.a, found.text))
    numbers = np.array([row[:5] for row in rows], dtype=float).reshape(-1, 5)
    centres, sizes, confidences = numbers[:, :2], numbers[:, 2:4], numbers[:, 4]
    in_range = ((confidences >= 0) & (confidences <= 1)).all()
    good = np.isfinite(numbers).all() and (sizes > 0).all() and in_range
    if not good:
        raise UserError(
            f"{source}: a detection has a number that is not finite, a box without size, or a confidence "
            "outside 0..1"
        )
    boxes = np.hstack([centres - sizes / 2, centres + sizes / 2])
    names = tuple(row[5] for row in rows)
    return Detections(frame.time_s, boxes, confidences, names, frame.camera, frame.lens)


# ---- pictures of the mission -------------------------------------------------------------------------


def markers(time_s: float, marks: Iterable[Mark], clear: bool = False) -> Any:
    """``visualization_msgs/MarkerArray`` in ``map``; ``clear`` takes away what was drawn before."""
    drawn = [_marker(time_s, mark) for mark in marks]
    if clear:
        start = make("visualization_msgs/msg/Marker", header=header(time_s, MAP), action=_DELETE_ALL)
        drawn.insert(0, start)
    return make(MARKERS, markers=drawn)


def _marker(time_s: float, mark: Mark) -> Any:
    line = mark.kind == LINE_STRIP
    points = np.asarray(mark.where_enu_m, dtype=float).reshape(-1, 3)
    place = (0.0, 0.0, 0.0) if line else points[0]
    return make(
        "visualization_msgs/msg/Marker",
        header=header(time_s, MAP),
        ns=mark.namespace,
        id=mark.id,
        type=mark.kind,
        pose=_pose(place, make("geometry_msgs/msg/Quaternion", w=1.0)),
        scale=_vector(mark.size_m),
        color=_colour(mark.rgba),
        points=[_point(p) for p in points] if line else [],
        text=mark.text,
    )


def _rows(found: Detections) -> Iterable[tuple[F64, float, str]]:
    return zip(found.boxes_xyxy_px, found.confidences, found.class_names, strict=True)


def _transform(time_s: float, parent: str, child: str, offset_m: F64, R_child_to_parent: F64) -> Any:
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=header(time_s, parent),
        child_frame_id=child,
        transform=make(
            "geometry_msgs/msg/Transform",
            translation=_vector(offset_m),
            rotation=_quaternion(R_child_to_parent),
        ),
    )


def _pose(position: ArrayLike, orientation: Any) -> Any:
    return make("geometry_msgs/msg/Pose", position=_point(position), orientation=orientation)


def _point(v: ArrayLike) -> Any:
    x, y, z = np.asarray(v, dtype=float).tolist()
    return make("geometry_msgs/msg/Point", x=x, y=y, z=z)


def _vector(v: ArrayLike) -> Any:
    x, y, z = np.asarray(v, dtype=float).tolist()
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(R: F64) -> Any:
    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _colour(rgba: tuple[float, float, float, float]) -> Any:
    r, g, b, a = rgba
    return make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a)
