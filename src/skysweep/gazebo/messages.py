"""The messages of Gazebo Classic's transport that we speak, as protobuf classes made at run time.

Only the fields that we use: protobuf skips the others. Names, numbers and types are Gazebo 11's
(``gazebo/msgs/*.proto``).
"""

from __future__ import annotations

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_Field = descriptor_pb2.FieldDescriptorProto
_SCALARS = {
    "bytes": _Field.TYPE_BYTES,
    "bool": _Field.TYPE_BOOL,
    "double": _Field.TYPE_DOUBLE,
    "int32": _Field.TYPE_INT32,
    "string": _Field.TYPE_STRING,
    "uint32": _Field.TYPE_UINT32,
}
_LABELS = {
    "required": _Field.LABEL_REQUIRED,
    "optional": _Field.LABEL_OPTIONAL,
    "repeated": _Field.LABEL_REPEATED,
}
_PACKAGE = "gazebo.msgs"
_DEFINITIONS = """
Time: required int32 sec = 1, required int32 nsec = 2
Packet: required Time stamp = 1, required string type = 2, required bytes serialized_data = 3
Publish: required string topic = 1, required string msg_type = 2, required string host = 3, \
required uint32 port = 4
Publishers: repeated Publish publisher = 1
Subscribe: required string topic = 1, required string host = 2, required uint32 port = 3, \
required string msg_type = 4, optional bool latching = 5
GzString: required string data = 1
Vector3d: required double x = 1, required double y = 2, required double z = 3
Quaternion: required double x = 2, required double y = 3, required double z = 4, required double w = 5
Pose: optional string name = 1, optional uint32 id = 2, required Vector3d position = 3, \
required Quaternion orientation = 4
Image: required uint32 width = 1, required uint32 height = 2, required uint32 pixel_format = 3, \
required uint32 step = 4, required bytes data = 5
ImageStamped: required Time time = 1, required Image image = 2
"""


def _make_classes() -> dict[str, Any]:
    file = descriptor_pb2.FileDescriptorProto(name="skysweep_gazebo.proto", package=_PACKAGE, syntax="proto2")
    names = []
    for line in _DEFINITIONS.strip().splitlines():
        name, _, fields = line.partition(": ")
        names.append(name)
        message = file.message_type.add(name=name)
        for text in fields.split(", "):
            label, kind, field_name, _, number = text.split()
            field = message.field.add(name=field_name, number=int(number), label=_LABELS[label])
            if kind in _SCALARS:
                field.type = _SCALARS[kind]
            else:
                field.type, field.type_name = _Field.TYPE_MESSAGE, f".{_PACKAGE}.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {n: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{n}")) for n in names}


_CLASSES = _make_classes()
Time, Packet, Publish, Publishers, Subscribe, GzString, Vector3d, Quaternion, Pose, Image, ImageStamped = (
    _CLASSES.values()
)


def type_name(message_class: Any) -> str:
    """The type as the transport names it, such as ``gazebo.msgs.Pose``."""
    return str(message_class.DESCRIPTOR.full_name)


def seconds(time: Any) -> float:
    """A ``Time`` in seconds."""
    return float(time.sec + 1e-9 * time.nsec)
