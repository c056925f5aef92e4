"""OPC UA: what a client may do: acknowledge alarms and call methods, and write nothing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from beltscape.core.alarms import Alarm

pytest.importorskip("asyncua", reason="asyncua is not installed; pip install 'beltscape[opcua]' brings it")

from asyncua import ua

from tests.protocols.opcua import Running, call, find, set_state, wait_for


def test_nothing_can_be_written_or_added(running: Running) -> None:
    async def work() -> None:
        async with await running.make_client() as client:
            with pytest.raises(ua.UaStatusCodeError):
                await find(client, "Belt.Totals.Volume").write_value(1.0)
            with pytest.raises(ua.UaStatusCodeError):
                await client.nodes.objects.add_variable(2, "mine", 1.0)
            with pytest.raises(ua.UaStatusCodeError):
                await client.delete_nodes([find(client, "Belt.Totals")])
            assert await find(client, "Belt.Totals.Volume").read_value() == 0.0

    call(work)


def make_alarm(state: Any, **changes: Any) -> tuple[Alarm, ...]:
    alarm = Alarm("overload", "critical", state, 600.0, 500.0, "m³/h", 1, "slow the feed")
    return (replace(alarm, **changes),)


def test_an_alarm_is_a_condition_that_is_acknowledged_and_refreshed(running: Running, operator) -> None:
    async def work() -> None:
        events: list[Any] = []
        handler = SimpleNamespace(event_notification=events.append, datachange_notification=None)
        client = await running.make_client(operator, "otto")
        async with client:
            subscription = await client.create_subscription(50, handler)
            kind = client.get_node(ua.ObjectIds.AlarmConditionType)
            await subscription.subscribe_alarms_and_conditions(client.nodes.server, [kind])
            await set_state(running, client, alarms=make_alarm("raised"))
            await wait_for(lambda: any(getattr(e, "ActiveState/Id", None) for e in events))
            event = [e for e in events if getattr(e, "ActiveState/Id", None)][-1]
            assert (event.Severity, event.Message.Text) == (800, "slow the feed")
            assert getattr(event, "AckedState/Id") is False
            assert event.Retain is True
            condition = client.get_node(event.NodeId)
            acknowledge = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
            comment = ua.LocalizedText("seen")
            with pytest.raises(ua.UaStatusCodeError, match="BadEventIdUnknown"):
                await condition.call_method(acknowledge, b"another", comment)
            async with await running.make_client(operator, "vera") as viewer:
                with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
                    await viewer.get_node(event.NodeId).call_method(acknowledge, event.EventId, comment)
            await condition.call_method(acknowledge, event.EventId, comment)
            assert running.plant.commands[-1] == ("acknowledge", "overload", "otto")
            events.clear()
            refresh = ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh)
            refreshed = client.get_node(ua.ObjectIds.ConditionType)
            await refreshed.call_method(
                refresh, ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
            )
            await wait_for(lambda: any(getattr(e, "ActiveState/Id", None) for e in events))
            await set_state(running, client, alarms=make_alarm("acknowledged", by="otto"))
            await wait_for(lambda: bool(getattr(events[-1], "AckedState/Id", False)))
            await set_state(running, client, alarms=make_alarm("clear"))
            await wait_for(lambda: events[-1].Retain is False)
            assert await find(client, "Belt.Alarms.overload.ActiveState").read_value() == ua.LocalizedText(
                "Inactive"
            )

    call(work)


def test_methods_are_done_for_operators_and_audited(running: Running, operator) -> None:
    async def work() -> None:
        plant, commands = running.plant, "Belt.Commands"
        async with await running.make_client(operator, "otto") as client:
            folder = find(client, commands)
            await folder.call_method("2:StartBatch", "truck 7", "gravel")
            await folder.call_method("2:ChangeProduct", "sand 0/2")
            assert plant.commands[-2:] == [
                ("start", "truck 7", "gravel", "otto"),
                ("product", "sand 0/2", "otto"),
            ]
            with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
                await folder.call_method("2:StopBatch")
            assert (
                await find(client, f"{commands}.LastRefusal").read_value()
                == "StopBatch: batch: there is none"
            )
            for arguments in ((), ("a", "b", "c"), (1, 2), ("x" * 500, "")):
                with pytest.raises(ua.UaStatusCodeError):
                    await folder.call_method("2:StartBatch", *arguments)
        actions = [(entry[0], entry[1]) for entry in plant.users.entries]
        assert ("opcua StartBatch", "otto") in actions
        assert ("opcua StopBatch refused", "otto") in actions
        before = list(plant.commands)
        for client in (await running.make_client(operator, "vera"), await running.make_client()):
            async with client:
                with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
                    await find(client, commands).call_method("2:StartBatch", "truck 8", "")
        assert plant.commands == before
        assert ("opcua StartBatch refused", "anonymous") in [(e[0], e[1]) for e in plant.users.entries]

    call(work)
