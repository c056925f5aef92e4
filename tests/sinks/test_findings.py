"""Findings in the historian: series, retention, day files, migration."""

from __future__ import annotations

import sqlite3
from math import nan

import numpy as np
import pytest

from beltscape.core.findings import Effect, Finding
from beltscape.sinks.historian import CheckKey, Historian, StoredFinding, database
from beltscape.sinks.historian.findings import read_findings
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import ledger

DAY_NS = 86_400_000_000_000
BEGIN_NS = 20_700 * DAY_NS
SECOND_NS = 1_000_000_000


def make_finding(
    second: int, *, check="zero_shift", subject="", value: float | None = None, text=""
) -> StoredFinding:
    effect: Effect = "degraded" if text else "none"
    shown = 0.1 * (second % 10) if value is None else value
    return StoredFinding(
        BEGIN_NS + second * SECOND_NS, Finding(check, shown, 0.05, 2.0, "mm", subject, text, effect)
    )


def open_historian(folder, **settings) -> Historian:
    return Historian(folder, HistorySettings(reserve_mib=1, **settings))


def test_a_series_has_means_ranges_limits_and_faults(tmp_path):
    historian = open_historian(tmp_path)
    historian.add_findings([make_finding(s) for s in range(60)])
    historian.add_findings([make_finding(60, value=3.0, text="the belt has risen: set zero")])
    historian.add_findings([make_finding(61, value=nan)])
    series = historian.finding_series("zero_shift", "", BEGIN_NS, BEGIN_NS + 80 * SECOND_NS, 8)
    assert series.width_ns == 10 * SECOND_NS
    assert series.mean[:6] == pytest.approx(0.45)
    assert (series.low[0], series.high[0]) == (0.0, pytest.approx(0.9))
    assert series.mean[6] == 3.0 and np.isnan(series.mean[7])
    assert series.limit[0] == 2.0 and series.sigma[0] == pytest.approx(0.05)
    assert series.effect.tolist() == [0, 0, 0, 0, 0, 0, 1, 0]
    assert series.faults.sum() == 1
    historian.close()


def test_subjects_are_series_of_their_own(tmp_path):
    historian = open_historian(tmp_path)
    historian.add_findings(
        [make_finding(1, check="sharpness", subject=name, value=v) for name, v in (("a", 1), ("b", 2))]
    )
    assert historian.checks() == (CheckKey("sharpness", "a", "mm"), CheckKey("sharpness", "b", "mm"))
    period = (BEGIN_NS, BEGIN_NS + 10 * SECOND_NS)
    assert historian.finding_series("sharpness", "b", *period, 1).mean == [2.0]
    assert np.isnan(historian.finding_series("sharpness", "c", *period, 1).mean).all()
    historian.close()


def test_a_long_period_comes_from_the_sums(tmp_path):
    historian = open_historian(tmp_path)
    historian.add_findings([make_finding(600 * k, value=float(k)) for k in range(6 * 72)])
    series = historian.finding_series("zero_shift", "", BEGIN_NS, BEGIN_NS + 3 * DAY_NS, 72)
    assert len(series.mean) == 72
    assert series.mean == pytest.approx(np.arange(72) * 6 + 2.5)
    assert series.low == pytest.approx(np.arange(72) * 6) and series.high == pytest.approx(
        np.arange(72) * 6 + 5
    )
    historian.close()


def test_closed_days_move_to_files_and_remain_readable(tmp_path):
    historian = open_historian(tmp_path, database_days=2)
    for day in range(5):
        historian.add_findings(
            [
                make_finding(day * 86_400 + s, check=check, subject=name, value=float(day))
                for s in range(20)
                for check, name in (("zero_shift", ""), ("sharpness", "cam1"), ("sharpness", "cam2"))
            ]
        )
    now = BEGIN_NS + 4 * DAY_NS + 60 * SECOND_NS
    historian.maintain(now)
    assert historian.trouble == ""
    files = sorted((tmp_path / "findings").glob("*.parquet"))
    assert len(files) == 4
    rows = read_findings(files[1], "sharpness", "cam2", (0, 1 << 62))
    assert len(rows) == 20 and rows[0][:3] == ("sharpness", "cam2", "mm") and rows[0][4:6] == (1.0, 0.05)
    connection = sqlite3.connect(tmp_path / "history.db")
    ((left,),) = connection.execute("SELECT count(*) FROM findings").fetchall()
    assert left == 2 * 60  # the open day and the newest closed one
    connection.close()
    for day in range(5):
        begin = BEGIN_NS + day * DAY_NS
        series = historian.finding_series("sharpness", "cam1", begin, begin + DAY_NS, 1)
        assert series.mean == [float(day)], day
    historian.maintain(now)
    assert len(list((tmp_path / "findings").glob("*.parquet"))) == 4
    historian.close()


def test_a_reopened_day_gets_another_file(tmp_path):
    historian = open_historian(tmp_path)
    historian.add_findings([make_finding(s) for s in range(5)] + [make_finding(86_400 * 3)])
    historian.maintain(BEGIN_NS + 3 * DAY_NS)
    historian.add_findings(
        [make_finding(100 + s) for s in range(5)] + [make_finding(86_400 * 4)]
    )  # the clock was back
    historian.maintain(BEGIN_NS + 4 * DAY_NS)
    names = sorted(path.name for path in (tmp_path / "findings").glob("*.parquet"))
    assert len(names) == 3 and names[0].endswith("-2.parquet")
    series = historian.finding_series("zero_shift", "", BEGIN_NS, BEGIN_NS + DAY_NS, 1)
    assert series.mean[0] == pytest.approx(0.2)
    historian.close()


def test_old_files_are_removed(tmp_path):
    historian = open_historian(tmp_path, database_days=1, file_days=2)
    historian.add_findings([make_finding(day * 86_400) for day in range(6)])
    historian.maintain(BEGIN_NS + 5 * DAY_NS + SECOND_NS)
    assert len(list((tmp_path / "findings").glob("*.parquet"))) == 2
    historian.close()


def test_files_of_a_lost_database_are_adopted(tmp_path):
    historian = open_historian(tmp_path, database_days=1)
    historian.add_findings([make_finding(s) for s in range(5)] + [make_finding(86_400 * 2)])
    historian.maintain(BEGIN_NS + 2 * DAY_NS + SECOND_NS)
    historian.close()
    for path in tmp_path.glob("history.db*"):
        path.unlink()
    again = open_historian(tmp_path, database_days=1)
    again.maintain(BEGIN_NS + 2 * DAY_NS + SECOND_NS)
    assert again.finding_series("zero_shift", "", BEGIN_NS, BEGIN_NS + DAY_NS, 1).mean[0] == pytest.approx(
        0.2
    )
    again.close()


def test_a_database_of_an_older_version_keeps_records_and_events(tmp_path, monkeypatch):
    with monkeypatch.context() as older:
        older.setattr(database, "MIGRATIONS", database.MIGRATIONS[:2])
        connection = database.open_writer(tmp_path / "history.db")
    connection.execute(
        "INSERT INTO events (wall_ns, kind, name, text, by) VALUES (1, 'alarm', 'slip', 'raised', '')"
    )
    connection.close()
    historian = open_historian(tmp_path)
    (event,) = historian.events(0, 10)
    assert (event.name, event.text, event.parameters) == ("slip", "raised", "")
    historian.write(ledger(3))
    historian.add_findings([make_finding(0)])
    assert historian.repair_message == "" and historian.ledger_end.number == 3
    historian.close()


def test_an_event_keeps_the_parts_of_its_text(tmp_path):
    historian = open_historian(tmp_path)
    historian.add_event(
        "alarm", "slip", "raised: 5 %", wall_ns=5, parameters={"state": "raised", "value": 5.0}
    )
    (event,) = historian.events(0, 10)
    assert event.parameters == '{"state": "raised", "value": 5.0}'
    historian.close()
