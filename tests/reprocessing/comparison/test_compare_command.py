"""The command: summary, document, report, and one line with exit code 2 for what cannot be compared."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from beltscape.cli.main import main
from beltscape.reprocessing.comparison.page import render_comparison
from beltscape.reprocessing.comparison.texts import summarise
from tests.reprocessing.comparison.histories import (
    OTHER_RIG,
    compared,
    mark_missing,
    measured,
    noisy,
    scaled,
    with_strips,
    write_history,
)
from tests.thorough import list_cases

RECORDS = measured(80)


@pytest.fixture(scope="module")
def histories(tmp_path_factory):
    folder = tmp_path_factory.mktemp("histories")
    write_history(folder / "a", RECORDS)
    write_history(
        folder / "store" / "history", mark_missing(noisy(scaled(RECORDS, 1.05)), range(40, 45)), OTHER_RIG
    )
    write_history(folder / "again", [replace(record, wall_ns=record.wall_ns + 5) for record in RECORDS])
    write_history(folder / "empty", [])
    return folder


def test_the_summary_says_how_much_where_and_why(histories, capsys):
    assert main(["compare", str(histories / "a"), str(histories / "store")]) == 0
    text = capsys.readouterr().out
    assert text.startswith("B differs from A beyond the uncertainty of their difference")
    for part in ("mass   B - A +", "σ of the difference: rig or empty belt are not the same", "valid → missing",
                 "frames lost", "rig: differs, A aaaaaaaaaaaa, B bbbbbbbbbbbb", "empty belt: the same",
                 "Only A has"):  # fmt: skip
        assert part in text


def test_the_same_records_of_another_run_are_identical(histories, capsys):
    assert main(["compare", str(histories / "a"), str(histories / "again"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["identical"]
    assert document["agrees"]
    assert document["verdict"].startswith("A and B are identical to the last digit")


def test_report_and_document_have_the_same_figures(histories, tmp_path, capsys):
    words = ["compare", str(histories / "a"), str(histories / "store"), "--out", str(tmp_path / "out")]
    assert main(words) == 0
    capsys.readouterr()
    document = json.loads((tmp_path / "out/comparison.json").read_text())
    page = (tmp_path / "out/report.html").read_text()
    assert document["format"] == "beltscape-comparison/1"
    assert document["verdict"] in page
    assert document["volume_m3"]["difference"] == pytest.approx(
        document["volume_m3"]["second"] - document["volume_m3"]["first"]
    )
    assert sum(document["intervals"]["difference_m3"]) == pytest.approx(document["volume_m3"]["difference"])
    whole = document["b"]["volume_m3"] - document["a"]["volume_m3"]
    alone = document["b"]["alone_m3"] - document["a"]["alone_m3"]
    assert whole == pytest.approx(document["volume_m3"]["difference"] + alone)
    assert main(words) == 0  # its own earlier result is replaced


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["a", "nothing"], "does not exist"),
        (["a", "."], "has no history.db"),
        (["empty", "a"], "has no records"),
        (["a", "a/history.db"], "is no folder"),
        (["a", "store", "--out", "a"], "is an input"),
        (["a", "store", "--out", "store/out"], "lies in the history"),
        (["a"], "the following arguments are required: B"),
    ],
)
def test_what_cannot_be_compared_is_one_line(histories, monkeypatch, capsys, words, says):
    monkeypatch.chdir(histories)
    assert main(["compare", *words]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("beltscape")]
    assert len(errors) == 1
    assert says in errors[0]
    assert not (histories / "store/out").exists()


def test_changes_of_other_values_than_volumes_are_named():
    shown = summarise(compared(RECORDS, [replace(record, cameras=4) for record in RECORDS]))
    assert "the same volumes to the last digit" in shown
    assert "cameras (80)" in shown


@pytest.mark.parametrize("time_ns", list_cases([None, 1, 10**18], [None]))
@pytest.mark.parametrize("speed_mm_s", [1500.0, float("nan")])
def test_a_page_is_made_of_any_clock_and_speed(time_ns, speed_mm_s):
    def change(strip):
        return {
            "time_ns": None if time_ns is None else time_ns * (1 + int(strip.frame)) // 10,
            "speed_mm_s": speed_mm_s,
            "density_kg_m3": float("nan"),
        }

    records = with_strips(RECORDS[:12], change)
    page = render_comparison(compared(records, noisy(records)))
    assert ("flow, m³/h" in page) == (speed_mm_s == 1500.0)
    assert ("belt, m</text>" in page) == (time_ns is None)
    assert "Masses are left out" in page


def test_a_page_of_one_record_and_of_empty_belt():
    for records in (RECORDS[:1], with_strips(RECORDS[:5], lambda _: {"volume_mm3": 0.0, "sigma_mm3": 0.0})):
        comparison = compared(records, records)
        assert "identical to the last digit" in render_comparison(comparison)
        assert "identical to the last digit" in summarise(comparison)
