"""JSON: records, state and alarms below one topic, and whether the program is online.

Lengths are in m, volumes in m³, masses in t, flows per hour; null: unknown.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from beltscape.core.alarms import Alarm
from beltscape.core.checks import is_dict
from beltscape.core.ledger import BeltRecord
from beltscape.protocols.mqtt.connection import Connection, MqttMessage
from beltscape.protocols.plant import PlantState
from beltscape.protocols.settings import MqttSettings

_MS_NS = 1_000_000
"""Nanoseconds of a millisecond."""
QUALITIES = {"valid": "good", "degraded": "uncertain", "missing": "bad"}
"""Standing of a record → quality of a value, in the words of OPC."""


def format_record(record: BeltRecord) -> str:
    """Return a record; ``number`` counts the ledger's entries without a gap."""
    strip = record.strip
    return _to_json({
        "number": record.number,
        "run": record.run,
        "time_ms": record.wall_ns // _MS_NS,
        "from_m": record.belt_mm[0] * 1e-3,
        "to_m": record.belt_mm[1] * 1e-3,
        "standing": record.standing,
        "quality": QUALITIES[record.standing],
        "reason": record.reason,
        "volume_m3": record.volume_mm3 * 1e-9,
        "sigma_m3": record.sigma_mm3 * 1e-9,
        "mass_t": record.mass_kg * 1e-3,
        "flow_m3_h": None if strip is None else strip.volume_flow_m3_h,
        "speed_m_s": None if strip is None else strip.speed_mm_s * 1e-3,
        "coverage": None if strip is None else strip.coverage,
        "cameras": record.cameras,
        "product": record.product,
        "batch": record.batch or None,
    })  # fmt: skip


def format_state(state: PlantState) -> str:
    """Return the present state with the totals."""
    totals = state.totals
    return _to_json({
        "time_ms": state.wall_ns // _MS_NS,
        "quality": QUALITIES[state.standing],
        "flow_m3_h": state.volume_flow_m3_h,
        "flow_sigma_m3_h": state.volume_flow_sigma_m3_h,
        "flow_t_h": state.mass_flow_t_h,
        "flow_sigma_t_h": state.mass_flow_sigma_t_h,
        "load_mm2": state.area_mm2,
        "coverage": state.coverage,
        "speed_m_s": state.speed_m_s,
        "record": state.record,
        "total": {
            "volume_m3": totals.volume_mm3 * 1e-9,
            "sigma_m3": totals.sigma_mm3 * 1e-9,
            "mass_t": totals.mass_kg * 1e-3,
            "valid_m": totals.valid_mm * 1e-3,
            "degraded_m": totals.degraded_mm * 1e-3,
            "missing_m": totals.missing_mm * 1e-3,
        },
        "cameras": {camera.name: camera.state for camera in state.cameras},
        "maintenance": state.maintenance,
        "product": state.product,
        "batch": state.batch,
    })  # fmt: skip


def format_alarm(alarm: Alarm) -> str:
    """Return an alarm in its present state."""
    return _to_json({
        "name": alarm.name,
        "severity": alarm.severity,
        "state": alarm.state,
        "value": alarm.value,
        "limit": alarm.limit,
        "unit": alarm.unit,
        "since_ms": None if alarm.since_ns is None else alarm.since_ns // _MS_NS,
        "detail": alarm.detail,
        "by": alarm.by,
        "acknowledged_ms": None if alarm.acknowledged_ns is None else alarm.acknowledged_ns // _MS_NS,
        "priority": alarm.priority,
        "group": alarm.group,
        "first": alarm.is_first,
        "isa_state": alarm.isa_state,
        "suppressed_by": "" if alarm.suppression is None else alarm.suppression.reason,
    })  # fmt: skip


def _to_json(values: Mapping[str, Any]) -> str:
    return json.dumps(_without_nan(values), ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _without_nan(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return {key: _without_nan(part) for key, part in value.items()} if is_dict(value) else value


class JsonChannel:
    """One session with the broker; see ``publisher.Channel``."""

    needs_state = False
    republish_after: int | None = None

    def __init__(self, settings: MqttSettings, password: str | None) -> None:
        self._topic = settings.topic
        self._connection = Connection(settings, password, self._make_status("offline"))
        self._alarms: dict[str, str] = {}

    @property
    def is_up(self) -> bool:
        """Return whether the connection stands."""
        return self._connection.is_up

    @property
    def reason(self) -> str:
        """Return why it was lost."""
        return self._connection.reason

    def open(self) -> str:
        """Connect; return why that failed, or an empty text."""
        trouble = self._connection.open()
        if not trouble:
            self._connection.publish(self._make_status("online"))
        return trouble

    def publish_state(self, state: PlantState) -> None:
        """Publish the state, and the alarms that have changed; the broker keeps them."""
        self._connection.publish(MqttMessage(f"{self._topic}/state", format_state(state), qos=0, retain=True))
        for alarm in state.alarms:
            text = format_alarm(alarm)
            if self._alarms.get(alarm.name) != text:
                self._alarms[alarm.name] = text
                topic = f"{self._topic}/alarms/{alarm.name.replace(':', '/')}"
                self._connection.publish(MqttMessage(topic, text, qos=0, retain=True))

    def publish_records(self, records: Sequence[BeltRecord]) -> int:
        """Publish records; return how many of them, from the first on, have arrived."""
        return self._connection.publish_all(
            [MqttMessage(f"{self._topic}/records", format_record(record)) for record in records]
        )

    def close(self) -> None:
        """Say goodbye where the connection still stands, and end."""
        self._connection.close(self._make_status("offline"))

    def _make_status(self, text: str) -> MqttMessage:
        return MqttMessage(f"{self._topic}/status", text, retain=True)
