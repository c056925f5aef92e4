"""Payloads: metrics with their times and qualities, as bytes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from google.protobuf.message import DecodeError

from beltscape.protocols.mqtt.sparkplug.schema import PayloadMessage

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
