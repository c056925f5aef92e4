"""How a total came about: sums by hand, runs, corrections and alarms, with who acknowledged what."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from beltscape.cli.main import main
from beltscape.core.errors import InputError
from beltscape.core.ledger import BeltRecord
from beltscape.core.progress import Silent
from beltscape.pipeline.auditing.alarms import pair_alarms
from beltscape.pipeline.auditing.explanation import explain_total, make_explanation_document
from beltscape.pipeline.auditing.total import parse_total
from beltscape.report.metrology.explanation import render_explanation
from beltscape.sinks.historian import Event, Historian, NewEvent
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import record

BEGIN_NS = 1_795_248_000_000_000_000
"""2026-11-21T08:00Z."""
SECOND_NS = 1_000_000_000


def at(second: float) -> int:
    return BEGIN_NS + round(second * SECOND_NS)


def make_record(number: int, run: int, batch: int) -> BeltRecord:
    one = record(number, run, at(number), sections=False)
    strip = (
        one.strip if one.strip is None else replace(one.strip, common_sigma_mm3=0.0, density_sigma_kg_m3=20.0)
    )
    return replace(one, strip=strip, product="coal", batch=batch, offset_mm=0.0 if number < 90 else 500.0)


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[BeltRecord]]:
    """Two runs, a batch, an alarm of each kind of end, a zero that was set; and what happened before and after."""
    folder = tmp_path_factory.mktemp("history")
    historian = Historian(folder, HistorySettings(reserve_mib=1))
    first = historian.begin_run({"program": "0.1.0", "rig": "a" * 64, "certificate": "2026-0001"})
    batch = historian.production.start_batch("truck 7", "anna", at(20))
    records = [make_record(number, first, batch if 20 <= number <= 70 else 0) for number in range(1, 61)]
    historian.write(records)
    second = historian.begin_run({"program": "0.1.0", "rig": "b" * 64, "certificate": ""})
    later = [make_record(number, second, batch if number <= 70 else 0) for number in range(61, 121)]
    historian.production.end_batch("anna", at(70))
    historian.write(later)

    def alarm(name: str, second: float, state: str, text: str, by: str = "") -> NewEvent:
        return NewEvent("alarm", name, text, at(second), by, {"state": state})

    historian.add_events([
        alarm("dirt:cam2", -3600, "raised", "raised: clean it"),
        alarm("overload", 10, "raised", "raised: 120 %, limit 100 %: slow the feed"),
        alarm("overload", 12, "acknowledged", "acknowledged", "bert"),
        alarm("overload", 15, "clear", "clear"),
        NewEvent("zero", "set", "+0.31 ± 0.02 mm", at(30), "anna"),
        alarm("dirt:cam2", 40, "gone", "gone"),
        alarm("overload", 300, "raised", "raised: later"),
        alarm("dirt:cam2", 500, "acknowledged", "acknowledged", "carla"),
        alarm("lamp", -7200, "raised", "raised: long before"),
        alarm("lamp", -7000, "clear", "clear"),
    ])  # fmt: skip
    historian.close()
    return folder, [*records, *later]


def explain(folder: Path, total: str):
    return explain_total(folder, parse_total(total), Silent())


def test_a_period_adds_up_to_its_records_and_to_the_ledger(history) -> None:
    folder, records = history
    found = explain(folder, "2026-11-21T08:00Z/2026-11-21T08:01Z")
    inside = [one for one in records if one.wall_ns < at(60)]
    assert found.sums.records == len(inside) == 59
    assert found.sums.volume_mm3 == pytest.approx(math.fsum(one.volume_mm3 for one in inside), rel=1e-12)
    assert found.agrees is True
    by_standing = {}
    for one in inside:
        by_standing[one.standing] = by_standing.get(one.standing, 0.0) + one.length_mm
    document = make_explanation_document(found)
    found_lengths = {
        row["standing"]: 1000 * (row["valid_m"] + row["degraded_m"] + row["missing_m"])
        for row in document["standings"]
    }
    assert found_lengths == pytest.approx(by_standing)
    assert explain(folder, "2026-11-21T08:00:01Z/2026-11-21T08:00:30Z").agrees is None


def test_a_batch_has_its_runs_and_what_was_corrected_meanwhile(history) -> None:
    folder, records = history
    document = make_explanation_document(explain(folder, "batch:1"))
    assert document["batch_name"] == "truck 7"
    own = [one for one in records if one.batch]
    assert document["sums"]["count"] == len(own) == 51
    assert document["agrees"] is True
    assert [run["provenance"]["rig"][0] for run in document["runs"]] == ["a", "b"]
    assert [run["count"] for run in document["runs"]] == [41, 10]
    assert [run["provenance"]["certificate"] for run in document["runs"]] == ["2026-0001", ""]
    assert [(one["kind"], one["by"], one["text"]) for one in document["events"]] == [
        ("zero", "anna", "+0.31 ± 0.02 mm")
    ]
    assert [one["name"] for one in document["alarms"]] == ["dirt:cam2"]


def test_alarms_have_who_acknowledged_them_also_afterwards(history) -> None:
    document = make_explanation_document(explain(history[0], "all"))
    dirt, overload = document["alarms"]
    assert (overload["name"], overload["acknowledged_by"]) == ("overload", "bert")
    assert overload["text"] == "120 %, limit 100 %: slow the feed"
    assert overload["ended_ms"] == at(15) // 10**6
    assert (dirt["acknowledged_by"], dirt["acknowledged_ms"]) == ("carla", at(500) // 10**6)
    assert document["seams"] == [{"record": 90, "offset_m": 0.5}]
    assert document["agrees"] is True


def test_records_that_were_changed_do_not_agree(history, tmp_path) -> None:
    import shutil
    import sqlite3

    copy = tmp_path / "copy"
    shutil.copytree(history[0], copy)
    with sqlite3.connect(copy / "history.db") as connection:
        connection.execute("UPDATE records SET volume = volume * 1.001 WHERE number = 30")
    connection.close()
    found = explain(copy, "batch:1")
    assert found.agrees is False
    page = render_explanation(make_explanation_document(found), "en", "UTC")
    assert "were changed or are damaged" in page
    with sqlite3.connect(copy / "history.db") as connection:
        connection.execute("DELETE FROM records WHERE number < 30")
    connection.close()
    gone = explain(copy, "batch:1")
    assert (gone.gone, gone.agrees) == (10, None)


@pytest.mark.parametrize("language", ["en", "de", "es", "zh"])
def test_the_command_prints_and_writes_it(history, tmp_path, capsys, language) -> None:
    words = [
        "explain",
        str(history[0]),
        "day:2026-11-21",
        "--out",
        str(tmp_path / "out"),
        "--language",
        language,
    ]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "certificate 2026-0001" in text
    assert "acknowledged by bert" in text
    assert "The records add up" in text
    page = (tmp_path / "out/report.html").read_text()
    assert "bert" in page
    assert "http" not in page.replace("http://www.w3.org", "")
    assert json.loads((tmp_path / "out/explanation.json").read_text())["agrees"] is True


@pytest.mark.parametrize(
    ("total", "says"),
    [
        ("batch:9", "has no batch 9"),
        ("yesterday", "is no total; give all, batch:17"),
        ("day:2026-13-01", "month must be in 1..12"),
        ("2026-11-21T08:00/2026-11-21T09:00", "has no offset from UTC"),
        ("2026-11-21T09:00Z/2026-11-21T08:00Z", "ends before it begins"),
        ("day:2020-01-01", "has no record of day:2020-01-01"),
    ],
)
def test_what_is_no_total_is_one_line(history, total, says) -> None:
    with pytest.raises(InputError, match=says):
        explain(history[0], total)


def test_a_day_begins_with_the_first_shift() -> None:
    from beltscape.production.settings import ShiftSettings

    shifts = (ShiftSettings(name="early", begins="06:00"), ShiftSettings(name="late", begins="18:00"))
    found = parse_total("day:2026-11-21", "Europe/Berlin", shifts)
    assert found.since_ns == BEGIN_NS - 3 * 3600 * SECOND_NS  # 06:00 in Berlin is 05:00 UTC
    assert found.until_ns - found.since_ns == 24 * 3600 * SECOND_NS


def test_a_hidden_alarm_names_who_hid_it() -> None:
    def event(number: int, **parameters: str) -> Event:
        return Event(number, at(number), "alarm", "dust", "raised: dust", "dora", json.dumps(parameters))

    events = [
        event(1, state="raised"),
        event(2, action="shelved", reason="sweeping"),
        event(9, state="clear"),
    ]
    (episode,) = pair_alarms(events, at(0), at(5))
    assert episode.hidden_by == ["dora: sweeping"]
    assert episode.ended_ns == at(9)
    assert pair_alarms(events, at(10), at(20)) == []
