"""Protobuf message classes made at run time from lines of text.

Generated classes need a protobuf library of the same age; these work with any.
"""

from __future__ import annotations

from typing import Any, Literal

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_Field = descriptor_pb2.FieldDescriptorProto


def message_classes(
    package: str, syntax: Literal["proto2", "proto3"], definitions: str
) -> dict[str, type[Any]]:
    """The classes of a package by name.

    Each line defines a message: ``Name: label type field = number, ...`` with a scalar type or a message of
    the same package. Unused fields may be omitted: protobuf skips them.
    """
    file = descriptor_pb2.FileDescriptorProto(name=f"{package}.proto", package=package, syntax=syntax)
    names = []
    for line in definitions.strip().splitlines():
        name, _, fields = line.partition(": ")
        names.append(name)
        message = file.message_type.add(name=name)
        for text in fields.split(", "):
            label, kind, field_name, _, number = text.split()
            field = message.field.add(name=field_name, number=int(number))
            field.label = _Field.Label.Value(f"LABEL_{label.upper()}")
            field.type = getattr(_Field, f"TYPE_{kind.upper()}", _Field.TYPE_MESSAGE)
            if field.type == _Field.TYPE_MESSAGE:
                field.type_name = f".{package}.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {n: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.{n}")) for n in names}
