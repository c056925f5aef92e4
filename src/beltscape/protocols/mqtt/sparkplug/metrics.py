"""The metrics of the device: the present state, the alarms and the newest record of the belt."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isnan, nan

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.protocols.mqtt.payloads import QUALITIES
from beltscape.protocols.mqtt.sparkplug.payload import BAD, GOOD, DataType, Metric, Value
from beltscape.protocols.plant import PlantState

_MS_NS = 1_000_000
"""Nanoseconds of a millisecond."""
HISTORICAL_MS = 10_000
"""A record that is published later than this after it was measured is historical: hosts store it. Chosen."""


@dataclass(frozen=True, slots=True)
class StateMetric:
    """A metric of the present state."""

    type: DataType
    unit: str
    read: Callable[[PlantState], Value]
    is_measured: bool = False
    """Whether it is bad while nothing is measured."""


@dataclass(frozen=True, slots=True)
class RecordMetric:
    """A metric of a record."""

    type: DataType
    unit: str
    read: Callable[[BeltRecord], Value]


STATE: Mapping[str, StateMetric] = {
    "Flow/Volume": StateMetric("Double", "m³/h", lambda s: s.volume_flow_m3_h, is_measured=True),
    "Flow/Volume Sigma": StateMetric("Double", "m³/h", lambda s: s.volume_flow_sigma_m3_h, is_measured=True),
    "Flow/Mass": StateMetric("Double", "t/h", lambda s: s.mass_flow_t_h, is_measured=True),
    "Flow/Mass Sigma": StateMetric("Double", "t/h", lambda s: s.mass_flow_sigma_t_h, is_measured=True),
    "Flow/Quality": StateMetric("String", "", lambda s: QUALITIES[s.standing]),
    "Load/Area": StateMetric("Double", "m²", lambda s: s.area_mm2 * 1e-6, is_measured=True),
    "Load/Coverage": StateMetric("Double", "", lambda s: s.coverage, is_measured=True),
    "Belt/Speed": StateMetric("Double", "m/s", lambda s: s.speed_m_s),
    "Total/Volume": StateMetric("Double", "m³", lambda s: s.totals.volume_mm3 * 1e-9),
    "Total/Volume Sigma": StateMetric("Double", "m³", lambda s: s.totals.sigma_mm3 * 1e-9),
    "Total/Mass": StateMetric("Double", "t", lambda s: s.totals.mass_kg * 1e-3),
    "Total/Valid": StateMetric("Double", "m", lambda s: s.totals.valid_mm * 1e-3),
    "Total/Degraded": StateMetric("Double", "m", lambda s: s.totals.degraded_mm * 1e-3),
    "Total/Missing": StateMetric("Double", "m", lambda s: s.totals.missing_mm * 1e-3),
    "Cameras/All": StateMetric("Int32", "", lambda s: len(s.cameras)),
    "Cameras/OK": StateMetric("Int32", "", lambda s: sum(camera.state == "ok" for camera in s.cameras)),
    "Production/Product": StateMetric("String", "", lambda s: s.product),
    "Production/Batch": StateMetric("String", "", lambda s: s.batch),
    "Maintenance": StateMetric("String", "", lambda s: s.maintenance),
}
"""By name: the metrics of the present state."""
RECORD: Mapping[str, RecordMetric] = {
    "Record/Number": RecordMetric("UInt64", "", lambda r: r.number),
    "Record/Run": RecordMetric("Int64", "", lambda r: r.run),
    "Record/From": RecordMetric("Double", "m", lambda r: r.belt_mm[0] * 1e-3),
    "Record/To": RecordMetric("Double", "m", lambda r: r.belt_mm[1] * 1e-3),
    "Record/Standing": RecordMetric("String", "", lambda r: r.standing),
    "Record/Quality": RecordMetric("String", "", lambda r: QUALITIES[r.standing]),
    "Record/Reason": RecordMetric("String", "", lambda r: r.reason),
    "Record/Volume": RecordMetric("Double", "m³", lambda r: r.volume_mm3 * 1e-9),
    "Record/Sigma": RecordMetric("Double", "m³", lambda r: r.sigma_mm3 * 1e-9),
    "Record/Mass": RecordMetric("Double", "t", lambda r: r.mass_kg * 1e-3),
    "Record/Flow": RecordMetric(
        "Double", "m³/h", lambda r: nan if r.strip is None else r.strip.volume_flow_m3_h
    ),
    "Record/Speed": RecordMetric(
        "Double", "m/s", lambda r: nan if r.strip is None else r.strip.speed_mm_s * 1e-3
    ),
    "Record/Coverage": RecordMetric("Double", "", lambda r: nan if r.strip is None else r.strip.coverage),
    "Record/Cameras": RecordMetric("Int32", "", lambda r: r.cameras),
}
"""By name: the metrics of a record; one message holds those of one record."""
ALARMS = "Alarms/"
"""Begin of the names of alarms, whose values are clear, raised, acknowledged, gone and the like."""
_Sent = tuple[Value, int | None]


class DeviceMetrics:
    """The metrics with their aliases, and what was sent of them, so that data hold changes only."""

    def __init__(self) -> None:
        self._aliases: dict[str, int] = {}
        self._sent: dict[str, _Sent] = {}

    def knows_alarms(self, state: PlantState) -> bool:
        """Return whether the last birth had all alarms of the state; otherwise another birth is due."""
        return all(f"{ALARMS}{alarm.name}" in self._aliases for alarm in state.alarms)

    def make_birth(self, state: PlantState) -> list[Metric]:
        """Return all metrics with names, aliases, units and qualities; those of records are not known yet."""
        time_ms = state.wall_ns // _MS_NS
        self._sent.clear()
        metrics = [
            self._name(name, metric.unit, self._make(name, metric.type, value, quality, time_ms))
            for name, metric, value, quality in _list_state(state)
        ]
        return metrics + [
            Metric(metric.type, None, time_ms, name, self._get_alias(name), quality=BAD, unit=metric.unit)
            for name, metric in RECORD.items()
        ]

    def make_changes(self, state: PlantState) -> list[Metric]:
        """Return the metrics of the state that differ from what was sent."""
        time_ms = state.wall_ns // _MS_NS
        return [
            self._make(name, metric.type, value, quality, time_ms)
            for name, metric, value, quality in _list_state(state)
            if not _is_same(self._sent.get(name), (value, quality))
        ]

    def make_record(self, record: BeltRecord, now_ms: int) -> list[Metric]:
        """Return the metrics of a record, historical where it is published late."""
        time_ms = record.wall_ns // _MS_NS
        is_late = now_ms - time_ms > HISTORICAL_MS
        quality = BAD if record.standing == "missing" else GOOD
        return [
            Metric(
                metric.type,
                metric.read(record),
                time_ms,
                alias=self._get_alias(name),
                is_historical=is_late,
                quality=quality,
            )
            for name, metric in RECORD.items()
        ]

    def _make(self, name: str, kind: DataType, value: Value, quality: int, time_ms: int) -> Metric:
        before = self._sent.get(name)
        self._sent[name] = value, quality
        is_new = before is None or before[1] != quality
        alias = self._get_alias(name)
        return Metric(kind, value, time_ms, alias=alias, quality=quality if is_new else None)

    def _name(self, name: str, unit: str, metric: Metric) -> Metric:
        return Metric(
            metric.type,
            metric.value,
            metric.timestamp_ms,
            name,
            metric.alias,
            quality=metric.quality,
            unit=unit,
        )

    def _get_alias(self, name: str) -> int:
        return self._aliases.setdefault(name, len(self._aliases) + 1)


_ALARM = StateMetric("String", "", lambda _: "")


def _list_state(state: PlantState) -> list[tuple[str, StateMetric, Value, int]]:
    """Return name, metric, value and quality of the state's metrics and alarms."""
    found: list[tuple[str, StateMetric, Value, int]] = []
    for name, metric in STATE.items():
        value = metric.read(state)
        is_bad = _is_nan(value) or (metric.is_measured and state.standing == "missing")
        found.append((name, metric, value, BAD if is_bad else GOOD))
    return found + [(f"{ALARMS}{alarm.name}", _ALARM, alarm.state, GOOD) for alarm in state.alarms]


def _is_same(one: _Sent | None, other: _Sent) -> bool:
    """Return whether value and quality agree; a value that is not known equals another one."""
    if one is None or one[1] != other[1]:
        return False
    return one[0] == other[0] or (_is_nan(one[0]) and _is_nan(other[0]))


def _is_nan(value: Value) -> bool:
    return isinstance(value, float) and isnan(value)
