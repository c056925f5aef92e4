"""The protocols of a project: what they see of the running system, and their start and end beside it."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from math import nan
from pathlib import Path

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import InputError
from beltscape.core.extras import describe_missing_library
from beltscape.protocols.mqtt.settings import MqttSettings
from beltscape.protocols.plant import PlantState
from beltscape.service.live_state import LiveState
from beltscape.sinks.historian import Historian

_END_OF_TIME_NS = 1 << 62
"""A time after every record."""


class ServedPlant:
    """The running system as the protocols see it: the live state, and the records that are on the disk."""

    def __init__(self, live_state: LiveState, historian: Historian) -> None:
        self._live_state, self._historian = live_state, historian

    def read_state(self) -> PlantState:
        """Return the present state."""
        now = self._live_state.take_snapshot()
        flow, speed = now.flow, now.frames.speed_mm_s
        is_current = now.frame_age_s < self._live_state.settings.stale_s
        return PlantState(
            wall_ns=now.wall_ns,
            standing=flow.standing if now.maintenance is None else "missing",
            volume_flow_m3_h=flow.volume_m3_h,
            volume_flow_sigma_m3_h=flow.sigma_m3_h,
            mass_flow_t_h=flow.mass_t_h,
            mass_flow_sigma_t_h=flow.mass_sigma_t_h,
            area_mm2=flow.area_mm2,
            coverage=flow.coverage,
            speed_m_s=speed * 1e-3 if is_current else nan,
            record=self.read_last_number(),
            totals=self._historian.totals,
            cameras=now.cameras,
            alarms=now.alarms,
            maintenance="" if now.maintenance is None else now.maintenance.reason,
        )

    def read_records(self, after: int, limit: int) -> Sequence[BeltRecord]:
        """Return at most ``limit`` stored records with numbers above ``after``."""
        return self._historian.records(0, _END_OF_TIME_NS, limit, after)

    def read_last_number(self) -> int:
        """Return the number of the newest stored record; 0 while there is none."""
        return self._historian.ledger_end.number


@contextmanager
def serve_protocols(
    mqtt: MqttSettings | None, live_state: LiveState, historian: Historian, data: Path
) -> Generator[None]:
    """Serve the protocols of the settings until the end of the context, which publishes the last records.

    Raises
    ------
    InputError
        If a library is missing, or a file of the settings cannot be read.
    """
    if mqtt is None:
        yield
        return
    try:
        from beltscape.protocols.mqtt.publisher import Publisher
    except ImportError as error:
        raise InputError(f"[mqtt]: {describe_missing_library(error) or error}") from error
    publisher = Publisher(mqtt, ServedPlant(live_state, historian), data, live_state.on_message)
    publisher.start()
    try:
        yield
    finally:
        publisher.close()


def check_protocols(mqtt: MqttSettings | None) -> str:
    """Return what would be served; InputError where it cannot be."""
    if mqtt is None:
        return "none"
    try:
        from beltscape.protocols.mqtt.publisher import check_settings
    except ImportError as error:
        raise InputError(f"[mqtt]: {describe_missing_library(error) or error}") from error
    check_settings(mqtt)
    secured = "TLS" if mqtt.is_encrypted else "without TLS"
    return f"mqtt to {mqtt.host} port {mqtt.broker_port}, {secured}, topic {mqtt.topic}"
