"""ROS 2 message types and their wire format, without ROS.

A message is a dataclass of ``rosbags``, which knows the definitions that all distributions since Humble share
and serialises them to CDR. ``vision_msgs`` (version 4) and the types of ``foxglove_msgs`` (version 3) that
recordings use, which no base installation has, are added.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

_VISION, _FOXGLOVE = "vision_msgs/msg", "foxglove_msgs/msg"
_VISION_TYPES = {
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": f"{_VISION}/Point2D position\nfloat64 theta",
    "BoundingBox2D": f"{_VISION}/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": (
        f"{_VISION}/ObjectHypothesis hypothesis\ngeometry_msgs/msg/PoseWithCovariance pose"
    ),
    "Detection2D": (
        f"std_msgs/msg/Header header\n{_VISION}/ObjectHypothesisWithPose[] results\n"
        f"{_VISION}/BoundingBox2D bbox\nstring id"
    ),
    "Detection2DArray": f"std_msgs/msg/Header header\n{_VISION}/Detection2D[] detections",
}
_TIMESTAMP = "builtin_interfaces/msg/Time timestamp"
_FOXGLOVE_TYPES = {
    "Point2": "float64 x\nfloat64 y",
    "Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a",
    "CircleAnnotation": (
        f"{_TIMESTAMP}\n{_FOXGLOVE}/Point2 position\nfloat64 diameter\nfloat64 thickness\n"
        f"{_FOXGLOVE}/Color fill_color\n{_FOXGLOVE}/Color outline_color"
    ),
    "PointsAnnotation": (
        f"{_TIMESTAMP}\nuint8 type\n{_FOXGLOVE}/Point2[] points\n{_FOXGLOVE}/Color outline_color\n"
        f"{_FOXGLOVE}/Color[] outline_colors\n{_FOXGLOVE}/Color fill_color\nfloat64 thickness"
    ),
    "TextAnnotation": (
        f"{_TIMESTAMP}\n{_FOXGLOVE}/Point2 position\nstring text\nfloat64 font_size\n"
        f"{_FOXGLOVE}/Color text_color\n{_FOXGLOVE}/Color background_color"
    ),
    "ImageAnnotations": (
        f"{_FOXGLOVE}/CircleAnnotation[] circles\n{_FOXGLOVE}/PointsAnnotation[] points\n"
        f"{_FOXGLOVE}/TextAnnotation[] texts"
    ),
    "GeoJSON": "string geojson",
}


@cache
def typestore() -> Typestore:
    """All known message types."""
    store = get_typestore(Stores.ROS2_KILTED)
    for package, types in ((_VISION, _VISION_TYPES), (_FOXGLOVE, _FOXGLOVE_TYPES)):
        for name, text in types.items():
            store.register(get_types_from_msg(text, f"{package}/{name}"))
    return store


def make(type_name: str, **fields: Any) -> Any:
    """A message such as ``make("geometry_msgs/msg/Point", x=1.0)``; fields not given are zero or empty.

    A message within it, or a list of them, may be given as dictionaries of their fields. Messages share what
    was not given, so nothing in it may be written to.
    """
    message_type, zeros, composed = _parts(type_name)
    for name, kind in composed:
        value = fields.get(name)
        if isinstance(value, dict):
            fields[name] = make(kind[1], **value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            (_, element_type), _ = kind[1]
            fields[name] = [make(element_type, **element) for element in value]
    return message_type(**(zeros | fields))


@cache
def _parts(type_name: str) -> tuple[type, dict[str, Any], list[tuple[str, Any]]]:
    """A message's class, the zeros of its fields, which all messages share, and its composed fields."""
    fields = typestore().fielddefs[type_name][1]
    zeros = {name: _zero(kind) for name, kind in fields}
    return typestore().types[type_name], zeros, [f for f in fields if f[1][0] != Nodetype.BASE]


def to_cdr(message: Any) -> bytes:
    """A message as little-endian CDR, encapsulation header included."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def from_cdr(data: bytes, type_name: str) -> Any:
    """A message from its CDR. Arrays of numbers are read-only views of ``data``."""
    return typestore().deserialize_cdr(data, type_name)


def definition(type_name: str) -> str:
    """The definition of a type and its nested types, as rosbag2 stores it (encoding ``ros2msg``)."""
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


def type_hash(type_name: str) -> str:
    """Version and hash of a type, ``RIHS01_...`` (REP-2011)."""
    return typestore().hash_rihs01(type_name)


def _zero(kind: Any) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return make(detail)
    if node == Nodetype.BASE:
        return {"string": "", "bool": False}.get(detail[0], 0.0 if detail[0].startswith("float") else 0)
    (element, element_detail), length = detail
    if element == Nodetype.BASE and element_detail[0] != "string":
        return np.zeros(length, dtype=element_detail[0])
    return [_zero((element, element_detail)) for _ in range(length)]
