"""Protobuf message classes made at run time from lines of text.

Generated classes demand a protobuf library of their own age; these go with any.
"""

from __future__ import annotations

from typing import Any, Literal

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_Field = descriptor_pb2.FieldDescriptorProto
_SCALARS = {
    "bytes": _Field.TYPE_BYTES,
    "bool": _Field.TYPE_BOOL,
    "double": _Field.TYPE_DOUBLE,
    "int32": _Field.TYPE_INT32,
    "int64": _Field.TYPE_INT64,
    "string": _Field.TYPE_STRING,
    "uint32": _Field.TYPE_UINT32,
}
_LABELS = {
    "required": _Field.LABEL_REQUIRED,
    "optional": _Field.LABEL_OPTIONAL,
    "repeated": _Field.LABEL_REPEATED,
}


def message_classes(
    package: str, syntax: Literal["proto2", "proto3"], definitions: str
) -> dict[str, type[Any]]:
    """The classes of a package by name.

    A line defines a message: ``Name: label type field = number, ...`` with a scalar type or a message of the
    same package. Only the fields that are used need be there: protobuf skips the others.
    """
    file = descriptor_pb2.FileDescriptorProto(name=f"{package}.proto", package=package, syntax=syntax)
    names = []
    for line in definitions.strip().splitlines():
        name, _, fields = line.partition(": ")
        names.append(name)
        message = file.message_type.add(name=name)
        for text in fields.split(", "):
            label, kind, field_name, _, number = text.split()
            field = message.field.add(name=field_name, number=int(number), label=_LABELS[label])
            if kind in _SCALARS:
                field.type = _SCALARS[kind]
            else:
                field.type, field.type_name = _Field.TYPE_MESSAGE, f".{package}.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {n: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.{n}")) for n in names}
