"""The service's users over OPC UA: one password, one throttle and one audit log for page and protocols."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.alarms import Alarm
from beltscape.core.events import FrameEvent
from beltscape.core.frames import FrameSet
from beltscape.service.access import Access
from beltscape.service.live_state import LiveState
from beltscape.service.protocol_checks import CHECKS
from beltscape.service.protocols import NoUsers, ProtocolSettings, ServedPlant, ServedUsers, serve_protocols
from beltscape.service.settings import WebSettings
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.protocols.broker import find_port
from tests.protocols.plant import make_record
from tests.service.access.sample_app import CHEAP, PASSWORD


@pytest.fixture
def access(tmp_path: Path) -> Iterator[Access]:
    with closing(Access(tmp_path, None, CHEAP)) as one:
        one.accounts.add("vera", "viewer", PASSWORD)
        one.accounts.add("otto", "operator", PASSWORD)
        yield one


def test_names_passwords_and_roles_are_those_of_the_page(access: Access) -> None:
    users = ServedUsers(access)
    assert users.find_by_password("OTTO", PASSWORD, "10.0.0.1") == "otto"
    assert users.find_by_password("otto", "wrong", "10.0.0.1") is None
    assert users.has_role("otto", "viewer")
    assert not users.has_role("vera", "operator")
    access.accounts.set_role("vera", "operator")
    assert users.has_role("vera", "operator")
    access.accounts.remove("vera")
    assert not users.has_role("vera", "viewer")
    assert not users.has_role("", "viewer")
    users.write_audit("opcua StartBatch", "otto", "10.0.0.1", {"Name": "truck"})
    newest, *others = access.audit.read_last(9)
    assert (newest["what"], newest["who"], newest["Name"]) == ("opcua StartBatch", "otto", "truck")
    assert [entry["what"] for entry in others] == ["login failed", "login"]


def test_guesses_wait_for_all_ways_in_together(access: Access) -> None:
    users = ServedUsers(access)
    for _ in range(30):
        users.find_by_password("otto", "wrong", "10.0.0.9")
    assert users.find_by_password("otto", PASSWORD, "10.0.0.9") is None  # has to wait
    assert access.throttle.wait_s("otto", "10.0.0.9") > 0


def test_without_access_nobody_enters() -> None:
    users = NoUsers()
    assert users.find_by_password("otto", PASSWORD, "") is None
    assert not users.has_role("otto", "viewer")


def test_a_user_reads_history_and_acknowledges_by_opcua(tmp_path: Path, access: Access) -> None:
    pytest.importorskip("asyncua", reason="pip install 'beltscape[opcua]'")
    from asyncua import Client
    from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

    from beltscape.protocols.settings import OpcUaSettings
    from tests.protocols.opcua import APPLICATION, call, find, make_certificate

    live_state = LiveState(WebSettings(stale_s=60))
    acknowledged, messages = list[tuple[str, str]](), list[str]()
    image = np.zeros((4, 4), np.uint8)
    live_state.on_frame(FrameEvent(FrameSet("f", {"cam0": image}), 1, 0, 0, 0.1, 0.9, 2000.0, 120.0, 4e5))
    live_state.on_alarms([Alarm("overload", "warning", "raised", 1.0, 2.0, "", 1)])
    certificate = make_certificate(tmp_path, "client")
    settings = OpcUaSettings(port=find_port(), clients="any")
    assert CHECKS["opcua"](settings).startswith(f"127.0.0.1 port {settings.port}, least security sign, ")
    with closing(Historian(tmp_path, HistorySettings(reserve_mib=1))) as historian:
        run = historian.begin_run()
        historian.write([replace(make_record(number), run=run) for number in range(1, 6)])

        def acknowledge(alarm: str, user: str) -> bool:
            acknowledged.append((alarm, user))
            return True

        plant = ServedPlant(live_state, historian, acknowledge, ServedUsers(access), {"Program": "test"})

        async def work() -> None:
            client = Client(f"opc.tcp://127.0.0.1:{settings.port}/")
            client.application_uri = APPLICATION
            client.set_user("otto")
            client.set_password(PASSWORD)
            policy = SecurityPolicyBasic256Sha256
            await client.set_security(policy, str(certificate[0]), str(certificate[1]))
            async with client:
                numbers = await find(client, "Belt.Records.Number").read_raw_history(numvalues=3)
                assert [one.Value.Value for one in numbers] == [5, 4, 3]
                assert await find(client, "Belt.Monitoring.Process.LargestLump").read_value() == 120.0
                assert await find(client, "Belt.Totals.Volume").read_value() == pytest.approx(1e-3)
                await find(client, "Belt.Commands").call_method("2:AcknowledgeAlarm", "overload")

        with serve_protocols(ProtocolSettings(opcua=settings), plant, tmp_path, messages.append):
            call(work)
    assert acknowledged == [("overload", "otto")]
    assert "thumbprint" in messages[0]
    assert access.audit.read_last(1)[0]["what"] == "opcua AcknowledgeAlarm"
