"""Payloads of Sparkplug B: metrics with their times and qualities, as bytes.

The protocol buffer has the part of the specification that is used here, with its field numbers and types (§6.4). It
is described at run time, so that no generated code binds the version of the library. Fields that are not listed,
such as data sets and templates, are skipped by a reader.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

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
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.Payload"))


PayloadMessage: Any = _make_payload_class()
"""A payload: timestamp, metrics, sequence number."""

Value = float | int | bool | str | None
DataType = Literal["Int32", "Int64", "UInt64", "Double", "Boolean", "String"]
_CODES: Mapping[DataType, int] = {
    "Int32": 3,
    "Int64": 4,
    "UInt64": 8,
    "Double": 10,
    "Boolean": 11,
    "String": 12,
}
_FIELDS: Mapping[DataType, str] = {
    "Int32": "int_value",
    "Int64": "long_value",
    "UInt64": "long_value",
    "Double": "double_value",
    "Boolean": "boolean_value",
    "String": "string_value",
}
_WRAPS = {"int_value": 1 << 32, "long_value": 1 << 64}
"""Negative numbers are sent as the two's complement in an unsigned field."""
GOOD, BAD = 192, 0
"""Values of the property Quality (specification, §6.4.14); it has no value between them."""


@dataclass(frozen=True, slots=True)
class Metric:
    """One value of a payload."""

    type: DataType
    value: Value
    """None, or NaN: not known."""
    timestamp_ms: int
    name: str = ""
    """Empty in data, where the alias stands for it."""
    alias: int | None = None
    is_historical: bool = False
    quality: int | None = None
    """GOOD or BAD; None: it is as before."""
    unit: str = ""
    """Engineering unit; given at birth."""


def encode(timestamp_ms: int, metrics: Iterable[Metric], seq: int | None = None) -> bytes:
    """Return a payload."""
    payload: Any = PayloadMessage(timestamp=timestamp_ms)
    if seq is not None:
        payload.seq = seq
    for metric in metrics:
        _fill(payload.metrics.add(), metric)
    return payload.SerializeToString()


def _fill(message: Any, metric: Metric) -> None:
    if metric.name:
        message.name = metric.name
    if metric.alias is not None:
        message.alias = metric.alias
    message.timestamp, message.datatype = metric.timestamp_ms, _CODES[metric.type]
    if metric.is_historical:
        message.is_historical = True
    value, field = metric.value, _FIELDS[metric.type]
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        message.is_null = True
    else:
        wrap = _WRAPS.get(field)
        setattr(message, field, value if wrap is None else int(value) % wrap)
    if metric.quality is not None:
        _add_property(message.properties, "Quality", "Int32", metric.quality)
    if metric.unit:
        _add_property(message.properties, "engUnit", "String", metric.unit)


def _add_property(properties: Any, key: str, kind: DataType, value: int | str) -> None:
    properties.keys.append(key)
    entry = properties.values.add(type=_CODES[kind])
    setattr(entry, _FIELDS[kind], value)


def is_rebirth(data: bytes) -> bool:
    """Return whether a command asks for births; False for anything that is none."""
    payload: Any = PayloadMessage()
    try:
        payload.ParseFromString(data)
    except DecodeError:
        return False
    return any(
        metric.name == REBIRTH and metric.WhichOneof("value") == "boolean_value" and metric.boolean_value
        for metric in payload.metrics
    )


REBIRTH = "Node Control/Rebirth"
"""Name of the command that every edge node has."""
