"""Numbers that protocols keep over restarts: damaged ones are set aside, and found again from the ledger."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from beltscape.core.ledger import BeltRecord
from beltscape.protocols.modbus import PulseCount
from beltscape.sinks.historian import Historian, store
from beltscape.sinks.settings import HistorySettings

pytest.importorskip("paho", reason="paho-mqtt is not installed; pip install 'beltscape[mqtt]' brings it")
pytest.importorskip("pymodbus", reason="pymodbus is not installed; pip install 'beltscape[modbus]' brings it")

from beltscape.protocols.mqtt.publisher import Publisher, read_cursor
from beltscape.protocols.outputs import OutputWriter
from beltscape.protocols.settings import MqttSettings
from tests.files.damages import DAMAGES, check_set_aside, damage_values
from tests.protocols.broker import wait_until
from tests.protocols.io_module import IoModule
from tests.protocols.plant import FakePlant
from tests.protocols.test_outputs import make_settings, weigh
from tests.sinks.ledgers import ledger


@pytest.fixture
def io() -> Iterator[IoModule]:
    """An I/O module that answers."""
    one = IoModule()
    one.start()
    yield one
    one.stop()


@pytest.mark.parametrize("damage", [*DAMAGES, "values"])
def test_a_damaged_count_is_set_aside_and_taken_from_the_total(tmp_path: Path, damage: str) -> None:
    path, counts = tmp_path / "pulses.json", list[PulseCount]()
    PulseCount(path, 25.0).update(1060.0)

    def read() -> list[str]:
        messages: list[str] = []
        counts.append(PulseCount(path, 25.0, messages.append))
        return messages

    # a count of another key is none, whatever its type
    kinds = {key: data for key, data in damage_values(path).items() if key.startswith("count")}
    for data in kinds.values() if damage == "values" else [DAMAGES[damage]]:
        check_set_aside(path, data, read)
        assert counts[-1].update(math.nan) == 0
        assert counts[-1].update(1060.0) == 42
        assert PulseCount(path, 25.0).count == 42


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_cursor_is_set_aside(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "mqtt.json"

    def read() -> list[str]:
        messages: list[str] = []
        cursor = read_cursor(path, "one", messages.append)
        assert cursor.number is None and cursor.is_lost
        return messages

    check_set_aside(path, DAMAGES[damage], read)


@pytest.mark.parametrize("kind", ["coil", "counter"])
@pytest.mark.parametrize("lost", ["outputs_pulses.json", "outputs_base.json", "outputs_record.json"])
def test_a_damaged_number_gives_no_wrong_pulse(io: IoModule, tmp_path: Path, kind: str, lost: str) -> None:
    plant, messages = FakePlant(), list[str]()
    weigh(plant, 1000.0)

    def run(until_kg: float) -> None:
        writer = OutputWriter(make_settings(io, kind), plant, tmp_path, messages.append)
        writer.start()
        wait_until(lambda: (tmp_path / lost).exists() and read_given(tmp_path) >= 0, 120)
        weigh(plant, until_kg)
        wait_until(lambda: read_given(tmp_path) == round(until_kg / 25) - 40, 120)
        writer.close()

    run(1250.0)
    (tmp_path / lost).write_bytes(b"")
    run(1500.0)
    assert (io.edges if kind == "coil" else io.counts[-1]) == 20
    assert io.counts == sorted(io.counts)
    assert any(lost in one and "moved to" in one for one in messages)


def read_given(folder: Path) -> int:
    """Return the pulses that the kept number says were given; -1 without a readable one."""
    try:
        return json.loads((folder / "outputs_pulses.json").read_text())["steps"] // 2
    except (OSError, ValueError):
        return -1


class HistoryPlant(FakePlant):
    """A plant whose records are those of a history."""

    def __init__(self, historian: Historian) -> None:
        super().__init__()
        self.historian = historian

    def read_records(self, after: int, limit: int) -> Sequence[BeltRecord]:
        return self.historian.records(0, 1 << 62, limit, after)

    def read_last_number(self) -> int:
        return self.historian.ledger_end.number


class Arriving:
    """A channel at whose other end everything arrives."""

    def __init__(self) -> None:
        self.numbers: list[int] = []

    def publish_records(self, records: Sequence[BeltRecord]) -> int:
        self.numbers += [record.number for record in records]
        return len(records)


def test_a_publisher_that_reads_at_any_moment_takes_no_ledger_for_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    historian, channel, messages = (
        Historian(tmp_path, HistorySettings(reserve_mib=1)),
        Arriving(),
        list[str](),
    )
    settings = MqttSettings(host="nobody", first="all")
    publisher = Publisher(settings, HistoryPlant(historian), tmp_path, messages.append)
    append = store.append_records

    def append_and_publish(*arguments: Any, **options: Any) -> Any:
        sums = append(*arguments, **options)
        for _ in range(3):  # the records are committed, the end of the ledger is not moved yet
            publisher._publish_records(channel)  # pyrefly: ignore[bad-argument-type]
        return sums

    monkeypatch.setattr(store, "append_records", append_and_publish)
    historian.begin_run()
    for record in ledger(20):
        historian.write([record])
        publisher._publish_records(channel)  # pyrefly: ignore[bad-argument-type]
    assert channel.numbers == list(range(1, 21)) and messages == []
    historian.close()


def test_a_damaged_cursor_loses_no_record(tmp_path: Path) -> None:
    plant, channel, messages = FakePlant(), Arriving(), list[str]()
    plant.add(5)
    (tmp_path / "mqtt.json").write_bytes(b"")
    publisher = Publisher(MqttSettings(host="127.0.0.1", port=1), plant, tmp_path, messages.append)
    publisher.start()
    wait_until((tmp_path / "mqtt.json").exists, 120)
    publisher.close(120)  # its thread writes the cursor, too
    assert publisher.waiting == 5  # although a first start would publish from now on only
    publisher._publish_records(channel)  # pyrefly: ignore[bad-argument-type]
    assert channel.numbers == [1, 2, 3, 4, 5]
    assert "mqtt.json: is empty and was moved to" in messages[0]
