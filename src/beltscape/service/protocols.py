"""The protocols of a project: what they see of the running system, and their start and end beside it.

A protocol with sign-in asks for the users of the service, and shows the provenance of its values.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any, Protocol

from beltscape.core.alarms import Alarm
from beltscape.core.errors import BeltscapeError, InputError, OutputError
from beltscape.core.ledger import BeltRecord
from beltscape.files.atomic import write_text
from beltscape.pipeline.live.production import ProductionControl
from beltscape.pipeline.live.project import Project
from beltscape.protocols.plant import PlantState, PlantUsers, Provenance, UserRole
from beltscape.protocols.settings import (
    ModbusSettings,
    MqttSettings,
    OpcUaSettings,
    OutputSettings,
    SyslogSettings,
)
from beltscape.service.access import Access
from beltscape.service.access.accounts import normalise_name
from beltscape.service.live_state import LiveState
from beltscape.service.protocol_checks import name_library
from beltscape.sinks.historian import Historian


class NoUsers:
    """Nobody: a run without access."""

    def find_by_password(self, name: str, password: str, address: str) -> str | None:  # noqa: ARG002
        """Return None."""
        return None

    def has_role(self, user: str, role: UserRole) -> bool:  # noqa: ARG002
        """Return False."""
        return False

    def write_audit(self, action: str, user: str, address: str, detail: Mapping[str, str]) -> None:
        """Write nothing."""


class ServedUsers:
    """The users of the operator's page: one name and password for page and protocols, one throttle, one audit log."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def find_by_password(self, name: str, password: str, address: str) -> str | None:
        """Return the user's stored name; None if name or password is wrong, or there were too many attempts.

        Attempts are counted together with those on the page; each costs some 0.1 s of a core, so they wait.
        """
        kept = normalise_name(name)
        if self._access.throttle.wait_s(kept, address) > 0:
            return None
        try:
            user = self._access.verify_login(name, password, address)
        except BeltscapeError:  # the users cannot be read: nobody enters
            return None
        return None if user is None else user.name

    def has_role(self, user: str, role: UserRole) -> bool:
        """Return whether there is that user, and its present role includes ``role``."""
        if not user:
            return False
        try:
            return self._access.accounts.find(user).has_role(role)
        except BeltscapeError:
            return False

    def write_audit(self, action: str, user: str, address: str, detail: Mapping[str, str]) -> None:
        """Add an entry to the audit log."""
        self._access.audit.write(action, user, address, dict(detail))


def describe_provenance(project: Project[Any]) -> Provenance:
    """Return what the values of a run come from: program, project, rig and belt, the last two by their hash."""
    from beltscape import __version__

    settings = project.settings
    files = {"Rig": project.resolve(settings.rig), "EmptyBelt": project.resolve(settings.empty)}
    texts = {"Program": f"beltscape {__version__}", "Project": str(project.path)}
    for key, path in files.items():
        texts[key] = path.name
        texts[f"{key}Sha256"] = _compute_hash(path)
    return texts


def _compute_hash(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


_END_OF_TIME_NS = 1 << 62
"""A time after every record."""


@dataclass(frozen=True, slots=True)
class ProtocolSettings:
    """The protocols' tables of project.toml; None: the protocol is not served."""

    mqtt: MqttSettings | None = None
    modbus: ModbusSettings | None = None
    opcua: OpcUaSettings | None = None
    syslog: SyslogSettings | None = None
    outputs: OutputSettings | None = None


class ServedPlant:
    """The running system as the protocols see it: the live state, the records that are on the disk, and commands."""

    def __init__(
        self,
        live_state: LiveState,
        historian: Historian,
        acknowledge: Callable[[str, str], bool],
        users: PlantUsers | None = None,
        provenance: Provenance | None = None,
        production: ProductionControl | None = None,
    ) -> None:
        """Join them; ``acknowledge`` takes alarm and user and returns whether the alarm waited for it.

        Without ``users`` nobody can sign in; without ``production`` there are no products and batches.
        """
        self.production = production
        self._live_state, self._historian, self._acknowledge = live_state, historian, acknowledge
        self.users: PlantUsers = users or NoUsers()
        self.provenance: Provenance = provenance or {}

    def read_state(self) -> PlantState:
        """Return the present state."""
        now = self._live_state.take_snapshot()
        flow, speed = now.flow, now.frames.speed_mm_s
        is_current = now.frame_age_s < now.stale_s
        totals = self._historian.totals  # number and totals of one instant
        return PlantState(
            wall_ns=now.wall_ns,
            standing=flow.standing if now.maintenance is None else "missing",
            volume_flow_m3_h=flow.volume_m3_h,
            volume_flow_sigma_m3_h=flow.sigma_m3_h,
            mass_flow_t_h=flow.mass_t_h,
            mass_flow_sigma_t_h=flow.mass_sigma_t_h,
            area_mm2=flow.area_mm2,
            full_area_mm2=now.frames.full_area_mm2,
            coverage=flow.coverage,
            speed_m_s=speed * 1e-3 if is_current else nan,
            record=totals.records,
            totals=totals,
            cameras=now.cameras,
            alarms=now.alarms,
            maintenance="" if now.maintenance is None else now.maintenance.reason,
            largest_lump_mm=now.frames.largest_lump_mm if is_current else nan,
            findings=tuple(check.finding for check in self._live_state.list_checks()),
            product="" if self.production is None else self.production.tag.product,
            batch="" if self.production is None else self.production.batch_name,
            products=() if self.production is None else tuple(one.name for one in self.production.products),
        )

    def follow_alarms(self, follow: Callable[[Sequence[Alarm]], None]) -> Callable[[], None]:
        """Call ``follow`` with all alarms now and after every update; return the function that ends it."""
        followers = self._live_state.alarm_followers
        follow(self._live_state.take_snapshot().alarms)
        followers.append(follow)
        return lambda: followers.remove(follow)

    def read_records(self, after: int, limit: int) -> Sequence[BeltRecord]:
        """Return at most ``limit`` stored records with numbers above ``after``."""
        return self._historian.records(0, _END_OF_TIME_NS, limit, after)

    def read_last_number(self) -> int:
        """Return the number of the newest stored record; 0 while there is none."""
        return self._historian.ledger_end.number

    def read_period(self, since_ns: int, until_ns: int, limit: int, after: int) -> Sequence[BeltRecord]:
        """Return at most ``limit`` records of a period with numbers above ``after``."""
        return self._historian.records(since_ns, until_ns, limit, after)

    def acknowledge(self, alarm: str, user: str) -> None:
        """Acknowledge the alarm of that name; InputError if it does not wait for that."""
        if all(one.name != alarm for one in self._live_state.take_snapshot().alarms):
            raise InputError(f"alarm {alarm!r}: there is no alarm of that name")
        if not self._acknowledge(alarm, user):
            raise InputError(f"alarm {alarm!r}: is not waiting to be acknowledged")

    def start_batch(self, name: str, product: str, user: str) -> None:
        """Start a batch; ``product`` empty: the present product. InputError if it is refused."""
        with self._change() as production:
            production.start_batch(name, product, user)

    def stop_batch(self, user: str) -> None:
        """Stop the present batch; InputError if there is none."""
        with self._change() as production:
            production.stop_batch(user)

    def change_product(self, name: str, user: str) -> None:
        """Make a product the present one; InputError if there is no such product."""
        with self._change() as production:
            production.change_product(name, user)

    @contextmanager
    def _change(self) -> Generator[ProductionControl]:
        """Give the production; what cannot be kept on the disk is refused as well."""
        if self.production is None:
            raise InputError("this system has neither products nor batches")
        try:
            yield self.production
        except OutputError as error:
            raise InputError(f"nothing was changed: {error}") from error


class Served(Protocol):
    """A protocol that is served."""

    def close(self) -> None:
        """Stop serving; a publisher publishes what is stored first."""
        ...


class ServedProtocols:
    """The protocols that are served now; each can be exchanged while the others go on."""

    def __init__(self, plant: ServedPlant, data: Path, tell: Callable[[str], None]) -> None:
        """Serve nothing yet. ``data`` is the folder of what they keep; ``tell`` receives messages of one line."""
        self._plant, self._data, self._tell = plant, data, tell
        self._running: dict[str, Served] = {}

    def serve(self, settings: ProtocolSettings) -> None:
        """Serve the protocols of the settings; those that are served with other settings are exchanged.

        One that the disk refuses what it needs is not served, with a message: measuring does not wait for it.

        Raises
        ------
        InputError
            If a library is missing, a file of the settings cannot be read, or an address cannot be listened on.
        """
        for name in STARTERS:
            try:
                self.exchange(name, getattr(settings, name))
            except OutputError as error:
                self._tell(f"{name}: is not served: {error}")

    def exchange(self, name: str, settings: object | None) -> None:
        """Stop a protocol if it is served, and serve it with these settings; None: it stays stopped.

        Raises
        ------
        InputError
            See ``serve``; the protocol is stopped then.
        """
        served = self._running.pop(name, None)
        if served is not None:
            served.close()
        if settings is not None:
            self._running[name] = STARTERS[name](settings, self._plant, self._data, self._tell)

    def close(self) -> None:
        """Stop all, the last one that was started first."""
        for name in reversed(list(self._running)):
            self._running.pop(name).close()


@contextmanager
def serve_protocols(
    settings: ProtocolSettings, plant: ServedPlant, data: Path, tell: Callable[[str], None]
) -> Generator[ServedProtocols]:
    """Serve the protocols of the settings until the end of the context; see ``ServedProtocols``."""
    with closing(ServedProtocols(plant, data, tell)) as served:
        served.serve(settings)
        yield served


def _start_modbus(
    settings: ModbusSettings, plant: ServedPlant, data: Path, tell: Callable[[str], None]
) -> Served:
    from beltscape.protocols.modbus import ModbusServer, place_commands
    from beltscape.protocols.modbus_registers import place_registers, write_csv

    server = ModbusServer(settings, plant, data, tell, plant, plant.users)
    placed = place_registers(settings)
    try:
        write_text(data / "modbus.csv", write_csv([*placed, *place_commands(settings, placed)]))
    except OutputError as error:  # a list for people, which the server does not need
        tell(f"modbus: the list of registers is not written: {error}")
    server.start()
    return server


def _start_mqtt(
    settings: MqttSettings, plant: ServedPlant, data: Path, tell: Callable[[str], None]
) -> Served:
    with name_library("mqtt"):
        from beltscape.protocols.mqtt.publisher import Publisher
    publisher = Publisher(settings, plant, data, tell)
    publisher.start()
    return publisher


def _start_outputs(
    settings: OutputSettings, plant: ServedPlant, data: Path, tell: Callable[[str], None]
) -> Served:
    with name_library("outputs"):
        from beltscape.protocols.outputs import OutputWriter
    writer = OutputWriter(settings, plant, data, tell)
    writer.start()
    return writer


def _start_opcua(
    settings: OpcUaSettings, plant: ServedPlant, data: Path, tell: Callable[[str], None]
) -> Served:
    with name_library("opcua"):
        from beltscape.protocols.opcua.server import OpcUaServer
    server = OpcUaServer(settings, plant, data, tell)
    server.start()
    return server


def _start_syslog(
    settings: SyslogSettings, plant: ServedPlant, _data: Path, tell: Callable[[str], None]
) -> Served:
    from beltscape.protocols.syslog import SyslogSender, check_settings

    check_settings(settings)
    sender = SyslogSender(settings, tell)
    sender.start()
    return _FollowingSender(sender, plant.follow_alarms(sender.on_alarms))


@dataclass(frozen=True, slots=True)
class _FollowingSender:
    """A sender that gets the plant's alarms until it is closed."""

    sender: Served
    end: Callable[[], None]

    def close(self) -> None:
        """End both."""
        self.end()
        self.sender.close()


STARTERS: Mapping[str, Callable[[Any, ServedPlant, Path, Callable[[str], None]], Served]] = {
    "modbus": _start_modbus,
    "mqtt": _start_mqtt,
    "opcua": _start_opcua,
    "syslog": _start_syslog,
    "outputs": _start_outputs,
}
"""By the name of its table in project.toml: what serves a protocol."""
