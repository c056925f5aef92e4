from __future__ import annotations

import json

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from beltscape.service.access.roles import User
from beltscape.service.hub import Hub
from beltscape.service.live import Told, news
from beltscape.service.server import serve
from beltscape.service.settings import WebSettings
from beltscape.service.shown.belt import UNKNOWN, decode
from service.feeder import Plant, Sums, heights
from service.plants import works


def opened(message: str | bytes) -> dict:
    """A message as the page reads it."""
    if isinstance(message, str):
        return json.loads(message)
    length = int.from_bytes(message[:4], "little")
    assert length % 4 == 0
    return json.loads(message[4 : 4 + length]) | {"counts": np.frombuffer(message[4 + length :], "<u2")}


def told(hub: Hub, memory: Told, quiet: int = 5) -> dict[str, list[dict]]:
    kinds: dict[str, list[dict]] = {}
    for message in news(hub, memory, quiet):
        found = opened(message)
        kinds.setdefault(found["kind"], []).append(found)
    return kinds


def test_a_page_that_opens_is_told_everything_that_is_kept():
    hub = Hub()
    plant = Plant([hub], Sums())
    for _ in range(5):
        plant.step()
    first = told(hub, Told())
    assert set(first) == {"state", "flow", "records", "section", "belt"}
    assert [record["number"] for record in first["records"][0]["records"]] == [1, 2, 3, 4, 5]
    belt = first["belt"][0]
    rows = belt["counts"].reshape(belt["rows"], belt["columns"])
    height, seen = decode(rows)
    load = heights(0, 96).reshape(48, 2, -1).mean(axis=1)
    assert belt["first"] == 0 and belt["cell_mm"] == 10
    np.testing.assert_allclose(height[:48].mean(), load.mean(), rtol=0.02)
    assert seen.mean() > 0.9
    section = first["section"][0]
    assert section["number"] == 5 and len(section["x_mm"]) == section["counts"].size
    assert (section["counts"] != UNKNOWN).any()


def test_afterwards_only_what_is_new():
    hub, memory = Hub(), Told()
    plant = Plant([hub], Sums())
    plant.step()
    told(hub, memory)
    assert told(hub, memory) == {}
    plant.step()
    second = told(hub, memory)
    assert [record["number"] for record in second["records"][0]["records"]] == [2]
    assert second["belt"][0]["first"] == 47  # the row that was still open


def test_silence_is_broken_once_in_a_while():
    hub, memory = Hub(), Told()
    assert list(told(hub, memory)) == ["state"]
    heard = [bool(told(hub, memory, 5)) for _ in range(20)]
    assert heard == ([False] * 4 + [True]) * 4


def test_a_page_that_slept_gets_the_newest_and_not_all_that_was():
    hub, memory = Hub(WebSettings(belt_m=2)), Told()
    plant = Plant([hub], Sums())
    plant.step()
    told(hub, memory)
    for _ in range(60):
        plant.step()
    late = told(hub, memory)
    assert sum(message["rows"] for message in late["belt"]) == 200
    assert late["belt"][-1]["first"] + late["belt"][-1]["rows"] == hub.belt()[0][1]
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
