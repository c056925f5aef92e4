"""The protocols of a project: what they see of the running system, and their start and end beside it."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from math import nan
from pathlib import Path

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import InputError
from beltscape.core.extras import describe_missing_library
from beltscape.files.folders.atomic import write_text
from beltscape.protocols.modbus.settings import ModbusSettings
from beltscape.protocols.mqtt.settings import MqttSettings
from beltscape.protocols.plant import PlantState
from beltscape.service.live_state import LiveState
from beltscape.sinks.historian import Historian

_END_OF_TIME_NS = 1 << 62
"""A time after every record."""


@dataclass(frozen=True, slots=True)
class ProtocolSettings:
    """The protocols' tables of project.toml; None: the protocol is not served."""

    mqtt: MqttSettings | None = None
    modbus: ModbusSettings | None = None


class ServedPlant:
    """The running system as the protocols see it: the live state, the records that are on the disk, and commands."""

    def __init__(
        self, live_state: LiveState, historian: Historian, acknowledge: Callable[[str, str], bool]
    ) -> None:
        """Join them; ``acknowledge`` takes alarm and user and returns whether the alarm waited for it."""
        self._live_state, self._historian, self._acknowledge = live_state, historian, acknowledge

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
            product="",
            batch="",
        )

    def read_records(self, after: int, limit: int) -> Sequence[BeltRecord]:
        """Return at most ``limit`` stored records with numbers above ``after``."""
        return self._historian.records(0, _END_OF_TIME_NS, limit, after)

    def read_last_number(self) -> int:
        """Return the number of the newest stored record; 0 while there is none."""
        return self._historian.ledger_end.number

    def acknowledge(self, alarm: str, user: str) -> None:
        """Acknowledge the alarm of that name; InputError if it does not wait for that."""
        if all(one.name != alarm for one in self._live_state.take_snapshot().alarms):
            raise InputError(f"alarm {alarm!r}: there is no alarm of that name")
        if not self._acknowledge(alarm, user):
            raise InputError(f"alarm {alarm!r}: is not waiting to be acknowledged")

    def start_batch(self, name: str, product: str, user: str) -> None:  # noqa: ARG002
        """Refuse: there are no batches."""
        raise InputError(f"batch {name!r}: this project has no batches")

    def stop_batch(self, user: str) -> None:  # noqa: ARG002
        """Refuse: there are no batches."""
        raise InputError("batch: this project has no batches")

    def change_product(self, name: str, user: str) -> None:  # noqa: ARG002
        """Refuse: there are no products."""
        raise InputError(f"product {name!r}: this project has no products")


@contextmanager
def serve_protocols(
    settings: ProtocolSettings, plant: ServedPlant, data: Path, tell: Callable[[str], None]
) -> Generator[None]:
    """Serve the protocols of the settings until the end of the context, which publishes the last records.

    ``tell`` receives messages of one line.

    Raises
    ------
    InputError
        If a library is missing, a file of the settings cannot be read, or an address cannot be listened on.
    """
    mqtt, modbus = settings.mqtt, settings.modbus
    with ExitStack() as running:
        if modbus is not None:
            from beltscape.protocols.modbus.registers import place_registers, write_csv

            with _name_library("modbus"):
                from beltscape.protocols.modbus.server import ModbusServer
            server = ModbusServer(modbus, plant, data, tell)
            write_text(data / "modbus.csv", write_csv(place_registers(modbus)))
            server.start()
            running.callback(server.close)
        if mqtt is not None:
            with _name_library("mqtt"):
                from beltscape.protocols.mqtt.publisher import Publisher
            publisher = Publisher(mqtt, plant, data, tell)
            publisher.start()
            running.callback(publisher.close)
        yield


def check_mqtt(mqtt: MqttSettings) -> str:
    """Return what would be published; InputError where it cannot be."""
    with _name_library("mqtt"):
        from beltscape.protocols.mqtt.publisher import check_settings
    check_settings(mqtt)
    secured = "TLS" if mqtt.is_encrypted else "without TLS"
    return f"{mqtt.host} port {mqtt.broker_port}, {secured}, topic {mqtt.topic}"


def check_modbus(modbus: ModbusSettings) -> str:
    """Return what would be served; InputError where it cannot be."""
    from beltscape.protocols.modbus.registers import place_registers

    with _name_library("modbus"):
        import_module("pymodbus")
    registers = place_registers(modbus)
    last = registers[-1].address + registers[-1].words - 1
    return f"{modbus.host} port {modbus.port}, registers {registers[0].address} to {last}"


@contextmanager
def _name_library(table: str) -> Generator[None]:
    """Turn the absence of a library into an InputError that names the table and the line to type."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"[{table}]: {describe_missing_library(error) or error}") from error
