"""ROS 2 message types and their wire format, without ROS.

A message is a dataclass of ``rosbags``, which knows the definitions that all distributions since Humble share
and serialises them to CDR. ``vision_msgs`` (version 4), which no base installation has, is added.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

_VISION = "vision_msgs/msg"
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


@cache
def typestore() -> Typestore:
    """All known message types."""
    store = get_typestore(Stores.ROS2_KILTED)
    for name, text in _VISION_TYPES.items():
        store.register(get_types_from_msg(text, f"{_VISION}/{name}"))
    return store


def make(type_name: str, **fields: Any) -> Any:
    """A message such as ``make("geometry_msgs/msg/Point", x=1.0)``; fields not given are zero or empty.

    A message within it, or a list of them, may be given as dictionaries of their fields.
    """
    message_type, plain, composed = _parts(type_name)
    for name, kind in composed:
        if name not in fields:
            fields[name] = _zero(kind)
        elif isinstance(value := fields[name], dict):
            fields[name] = make(kind[1], **value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            (_, element_type), _ = kind[1]
            fields[name] = [make(element_type, **element) for element in value]
    return message_type(**(plain | fields))


@cache
def _parts(type_name: str) -> tuple[type, dict[str, Any], list[tuple[str, Any]]]:
    """A message's class, the zeros of its numbers and strings, and its other fields."""
    fields = typestore().fielddefs[type_name][1]
    plain = {name: _zero(kind) for name, kind in fields if kind[0] == Nodetype.BASE}
    return typestore().types[type_name], plain, [field for field in fields if field[0] not in plain]


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
