"""The live stream: what new, slow and open pages receive."""

from __future__ import annotations

import json

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from beltscape.service.access.accounts import User
from beltscape.service.api.live_stream import SentState, collect_messages
from beltscape.service.belt_surface import UNKNOWN, decode_heights
from beltscape.service.hosting import serve
from beltscape.service.live_state import LiveState
from beltscape.service.settings import WebSettings
from tests.service.feeder import SimulatedPlant, SummingLedger, make_heights
from tests.service.plants import make_service


def parse_message(message: str | bytes) -> dict:
    """Return a message as the page parses it."""
    if isinstance(message, str):
        return json.loads(message)
    length = int.from_bytes(message[:4], "little")
    assert length % 4 == 0
    return json.loads(message[4 : 4 + length]) | {"counts": np.frombuffer(message[4 + length :], "<u2")}


def collect_by_kind(
    live_state: LiveState, sent: SentState, max_silent_calls: int = 5
) -> dict[str, list[dict]]:
    kinds: dict[str, list[dict]] = {}
    for message in collect_messages(live_state, sent, max_silent_calls):
        content = parse_message(message)
        kinds.setdefault(content["kind"], []).append(content)
    return kinds


def test_a_new_page_receives_everything_that_is_kept():
    live_state = LiveState()
    plant = SimulatedPlant([live_state], SummingLedger())
    for _ in range(5):
        plant.step()
    first = collect_by_kind(live_state, SentState())
    assert set(first) == {"state", "flow", "records", "section", "belt"}
    assert [record["number"] for record in first["records"][0]["records"]] == [1, 2, 3, 4, 5]
    belt = first["belt"][0]
    rows = belt["counts"].reshape(belt["rows"], belt["columns"])
    height, seen = decode_heights(rows)
    load = make_heights(0, 96).reshape(48, 2, -1).mean(axis=1)
    assert belt["first"] == 0 and belt["cell_mm"] == 10
    np.testing.assert_allclose(height[:48].mean(), load.mean(), rtol=0.02)
    assert seen.mean() > 0.9
    section = first["section"][0]
    assert section["number"] == 5 and len(section["x_mm"]) == section["counts"].size
    assert (section["counts"] != UNKNOWN).any()


def test_later_messages_contain_only_new_data():
    live_state, sent = LiveState(), SentState()
    plant = SimulatedPlant([live_state], SummingLedger())
    plant.step()
    collect_by_kind(live_state, sent)
    assert collect_by_kind(live_state, sent) == {}
    plant.step()
    second = collect_by_kind(live_state, sent)
    assert [record["number"] for record in second["records"][0]["records"]] == [2]
    assert second["belt"][0]["first"] == 47  # the row that was still open


def test_an_unchanged_state_is_repeated_periodically():
    live_state, sent = LiveState(), SentState()
    assert list(collect_by_kind(live_state, sent)) == ["state"]
    is_repeated = [bool(collect_by_kind(live_state, sent, 5)) for _ in range(20)]
    assert is_repeated == ([False] * 4 + [True]) * 4


def test_a_slow_page_receives_the_newest_data_only():
    live_state, sent = LiveState(WebSettings(belt_m=2)), SentState()
    plant = SimulatedPlant([live_state], SummingLedger())
    plant.step()
    collect_by_kind(live_state, sent)
    for _ in range(60):
        plant.step()
    late = collect_by_kind(live_state, sent)
    assert sum(message["rows"] for message in late["belt"]) == 200
    assert late["belt"][-1]["first"] + late["belt"][-1]["rows"] == live_state.get_belt()[0][1]
    assert len(late["section"]) == len(late["state"]) == 1


@pytest.fixture
def served(tmp_path):
    made = make_service(tmp_path, 3)
    server = serve(made.app, made.settings)
    yield made, server.address
    server.close()
    made.history.close()


def test_messages_arrive_over_the_socket(served):
    made, address = served
    url = address.replace("http", "ws") + "/api/live"
    with pytest.raises(InvalidStatus):
        connect(url)
    made.access.accounts.add("ana", "viewer", "coal on the belt")
    cookie = made.access.sessions.open(User("ana", "viewer"), "")
    with connect(url, additional_headers={"Cookie": f"beltscape={cookie}"}, origin=address) as socket:
        socket.send("pages say nothing")
        kinds = {parse_message(socket.recv(timeout=5))["kind"] for _ in range(5)}
        assert kinds == {"state", "flow", "records", "section", "belt"}
        made.plant.step()
        while (message := parse_message(socket.recv(timeout=5)))["kind"] != "records":
            pass
        assert message["records"][0]["number"] == 4
