"""OPC UA: what a client reads, browses and subscribes to."""

from __future__ import annotations

import asyncio
import math
import runpy
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from beltscape.core.errors import OutputError
from beltscape.core.findings import Finding
from beltscape.core.ledger import Totals

pytest.importorskip("asyncua", reason="asyncua is not installed; pip install 'beltscape[opcua]' brings it")

from asyncua import ua

from tests.docs.blocks import read_blocks
from tests.docs.conftest import page_text
from tests.docs.system import ROOT
from tests.protocols.opcua import PASSWORD, Running, call, find, read, set_state, wait_for

CODES = ua.StatusCodes


PROCESS = "Belt.Monitoring.Process"


def test_a_client_reads_values_with_status_and_time(running: Running) -> None:
    async def work() -> None:
        async with await running.make_client() as client:
            totals = Totals(7, 6e12, 1e9, 5_000_000_123.4, 6_000_000.0, 20_000.0, 30.0)
            await set_state(running, client, totals=totals)
            expected = {
                f"{PROCESS}.VolumeFlowRate": 123.4,
                f"{PROCESS}.MassFlowRate": 104.9,
                f"{PROCESS}.CrossSection": 0.01,
                f"{PROCESS}.Load": 0.01 * 104.9 / 123.4 * 1000,
                f"{PROCESS}.Filling": 25.0,
                f"{PROCESS}.Coverage": 97.0,
                "Belt.Components.BeltScale.Monitoring.Process.MassFlowRate": 104.9,
                "Belt.Components.Scale.FlowRate": 104.9,
                "Belt.Totals.Volume": 6000.0,
                "Belt.Totals.ValidLength": 6000.0,
                "Belt.Totals.DegradedLength": 20.0,
                "Belt.Totals.MissingLength": 0.03,
                "Belt.Totals.Records": 7,
                "Belt.Monitoring.Health.CamerasOk": 1,
            }
            for path, value in expected.items():
                shown = await read(client, path)
                assert shown.Value.Value == pytest.approx(value), path
                assert shown.StatusCode.is_good()
            assert (await read(client, f"{PROCESS}.BeltSpeed")).StatusCode.value == CODES.BadSensorFailure
            total = await read(client, "Belt.Components.Scale.MasterTotalizer.TotalizedValue")
            assert (total.Value.Value.Net, total.Value.Value.Tare) == (pytest.approx(5_000_000.1234), 0.0)
            lump = await read(client, f"{PROCESS}.LargestLump")
            assert lump.StatusCode.value == CODES.BadWaitingForInitialData

    call(work)


@pytest.mark.parametrize(
    ("changes", "flow", "total"),
    [
        ({"standing": "valid"}, CODES.Good, CODES.Good),
        ({"standing": "degraded"}, CODES.UncertainSensorNotAccurate, CODES.Good),
        ({"standing": "missing"}, CODES.BadSensorFailure, CODES.Good),
        ({"standing": "missing", "maintenance": "cleaning"}, CODES.BadOutOfService, CODES.Good),
        ({"mass_flow_t_h": math.nan, "totals": Totals(mass_kg=math.nan)}, CODES.BadConfigurationError,
         CODES.BadConfigurationError),
    ],
)  # fmt: skip
def test_the_status_is_the_ledgers_quality(running: Running, changes, flow: int, total: int) -> None:
    async def work() -> None:
        async with await running.make_client() as client:
            await set_state(running, client, **changes)
            shown = await read(client, f"{PROCESS}.MassFlowRate")
            assert shown.StatusCode.value == flow
            assert (shown.Value.Value is None) == shown.StatusCode.is_bad()
            for path in ("Belt.Totals.Mass", "Belt.Components.Scale.MasterTotalizer.TotalizedValue"):
                assert (await read(client, path)).StatusCode.value == total

    call(work)


def test_values_of_one_read_belong_together(running: Running) -> None:
    async def work() -> None:
        paths = ("Belt.Totals.Volume", "Belt.Totals.ValidLength", f"{PROCESS}.VolumeFlowRate")
        async with await running.make_client() as client:
            await set_state(running, client, volume_flow_m3_h=0.0)
            nodes, seen = [find(client, path) for path in paths], set[int]()
            for turn in range(60):
                number = float(turn)
                running.plant.state = replace(
                    running.plant.state,
                    totals=Totals(1, number * 1e9, 0.0, 0.0, number * 1e3),
                    volume_flow_m3_h=number,
                )
                values = await client.read_values(nodes)
                assert values[0] == pytest.approx(values[1])
                assert values[0] == pytest.approx(values[2])
                seen.add(round(values[0]))
                await asyncio.sleep(0.01)
            assert len(seen) > 3

    call(work)


def test_types_and_units_are_those_of_the_companion_specifications(running: Running) -> None:
    async def work() -> None:
        async with await running.make_client() as client:
            spaces = await client.get_namespace_array()
            conveying = spaces.index("http://opcfoundation.org/UA/Mining/TransportDumping/Conveying/")
            scales = spaces.index("http://opcfoundation.org/UA/Scales/V2/")
            machines = spaces.index("http://opcfoundation.org/UA/Machinery/")
            belt = await client.nodes.objects.get_child([f"{machines}:Machines", "2:Belt"])
            kinds = {
                "Belt": ua.NodeId(1003, conveying),
                "Belt.Components.BeltScale": ua.NodeId(1011, conveying),
                "Belt.Components.Scale": ua.NodeId(10, scales),
                "Belt.Components.Scale.FlowRate": ua.NodeId(52, scales),
            }
            for path, kind in kinds.items():
                assert await find(client, path).read_type_definition() == kind
            names = [f"{machines}:Components", f"{conveying}:BeltScale", f"{machines}:Monitoring",
                     f"{machines}:Process", f"{conveying}:MassFlowRate"]  # fmt: skip
            rate = await belt.get_child(names)
            unit = await (await rate.get_child("0:EngineeringUnits")).read_value()
            assert (unit.DisplayName.Text, unit.UnitId) == ("t/h", 0x453138)  # "E18"
            metadata = await client.nodes.server.get_child(
                ["0:Namespaces", f"{conveying}:{spaces[conveying]}", "0:IsNamespaceSubset"]
            )
            assert await metadata.read_value() is True
            rig = find(client, "Belt.Provenance.RigSha256")
            assert await rig.read_value() == "ab" * 32
            running.plant.provenance = {**running.plant.provenance, "RigSha256": "cd" * 32}
            await set_state(running, client)
            assert await rig.read_value() == "cd" * 32

    call(work)


def test_a_subscription_receives_every_record(running: Running) -> None:
    async def work() -> None:
        numbers: list[int] = []
        async with await running.make_client() as client:
            handler = SimpleNamespace(datachange_notification=lambda _n, value, _d: numbers.append(value))
            subscription = await client.create_subscription(50, handler)
            await subscription.subscribe_data_change(find(client, "Belt.Records.Number"), queuesize=1000)
            await wait_for(lambda: bool(numbers))
            for count in (1, 250, 7):
                running.plant.add(count)
                await asyncio.sleep(0.05)
            last = running.plant.read_last_number()
            await wait_for(lambda: bool(numbers) and numbers[-1] == last)
        assert numbers == list(range(numbers[0], last + 1))

    call(work)


def test_a_history_or_state_that_fails_ends_no_session(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OutputError("history.db: cannot be read")

    async def work() -> None:
        async with await running.make_client() as client:
            number = find(client, "Belt.Records.Number")
            with monkeypatch.context() as broken:
                broken.setattr(running.plant, "read_records", fail)
                running.plant.add(5)
                await set_state(running, client, volume_flow_m3_h=77.0)
                assert await find(client, f"{PROCESS}.VolumeFlowRate").read_value() == 77.0
                await wait_for(lambda: "history.db: cannot be read" in running.messages[-1])
            with monkeypatch.context() as broken:
                broken.setattr(running.plant, "read_state", fail)
                codes = set[int]()
                while CODES.BadNoCommunication not in codes:  # until the time of the test is over
                    codes.add((await read(client, f"{PROCESS}.VolumeFlowRate")).StatusCode.value)
            await set_state(running, client)
            assert await number.read_value() == running.plant.read_last_number()
        assert len([one for one in running.messages if "cannot be read" in one]) <= 2

    call(work)


def test_findings_appear_with_limit_and_fault(running: Running) -> None:
    async def work() -> None:
        findings = (
            Finding("zero_shift", 1.5, 0.1, 2.0, "mm"),
            Finding("sharpness", math.nan, math.nan, 0.5, "", "cam0", "blurred: clean the lens", "degraded"),
        )
        async with await running.make_client() as client:
            await set_state(running, client, findings=findings)
            await asyncio.sleep(0.2)
            health = "Belt.Monitoring.Health"
            assert await find(client, f"{health}.zero_shift").read_value() == 1.5
            assert await find(client, f"{health}.zero_shift.Limit").read_value() == 2.0
            shown = await read(client, f"{health}.sharpness.cam0")
            assert shown.StatusCode.is_bad()
            assert (
                await find(client, f"{health}.sharpness.cam0.Fault").read_value() == "blurred: clean the lens"
            )
            assert await find(client, f"{health}.Faults").read_value() == 1

    call(work)


def test_a_client_reads_the_whole_history_over_pages(running: Running) -> None:
    async def work() -> None:
        running.plant.add(2100)
        async with await running.make_client() as client:
            node, begin, end = find(client, "Belt.Records.Number"), datetime(2000, 1, 1), datetime(2100, 1, 1)
            values = await node.read_raw_history(begin, end)
        assert [one.Value.Value for one in values] == list(range(1, running.plant.read_last_number() + 1))

    call(work)


def test_the_client_of_the_manual_reads_the_belt(running: Running, tmp_path: Path, capsys) -> None:
    page = "docs/howto/opcua.md"
    (block,) = [one for one in read_blocks(page, page_text(page)) if one.kind == "python"]
    names: dict[str, Any] = {}
    exec(block.text, names)
    volumes = call(lambda: names["read_belt"](running.address, "otto", PASSWORD, tmp_path))
    assert volumes == pytest.approx([0.2e-3] * len(volumes))
    assert len(volumes) == min(10, running.plant.read_last_number())
    assert capsys.readouterr().out.startswith("104.9 Good 20")


def test_the_manual_holds_the_nodes() -> None:
    tool = runpy.run_path(str(ROOT / "tools/write_opcua_nodes.py"))
    text = tool["PAGE"].read_text("utf-8")
    assert tool["fill_page"](text) == text, "run python tools/write_opcua_nodes.py"
