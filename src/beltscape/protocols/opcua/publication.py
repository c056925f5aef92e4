"""Writes the present state, the new records and the newest findings to the nodes.

Values have status and source timestamp. The newest finding of every check of the system about itself is a variable
below the belt's health.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from time import time_ns

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from beltscape.core.findings import Finding
from beltscape.core.ledger import BeltRecord
from beltscape.protocols.opcua.address_space import CONVEYING, OWN, Builder, own_id
from beltscape.protocols.opcua.quantities import QUANTITIES, RECORD_QUANTITIES
from beltscape.protocols.opcua.types import make_weight
from beltscape.protocols.plant import Plant, PlantState, Provenance

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BATCH = 200
"""Records that are read at once; all new ones are shown one after the other."""
_STATES = {"NotAvailable": 5134, "OutOfService": 5135, "Executing": 5136, "NotExecuting": 5137}
"""States of the conveyor's state machine and their numbers in OPC 40563-4."""
_STILL_M_S = 0.001
"""Speed below which the belt stands: far below any conveying speed."""


def to_datetime(wall_ns: int) -> datetime:
    """Return a time of the system clock, to 1 µs."""
    return _EPOCH + timedelta(microseconds=wall_ns // 1000)


def make_value(value: float, status: int, wall_ns: int) -> ua.DataValue:
    """Return a number with status and source timestamp."""
    variant = ua.Variant(value, ua.VariantType.Double)
    return ua.DataValue(variant, ua.StatusCode(status), SourceTimestamp=to_datetime(wall_ns))


def make_count(value: int, wall_ns: int) -> ua.DataValue:
    """Return a whole number, 64 bits, with source timestamp."""
    return ua.DataValue(ua.Variant(value, ua.VariantType.UInt64), SourceTimestamp=to_datetime(wall_ns))


class Publication:
    """Shows the plant's state; all values of one update are written before any request is answered."""

    def __init__(
        self, server: InternalServer, plant: Plant, read_provenance: Callable[[], Provenance]
    ) -> None:
        """Show nothing yet; ``read_provenance`` gives what the values come from now."""
        self._server, self._plant, self._read_provenance = server, plant, read_provenance
        self._provenance: Provenance = read_provenance()
        self._record = max(plant.read_last_number() - 1, 0)

    async def update(self, state: PlantState) -> None:
        """Show a state."""
        for path, value in self._list_values(state):
            await self._write(path, value)
        if (provenance := self._read_provenance()) != self._provenance:
            self._provenance = provenance
            for key, text in provenance.items():
                value = ua.DataValue(ua.Variant(text, ua.VariantType.String))
                await self._write(f"Belt.Provenance.{key}", value)

    async def withdraw(self) -> None:
        """Show that the state cannot be read: no value is good that is not known to hold."""
        now_ns = time_ns()
        for quantity in QUANTITIES:
            await self._write(quantity.path, make_value(math.nan, ua.StatusCodes.BadNoCommunication, now_ns))

    def _list_values(self, state: PlantState) -> Iterator[tuple[str, ua.DataValue]]:
        for quantity in QUANTITIES:
            value = quantity.read(state)
            shown = make_value(value, quantity.find_status(state, value), state.wall_ns)
            if quantity.is_weight:
                shown.Value = make_weight(value)
            yield quantity.path, shown
        time = to_datetime(state.wall_ns)
        for path, variant in _list_facts(state):
            yield path, ua.DataValue(variant, SourceTimestamp=time)

    async def show_records(self, _: PlantState) -> None:
        """Write each new record in turn, so that a subscription with a queue misses none."""
        if self._plant.read_last_number() < self._record:  # another ledger
            self._record = 0
        while records := self._plant.read_records(self._record, _BATCH):
            for record in records:
                for path, value in _list_record_values(record):
                    await self._write(path, value)
            self._record = records[-1].number

    async def _write(self, path: str, value: ua.DataValue) -> None:
        await self._server.write_attribute_value(own_id(path), value)


def _list_record_values(record: BeltRecord) -> Iterator[tuple[str, ua.DataValue]]:
    for quantity in RECORD_QUANTITIES:
        value = quantity.read(record)
        if quantity.is_count:
            yield quantity.path, make_count(int(value), record.wall_ns)
        else:
            yield quantity.path, make_value(value, quantity.find_status(record, value), record.wall_ns)


def _list_facts(state: PlantState) -> Iterator[tuple[str, ua.Variant]]:
    """Yield the values without a unit."""
    texts = {"Quality": state.standing, "Maintenance": state.maintenance}
    texts |= {"Product": state.product, "Batch": state.batch}
    for name, text in texts.items():
        yield f"Belt.Monitoring.Status.{name}", ua.Variant(text, ua.VariantType.String)
    active = sum(alarm.state in ("raised", "acknowledged") for alarm in state.alarms)
    waiting = sum(alarm.state in ("raised", "gone") for alarm in state.alarms)
    counts = {
        "Belt.Monitoring.Health.CamerasOk": sum(camera.state == "ok" for camera in state.cameras),
        "Belt.Monitoring.Health.Cameras": len(state.cameras),
        "Belt.Monitoring.Health.Faults": sum(finding.is_fault for finding in state.findings),
        "Belt.Alarms.Active": active,
        "Belt.Alarms.Unacknowledged": waiting,
    }
    for path, count in counts.items():
        yield path, ua.Variant(count, ua.VariantType.UInt32)
    yield "Belt.Totals.Records", ua.Variant(state.totals.records, ua.VariantType.UInt64)
    name = _find_machine_state(state)
    path = "Belt.Monitoring.Status.MachineryItemState.CurrentState"
    yield path, ua.Variant(ua.LocalizedText(name), ua.VariantType.LocalizedText)
    yield f"{path}.Id", ua.Variant(ua.NodeId(_STATES[name], CONVEYING), ua.VariantType.NodeId)


def _find_machine_state(state: PlantState) -> str:
    if state.maintenance:
        return "OutOfService"
    if not math.isfinite(state.speed_m_s):
        return "NotAvailable"
    return "Executing" if abs(state.speed_m_s) > _STILL_M_S else "NotExecuting"


_MOST_FINDINGS = 300
"""Checks that are served, which bounds the address space; a rig of eight cameras has some 60."""


class Findings:
    """One variable for every check, with its limit, σ, unit, and the fault in words."""

    def __init__(self, server: InternalServer, builder: Builder) -> None:
        """Begin without checks; they are added when they are first made."""
        self._server, self._builder = server, builder
        self._shown: dict[str, Finding] = {}

    async def update(self, state: PlantState) -> None:
        """Show the findings that are new or have changed."""
        for finding in state.findings:
            name = f"{finding.check}.{finding.subject}" if finding.subject else finding.check
            if name not in self._shown:
                if len(self._shown) >= _MOST_FINDINGS:
                    continue
                self._add(name)
            elif self._shown[name] is finding:
                continue
            self._shown[name] = finding
            for node, value in _list_finding_values(name, finding).items():
                value.SourceTimestamp = to_datetime(state.wall_ns)
                await self._server.write_attribute_value(own_id(node), value)

    def _add(self, name: str) -> None:
        path = f"Belt.Monitoring.Health.{name}"
        node, parent = own_id(path), own_id("Belt.Monitoring.Health")
        value = ua.Variant(0.0, ua.VariantType.Double)
        self._builder.add_variable(node, parent, ua.QualifiedName(name, OWN), value, text="value of a check")
        for key in ("Sigma", "Limit"):
            self._builder.add_property(own_id(f"{path}.{key}"), node, ua.QualifiedName(key, OWN), value)
        for key in ("Unit", "Fault", "Effect"):
            text = ua.Variant("", ua.VariantType.String)
            self._builder.add_property(own_id(f"{path}.{key}"), node, ua.QualifiedName(key, OWN), text)


def _list_finding_values(name: str, finding: Finding) -> dict[str, ua.DataValue]:
    path = f"Belt.Monitoring.Health.{name}"
    texts = {"Unit": finding.unit, "Fault": str(finding.text), "Effect": finding.effect}
    return {
        path: _make_number(finding.value),
        f"{path}.Sigma": _make_number(finding.sigma),
        f"{path}.Limit": _make_number(finding.limit),
        **{
            f"{path}.{key}": ua.DataValue(ua.Variant(text, ua.VariantType.String))
            for key, text in texts.items()
        },
    }


def _make_number(value: float) -> ua.DataValue:
    """Return a number; its status is bad where it was not measured, or there is none."""
    good, bad = ua.StatusCodes.Good, ua.StatusCodes.BadWaitingForInitialData
    status = ua.StatusCode(good if math.isfinite(value) else bad)
    return ua.DataValue(ua.Variant(value, ua.VariantType.Double), status)
