"""A mission's values as ROS 2 messages, and back.

Frames (REP-103, REP-105): ``map`` is the mission's local ENU; ``odom`` equals ``map``, because the vehicle's
estimate does not drift; ``base_link`` is the body, FLU; ``gimbal`` has x along the optical axis, y left and
z up; ``camera`` is optical: x right, y down, z forward. Stamps are the vehicle's time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.ros.interfaces import make, to_cdr
from skysweep.types import F64, U8, Detections, Frame, VehicleState

Fields = dict[str, Any]

MAP, ODOM, BASE, GIMBAL, CAMERA = "map", "odom", "base_link", "gimbal", "camera"

ANNOTATIONS = "foxglove_msgs/msg/ImageAnnotations"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
DETECTIONS = "vision_msgs/msg/Detection2DArray"
GEOJSON = "foxglove_msgs/msg/GeoJSON"
IMAGE = "sensor_msgs/msg/Image"
LOG = "rcl_interfaces/msg/Log"
MARKER = "visualization_msgs/msg/Marker"
MARKERS = "visualization_msgs/msg/MarkerArray"
ODOMETRY = "nav_msgs/msg/Odometry"
PATH = "nav_msgs/msg/Path"
TF = "tf2_msgs/msg/TFMessage"

R_CAMERA_TO_GIMBAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

CUBE, SPHERE, CYLINDER, LINE_STRIP, TEXT = 1, 2, 3, 4, 9
_DELETE_ALL = 3
_DISCHARGING = 2
_INFO = 20
_LINE_LOOP = 2
_UNKNOWN_VARIANCE = 1e6
_CHANNELS = {"rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1}


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """A shape to draw in a frame. Lines have points (N, 3), all others a position (3,).

    One that is drawn again and again costs little.
    """

    namespace: str
    id: int
    kind: int  # CUBE, SPHERE, CYLINDER, LINE_STRIP or TEXT
    where_m: F64
    size_m: tuple[float, float, float]
    rgba: tuple[float, float, float, float]
    text: str = ""
    frame: str = MAP


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
    """``rcl_interfaces/Log`` of level INFO."""
    return make(LOG, stamp=stamp(time_s), level=_INFO, name="skysweep", msg=words)


# ---- poses -------------------------------------------------------------------------------------------


def transforms(time_s: float, position_enu_m: F64, R_body_to_enu: F64, camera: CameraPose) -> Any:
    """``tf2_msgs/TFMessage``: odom -> base_link -> gimbal."""
    R_enu_to_body = R_body_to_enu.T
    offset_body_m = R_enu_to_body @ (camera.position_enu_m - position_enu_m)
    R_gimbal_to_body = R_enu_to_body @ camera.R_camera_to_enu @ R_CAMERA_TO_GIMBAL.T
    body, gimbal = _quaternions(np.stack([R_body_to_enu, R_gimbal_to_body]))
    return make(
        TF,
        transforms=[
            _transform(time_s, ODOM, BASE, position_enu_m, body),
            _transform(time_s, BASE, GIMBAL, offset_body_m, gimbal),
        ],
    )


def fixed_transforms() -> Any:
    """``tf2_msgs/TFMessage`` for ``/tf_static``: map -> odom and gimbal -> camera."""
    odom, camera = _quaternions(np.stack([np.eye(3), R_CAMERA_TO_GIMBAL]))
    return make(
        TF,
        transforms=[
            _transform(0.0, MAP, ODOM, np.zeros(3), odom),
            _transform(0.0, GIMBAL, CAMERA, np.zeros(3), camera),
        ],
    )


def pose_stamped(time_s: float, position_enu_m: ArrayLike, R_body_to_enu: F64) -> Any:
    """``geometry_msgs/PoseStamped`` in ``map``."""
    pose = {"position": _xyz(position_enu_m), "orientation": _quaternion(R_body_to_enu)}
    return make("geometry_msgs/msg/PoseStamped", header=header(time_s, MAP), pose=pose)


def path(time_s: float, poses: Sequence[Any]) -> Any:
    """``nav_msgs/Path`` through poses of ``pose_stamped``."""
    return make(PATH, header=header(time_s, MAP), poses=list(poses))


class GrowingPath:
    """The CDR of a ``nav_msgs/Path`` that grows, of which a pose is encoded once."""

    def __init__(self) -> None:
        self.length = 0
        self._first: list[Any] = []
        self._newest: list[Any] = []
        self._encoded = bytearray()  # poses after the first

    def add(self, pose: Any) -> None:
        """Add a pose of ``pose_stamped``."""
        (self._newest if self.length else self._first).append(pose)
        self.length += 1

    def cdr(self, time_s: float) -> bytes:
        """The whole path. Poses after the first have the same bytes in a path of any length."""
        start = to_cdr(path(time_s, self._first))
        self._encoded += to_cdr(path(time_s, self._first + self._newest))[len(start) :]
        self._newest = []
        length_ends = len(to_cdr(path(time_s, [])))
        length = self.length.to_bytes(4, "little")
        return start[: length_ends - 4] + length + start[length_ends:] + self._encoded


def planned_path(waypoints_enu_m: F64) -> Any:
    """``nav_msgs/Path`` through waypoints (N, 3), level and heading east."""
    return path(0.0, [pose_stamped(0.0, waypoint, np.eye(3)) for waypoint in waypoints_enu_m])


def odometry(state: VehicleState) -> Any:
    """``nav_msgs/Odometry``: pose of base_link in ``odom``, velocity in base_link."""
    R = state.R_body_to_enu
    position_variance = min(state.position_std_m**2, _UNKNOWN_VARIANCE)
    return make(
        ODOMETRY,
        header=header(state.time_s, ODOM),
        child_frame_id=BASE,
        pose={
            "pose": {"position": _xyz(state.position_enu_m), "orientation": _quaternion(R)},
            "covariance": np.diag([position_variance] * 3 + [0.0] * 3).ravel(),
        },
        twist={
            "twist": {"linear": _xyz(R.T @ state.velocity_enu_mps)},
            "covariance": np.diag([0.0] * 3 + [_UNKNOWN_VARIANCE] * 3).ravel(),
        },
    )


@dataclass(frozen=True, slots=True)
class Pose:
    """The content of a ``nav_msgs/Odometry``, in ENU."""

    position_enu_m: F64  # (3,)
    velocity_enu_mps: F64  # (3,)
    R_body_to_enu: F64  # (3, 3)
    position_std_m: float  # horizontal


def read_odometry(message: Any, source: str) -> Pose:
    """A vehicle's pose. Raises UserError if the frame is neither map nor odom, or a number is not finite."""
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


def fix(time_s: float, lat_lon_alt: F64) -> Any:
    """``sensor_msgs/NavSatFix`` of base_link at a place (3,): degrees, degrees, metres above mean sea level.

    The message's altitude would be above the WGS 84 ellipsoid, which is unknown here: it is NaN.
    """
    latitude, longitude, _ = lat_lon_alt.tolist()
    place = {"latitude": latitude, "longitude": longitude, "altitude": float("nan")}
    return make("sensor_msgs/msg/NavSatFix", header=header(time_s, BASE), **place)


def battery(time_s: float, remaining: float) -> Any:
    """``sensor_msgs/BatteryState``: the remaining share (0..1); every other measurement is NaN."""
    unmeasured = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity")
    return make(
        "sensor_msgs/msg/BatteryState",
        header=header(time_s, BASE),
        percentage=remaining,
        power_supply_status=_DISCHARGING,
        present=True,
        **dict.fromkeys(unmeasured, float("nan")),
    )


# ---- pictures and detections -------------------------------------------------------------------------


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


def compressed_image(time_s: float, jpeg: bytes, frame_id: str = CAMERA) -> Any:
    """``sensor_msgs/CompressedImage`` of a JPEG."""
    data = np.frombuffer(jpeg, np.uint8)
    return make(COMPRESSED_IMAGE, header=header(time_s, frame_id), format="jpeg", data=data)


def read_image(message: Any, source: str) -> U8:
    """The picture (H, W, 3) RGB. Raises UserError for an unsupported encoding or an inconsistent size."""
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        raise UserError(
            f"{source}: the encoding '{message.encoding}' is not supported; publish one of "
            f"{', '.join(_CHANNELS)} (image_proc turns Bayer and YUV pictures into rgb8)"
        )
    height, width, step = message.height, message.width, message.step
    if not height or not width or step < channels * width or len(message.data) < height * step:
        raise UserError(
            f"{source}: the picture says {width}x{height}, step {step}, but has {len(message.data)} bytes; "
            "fix its publisher"
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
    """``vision_msgs/Detection2DArray``: one hypothesis (class, confidence) per box; stamp of the picture."""
    of_picture = header(found.time_s, CAMERA)
    boxes = []
    for (x0, y0, x1, y1), confidence, name in _rows(found):
        centre = {"x": (x0 + x1) / 2, "y": (y0 + y1) / 2}
        boxes.append(
            {
                "header": of_picture,
                "results": [{"hypothesis": {"class_id": name, "score": confidence}}],
                "bbox": {"center": {"position": centre}, "size_x": x1 - x0, "size_y": y1 - y0},
            }
        )
    return make(DETECTIONS, header=of_picture, detections=boxes)


def standard_detections(found: Detections) -> Any:
    """The same as ``visualization_msgs/MarkerArray``, for a ROS without vision_msgs.

    The first marker (action DELETEALL) carries the header, even if no box follows. Then one CUBE per box:
    ``pose.position`` is the centre and ``scale`` the size in pixels, ``text`` the class, ``color.a`` the
    confidence.
    """
    of_picture = header(found.time_s, CAMERA)
    boxes = [
        {
            "header": of_picture,
            "ns": "detections",
            "id": k,
            "type": CUBE,
            "pose": _level(((x0 + x1) / 2, (y0 + y1) / 2, 0.0)),
            "scale": _xyz((x1 - x0, y1 - y0, 1.0)),
            "color": _colour((1.0, 0.6, 0.0, confidence)),
            "text": name,
        }
        for k, ((x0, y0, x1, y1), confidence, name) in enumerate(_rows(found))
    ]
    return make(MARKERS, markers=[{"header": of_picture, "action": _DELETE_ALL}, *boxes])


def image_annotations(
    time_s: float, boxes_xyxy_px: F64, labels: Sequence[str], rgba: tuple[float, float, float, float]
) -> Any:
    """``foxglove_msgs/ImageAnnotations``: boxes (N, 4) of the picture exposed at ``time_s``, with labels.

    A viewer finds the picture by the time of its annotations, and shows none without: where there is no box,
    an outline without points carries the time.
    """
    when, texts = stamp(time_s), []
    outlines: list[dict[str, Any]] = [] if len(boxes_xyxy_px) else [{"timestamp": when}]
    for (x0, y0, x1, y1), label in zip(boxes_xyxy_px.tolist(), labels, strict=True):
        corners = [{"x": x, "y": y} for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        outline = {"type": _LINE_LOOP, "points": corners, "outline_color": _colour(rgba), "thickness": 1.5}
        outlines.append({"timestamp": when} | outline)
        texts.append(
            {
                "timestamp": when,
                "position": corners[0],
                "text": label,
                "font_size": 12.0,
                "text_color": _colour((1.0, 1.0, 1.0, 1.0)),
                "background_color": _colour((0.0, 0.0, 0.0, 0.6)),
            }
        )
    return make(ANNOTATIONS, points=outlines, texts=texts)


def detections_stamp(message: Any) -> float | None:
    """Time of the picture that a message of either form answers; None if it carries no time."""
    if message.__msgtype__ == DETECTIONS:
        return seconds(message.header.stamp)
    return seconds(message.markers[0].header.stamp) if message.markers else None


def read_detections(message: Any, frame: Frame, source: str) -> Detections:
    """Boxes of either form as detections of ``frame``, each with its most confident class.

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
    if not (np.isfinite(numbers).all() and (sizes > 0).all() and in_range):
        raise UserError(
            f"{source}: a detection has a number that is not finite, a box without size, or a confidence "
            "outside 0..1"
        )
    boxes = np.hstack([centres - sizes / 2, centres + sizes / 2])
    names = tuple(row[5] for row in rows)
    return Detections(frame.time_s, boxes, confidences, names, frame.camera, frame.lens)


# ---- drawings ----------------------------------------------------------------------------------------


def markers(time_s: float, marks: Iterable[Mark], clear: bool = False) -> Any:
    """``visualization_msgs/MarkerArray``; ``clear`` removes what was drawn before."""
    marks = list(marks)
    headers = {frame: header(time_s, frame) for frame in (MAP, *(mark.frame for mark in marks))}
    drawn = [replace(_marker(mark), header=headers[mark.frame]) for mark in marks]
    start = [make(MARKER, header=headers[MAP], action=_DELETE_ALL)] if clear else []
    return make(MARKERS, markers=[*start, *drawn])


@lru_cache(maxsize=4096)
def _marker(mark: Mark) -> Any:
    line = mark.kind == LINE_STRIP
    return make(
        MARKER,
        ns=mark.namespace,
        id=mark.id,
        type=mark.kind,
        pose=_level((0.0, 0.0, 0.0) if line else mark.where_m),
        scale=_xyz(mark.size_m),
        color=_colour(mark.rgba),
        points=[_xyz(point) for point in mark.where_m] if line else [],
        text=mark.text,
        frame_locked=True,
    )


def _rows(found: Detections) -> Iterable[tuple[list[float], float, str]]:
    return zip(found.boxes_xyxy_px.tolist(), found.confidences.tolist(), found.class_names, strict=True)


def _transform(time_s: float, parent: str, child: str, offset_m: F64, child_to_parent: Fields) -> Fields:
    turn = {"translation": _xyz(offset_m), "rotation": child_to_parent}
    return {"header": header(time_s, parent), "child_frame_id": child, "transform": turn}


def _level(position: ArrayLike) -> Fields:
    return {"position": _xyz(position), "orientation": {"w": 1.0}}


def _xyz(vector: ArrayLike) -> Fields:
    x, y, z = np.asarray(vector, dtype=float).tolist()
    return {"x": x, "y": y, "z": z}


def _quaternion(R: F64) -> Fields:
    return _quaternions(R[None])[0]


def _quaternions(R: F64) -> list[Fields]:
    """Of rotations (N, 3, 3)."""
    return [dict(zip("xyzw", q, strict=True)) for q in Rotation.from_matrix(R).as_quat().tolist()]


def _colour(rgba: tuple[float, float, float, float]) -> Fields:
    return dict(zip("rgba", rgba, strict=True))
