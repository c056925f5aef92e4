from __future__ import annotations

import json

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from beltscape.service.access.identity.roles import User
from beltscape.service.live_state import LiveState
from beltscape.service.live_stream import SentState, collect_messages
from beltscape.service.server import serve
from beltscape.service.settings import WebSettings
from beltscape.service.view_models.belt import UNKNOWN, decode_heights
from service.feeder import Plant, Sums, heights
from service.plants import works


def opened(message: str | bytes) -> dict:
    """A message as the page reads it."""
    if isinstance(message, str):
        return json.loads(message)
    length = int.from_bytes(message[:4], "little")
    assert length % 4 == 0
    return json.loads(message[4 : 4 + length]) | {"counts": np.frombuffer(message[4 + length :], "<u2")}


def told(live_state: LiveState, memory: SentState, quiet: int = 5) -> dict[str, list[dict]]:
    kinds: dict[str, list[dict]] = {}
    for message in collect_messages(live_state, memory, quiet):
        found = opened(message)
        kinds.setdefault(found["kind"], []).append(found)
    return kinds


def test_a_page_that_opens_is_told_everything_that_is_kept():
    live_state = LiveState()
    plant = Plant([live_state], Sums())
    for _ in range(5):
        plant.step()
    first = told(live_state, SentState())
    assert set(first) == {"state", "flow", "records", "section", "belt"}
    assert [record["number"] for record in first["records"][0]["records"]] == [1, 2, 3, 4, 5]
    belt = first["belt"][0]
    rows = belt["counts"].reshape(belt["rows"], belt["columns"])
    height, seen = decode_heights(rows)
    load = heights(0, 96).reshape(48, 2, -1).mean(axis=1)
    assert belt["first"] == 0 and belt["cell_mm"] == 10
    np.testing.assert_allclose(height[:48].mean(), load.mean(), rtol=0.02)
    assert seen.mean() > 0.9
    section = first["section"][0]
    assert section["number"] == 5 and len(section["x_mm"]) == section["counts"].size
    assert (section["counts"] != UNKNOWN).any()


def test_afterwards_only_what_is_new():
    live_state, memory = LiveState(), SentState()
    plant = Plant([live_state], Sums())
    plant.step()
    told(live_state, memory)
    assert told(live_state, memory) == {}
    plant.step()
    second = told(live_state, memory)
    assert [record["number"] for record in second["records"][0]["records"]] == [2]
    assert second["belt"][0]["first"] == 47  # the row that was still open


def test_silence_is_broken_once_in_a_while():
    live_state, memory = LiveState(), SentState()
    assert list(told(live_state, memory)) == ["state"]
    heard = [bool(told(live_state, memory, 5)) for _ in range(20)]
    assert heard == ([False] * 4 + [True]) * 4


def test_a_page_that_slept_gets_the_newest_and_not_all_that_was():
    live_state, memory = LiveState(WebSettings(belt_m=2)), SentState()
    plant = Plant([live_state], Sums())
    plant.step()
    told(live_state, memory)
    for _ in range(60):
        plant.step()
    late = told(live_state, memory)
    assert sum(message["rows"] for message in late["belt"]) == 200
    assert late["belt"][-1]["first"] + late["belt"][-1]["rows"] == live_state.get_belt()[0][1]
    assert len(late["section"]) == len(late["state"]) == 1


@pytest.fixture
def served(tmp_path):
    made = works(tmp_path, 3)
    server = serve(made.app, made.settings)
    yield made, server.address
    server.close()
    made.history.close()


def test_over_the_wire(served):
    made, address = served
    url = address.replace("http", "ws") + "/api/live"
    with pytest.raises(InvalidStatus):
        connect(url)
    made.access.accounts.add("ana", "viewer", "coal on the belt")
    cookie = made.access.sessions.open(User("ana", "viewer"), "")
    with connect(url, additional_headers={"Cookie": f"beltscape={cookie}"}, origin=address) as socket:
        socket.send("pages say nothing")
        kinds = {opened(socket.recv(timeout=5))["kind"] for _ in range(5)}
        assert kinds == {"state", "flow", "records", "section", "belt"}
        made.plant.step()
        while (message := opened(socket.recv(timeout=5)))["kind"] != "records":
            pass
        assert message["records"][0]["number"] == 4
