"""Alarms as conditions (OPC 10000-9): an object for each, an event at each change, acknowledgement, refresh.

The library carries events of AlarmConditionType, ConditionRefresh and the method Acknowledge. It carries no branches,
no shelving and no comments; those are done on the operator's page.
"""

from __future__ import annotations

import math
import uuid
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.server.event_generator import EventGenerator
from asyncua.server.internal_server import InternalServer

from beltscape.core.alarms import Alarm
from beltscape.protocols.opcua.address_space import OWN, Builder, own_id
from beltscape.protocols.opcua.commands import CommandMethods
from beltscape.protocols.opcua.publication import to_datetime
from beltscape.protocols.plant import PlantState

_SEVERITIES = {"info": 200, "warning": 500, "critical": 800}
"""Severity of events: the middle of the ranges low, medium and high (OPC 10000-9, table of severities)."""
_ACTIVE, _ACKED = ("raised", "acknowledged"), ("clear", "acknowledged", "latched")
_ON = {True: "Active", False: "Inactive"}
_SEEN = {True: "Acknowledged", False: "Unacknowledged"}


@dataclass(slots=True)
class _Condition:
    """One alarm's object and its last event."""

    node: ua.NodeId
    generator: EventGenerator
    alarm: Alarm | None = None

    @property
    def event_id(self) -> bytes | None:
        """Return the identifier of the last event; None before the first."""
        identifier: Any = self.generator.event.EventId
        return getattr(identifier, "Value", identifier)


class Conditions:
    """The conditions of all alarms; an alarm that was not known becomes a new one."""

    def __init__(self, server: InternalServer, builder: Builder, commands: CommandMethods) -> None:
        """Add the method of acknowledgement."""
        self._server, self._builder, self._commands = server, builder, commands
        self._conditions: dict[str, _Condition] = {}
        method = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
        server.isession.add_method_callback(method, self._acknowledge)

    async def update(self, state: PlantState) -> None:
        """Send an event for every alarm that has changed."""
        for alarm in state.alarms:
            condition = self._conditions.get(alarm.name)
            if condition is None:
                if alarm.state == "clear":
                    continue
                condition = await self._add(alarm)
            if alarm != condition.alarm:
                condition.alarm = alarm
                await self._send(condition, alarm, state.wall_ns)

    async def _add(self, alarm: Alarm) -> _Condition:
        path = f"Belt.Alarms.{alarm.name}"
        node = own_id(path)
        kind = ua.ObjectIds.AlarmConditionType
        self._builder.add_object(node, own_id("Belt.Alarms"), ua.QualifiedName(alarm.name, OWN), kind)
        for name, value in _list_variables(alarm).items():
            self._builder.add_variable(own_id(f"{path}.{name}"), node, ua.QualifiedName(name, 0), value)
        generator = EventGenerator(self._server.isession)
        await generator.init(kind)
        event: Any = generator.event
        event.NodeId = node
        event.SourceNode, event.SourceName = own_id("Belt"), alarm.name
        event.ConditionName, event.BranchId = alarm.name, ua.NodeId()
        event.ConditionClassId = ua.NodeId(ua.ObjectIds.ProcessConditionClassType)
        event.ConditionClassName = ua.LocalizedText("ProcessConditionClass")
        event.InputNode = ua.NodeId()
        setattr(event, "EnabledState/Id", True)
        event.EnabledState = ua.LocalizedText("Enabled")
        event.SuppressedOrShelved = False
        condition = self._conditions[alarm.name] = _Condition(node, generator)
        return condition

    async def _send(self, condition: _Condition, alarm: Alarm, wall_ns: int) -> None:
        active, acked = alarm.state in _ACTIVE, alarm.state in _ACKED
        event: Any = condition.generator.event
        event.LastSeverity = event.Severity or _SEVERITIES[alarm.severity]
        event.Severity = _SEVERITIES[alarm.severity]
        event.Quality = ua.StatusCode(ua.StatusCodes.Good)
        setattr(event, "ActiveState/Id", active)
        event.ActiveState = ua.LocalizedText(_ON[active])
        setattr(event, "AckedState/Id", acked)
        event.AckedState = ua.LocalizedText(_SEEN[acked])
        event.SuppressedOrShelved = alarm.suppression is not None
        event.ClientUserId, event.Comment = alarm.by, ua.LocalizedText("")
        event.Retain = alarm.state != "clear"
        event.Message = ua.LocalizedText(_describe(alarm))
        event.Time = event.ReceiveTime = to_datetime(wall_ns)
        event.EventId = uuid.uuid4().bytes
        for name, value in _list_variables(alarm).items():
            node = own_id(f"{condition.node.Identifier}.{name}")
            data = ua.DataValue(value, SourceTimestamp=to_datetime(wall_ns))
            await self._server.write_attribute_value(node, data)
        await self._server.subscription_service.trigger_event(event)

    async def _acknowledge(self, node: ua.NodeId, *arguments: ua.Variant) -> ua.StatusCode:
        """Acknowledge a condition by the identifier of its last event."""
        found = [(name, one) for name, one in self._conditions.items() if one.node == node]
        if not found:
            return ua.StatusCode(ua.StatusCodes.BadNodeIdUnknown)
        (name, condition) = found[0]
        if not arguments or arguments[0].Value != condition.event_id:
            return ua.StatusCode(ua.StatusCodes.BadEventIdUnknown)
        if condition.alarm is not None and condition.alarm.state in _ACKED:
            return ua.StatusCode(ua.StatusCodes.BadConditionBranchAlreadyAcked)
        return await self._commands.acknowledge(name)


def _list_variables(alarm: Alarm) -> dict[str, ua.Variant]:
    """Return the values below a condition's object."""
    text = ua.VariantType.LocalizedText
    active, acked = alarm.state in _ACTIVE, alarm.state in _ACKED
    return {
        "EnabledState": ua.Variant(ua.LocalizedText("Enabled"), text),
        "ActiveState": ua.Variant(ua.LocalizedText(_ON[active]), text),
        "AckedState": ua.Variant(ua.LocalizedText(_SEEN[acked]), text),
        "Retain": ua.Variant(alarm.state != "clear", ua.VariantType.Boolean),
        "Severity": ua.Variant(_SEVERITIES[alarm.severity], ua.VariantType.UInt16),
        "Message": ua.Variant(ua.LocalizedText(_describe(alarm)), text),
        "ClientUserId": ua.Variant(alarm.by, ua.VariantType.String),
    }


def _describe(alarm: Alarm) -> str:
    """Return the alarm's text, or its name with its value."""
    if alarm.detail:
        return str(alarm.detail)
    value = f" {alarm.value:g} {alarm.unit}" if math.isfinite(alarm.value) else ""
    return f"{alarm.name}{value}".rstrip()
