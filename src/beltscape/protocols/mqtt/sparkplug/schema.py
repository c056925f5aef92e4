"""The protocol buffer of Sparkplug B, the part that is used here: field numbers and types of the specification, §6.4.

It is described at run time, so that no generated code binds the version of the library. Fields that are not listed,
such as data sets and templates, are skipped by a reader.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_PACKAGE = "org.eclipse.tahu.protobuf"
_Field = tuple[int, str, str]
"""Number, name and type of a field; "*" before the type: repeated; "=" before it: of the one value."""
_MESSAGES: Mapping[str, Sequence[_Field]] = {
    "PropertyValue": (
        (1, "type", "uint32"),
        (2, "is_null", "bool"),
        (3, "int_value", "=uint32"),
        (4, "long_value", "=uint64"),
        (5, "float_value", "=float"),
        (6, "double_value", "=double"),
        (7, "boolean_value", "=bool"),
        (8, "string_value", "=string"),
    ),
    "PropertySet": ((1, "keys", "*string"), (2, "values", "*PropertyValue")),
    "Metric": (
        (1, "name", "string"),
        (2, "alias", "uint64"),
        (3, "timestamp", "uint64"),
        (4, "datatype", "uint32"),
        (5, "is_historical", "bool"),
        (6, "is_transient", "bool"),
        (7, "is_null", "bool"),
        (9, "properties", "PropertySet"),
        (10, "int_value", "=uint32"),
        (11, "long_value", "=uint64"),
        (12, "float_value", "=float"),
        (13, "double_value", "=double"),
        (14, "boolean_value", "=bool"),
        (15, "string_value", "=string"),
        (16, "bytes_value", "=bytes"),
    ),
    "Payload": (
        (1, "timestamp", "uint64"),
        (2, "metrics", "*Metric"),
        (3, "seq", "uint64"),
        (4, "uuid", "string"),
        (5, "body", "bytes"),
    ),
}


def _describe_field(message: Any, number: int, name: str, kind: str) -> None:
    field = message.field.add(name=name, number=number)
    proto = descriptor_pb2.FieldDescriptorProto
    field.label = proto.LABEL_REPEATED if kind[0] == "*" else proto.LABEL_OPTIONAL
    if kind[0] == "=":
        field.oneof_index = 0
    kind = kind.lstrip("*=")
    if kind in _MESSAGES:
        field.type, field.type_name = proto.TYPE_MESSAGE, f".{_PACKAGE}.{kind}"
    else:
        field.type = getattr(proto, f"TYPE_{kind.upper()}")


def _make_payload_class() -> Any:
    """Return the class of a payload."""
    file = descriptor_pb2.FileDescriptorProto(
        name="beltscape/sparkplug_b.proto", package=_PACKAGE, syntax="proto2"
    )
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        if any(kind.startswith("=") for _, _, kind in fields):
            message.oneof_decl.add(name="value")
        for number, field, kind in fields:
            _describe_field(message, number, field, kind)
    pool = descriptor_pool.DescriptorPool()  # of its own: another library may have registered the same names
    pool.Add(file)  # pyright: ignore[reportUnknownMemberType, reportAttributeAccessIssue]
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.Payload"))


PayloadMessage: Any = _make_payload_class()
"""A payload: timestamp, metrics, sequence number."""
