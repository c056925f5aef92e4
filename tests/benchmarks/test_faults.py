"""The bench of faults: its rows can be played, and its truth is that of the rendered heap."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from beltscape.core.ledger import BeltRecord, FlowRecord

ROOT = Path(__file__).resolve().parents[2]
STEP_MM, ROUND = 50.0, 20


@pytest.fixture(autouse=True)
def on_path(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))


def area_at(own_mm):
    """A heap of 400 mm on a round of 1000 mm, mm²."""
    return np.where(np.abs(own_mm) < 200, 5000.0 + 10.0 * own_mm, 0.0)


def make_capture():
    y = np.arange(-300.0, 300.5, 1.0)
    return SimpleNamespace(
        frames=ROUND,
        round_mm=ROUND * STEP_MM,
        position_mm=lambda frame: frame * STEP_MM,
        area=(y, area_at(y)),
    )


def make_records(count, *, place_mm=130.0, length_mm=STEP_MM):
    """Records of a sound ledger; the heap's own y is ``place_mm`` less the belt's position."""
    records = []
    for i in range(count):
        begin, end = 900.0 + i * STEP_MM, 900.0 + (i + 1) * STEP_MM
        along = np.arange(begin + 0.5, end, 1.0)
        own = (place_mm - along + 500.0) % 1000.0 - 500.0
        volume = float(area_at(own).sum())
        rates = (2e4, 400.0, 1500.0, 1.0, 1.0)
        strip = FlowRecord(f"{i:05d}", i, end, (begin, end), volume / STEP_MM, volume, *rates, "measured")
        ledger = (900.0 + i * length_mm, 900.0 + (i + 1) * length_mm)
        records.append(BeltRecord(i + 1, 1, ledger, "valid", "", 0, strip, 1e6, 5, None))
    return records


def test_sound_ledger_agrees_with_the_truth():
    compare = import_module("faults.truth").compare
    records = make_records(60)
    compared = compare(make_capture(), records, 40)
    np.testing.assert_allclose(compared.true_mm, STEP_MM)
    np.testing.assert_allclose(compared.true_mm3, [r.volume_mm3 for r in records], atol=10_000.0)
    total = compared.select(("valid",), [True] * 60)
    assert total.covers_truth()
    assert abs(total.relative_error) < 3e-3


def test_frozen_encoder_loses_length_but_not_truth():
    compare = import_module("faults.truth").compare
    records = make_records(60)
    end = records[39].belt_mm[1]
    frozen = [
        BeltRecord(r.number, 1, (end, end), "valid", "", 0, r.strip, 1e6, 5, None) for r in records[40:]
    ]
    total = compare(make_capture(), [*records[:40], *frozen], 40).select(
        ("valid",), [False] * 40 + [True] * 20
    )
    assert total.length_mm == 0
    assert total.true_mm == pytest.approx(20 * STEP_MM)
    assert total.true_mm3 == pytest.approx(399 * 5000.0, rel=1e-6)  # samples within the heap


def test_every_row_is_a_fault_that_the_simulator_knows():
    make_faults = import_module("faults.feed").make_faults
    cases = import_module("faults.cases").read_cases()
    replacements = import_module("faults.replacements").REPLACEMENTS
    disturbances = import_module("faults.disturbances").DISTURBANCES
    assert len({case.name for case in cases}) == len(cases)
    assert sum(case.is_short for case in cases) >= 5
    for case in cases:
        started = [fault.first for _, fault in make_faults(case.faults, 60).list_faults()]
        assert started == [60] * len(started)
        assert case.is_sound or case.named_by or case.replaced
        assert (
            bool(started)
            or case.zero_faults
            or case.is_sound
            or case.replaced
            or case.disturbed
            or case.step_mm
        )
        assert not case.replaced or case.replaced in replacements
        assert not case.disturbed or case.disturbed or case.step_mm in disturbances


def test_results_of_parts_add_up_to_one_table(tmp_path):
    results, row = import_module("faults.results"), import_module("faults.verdict").RowResult
    results.keep_result(tmp_path, row("one", "", "", "", "", ("late",)), "a1")
    results.keep_result(tmp_path, row("two", "", "", "", "", ()), "a1")
    results.keep_result(tmp_path, row("one", "", "", "", "", ()), "b2")
    kept = results.read_results(tmp_path)
    assert {name: one.commit for name, one in kept.items()} == {"one": "b2", "two": "a1"}
    assert all(one.result.passes for one in kept.values())
    assert results.describe_commits(kept.values()) == "b2 (1 rows), a1 (1 rows)"


def test_single_rows_of_the_table_are_renewed(tmp_path: Path) -> None:
    """In their section alone, with the commit, or are added to it; the count follows; no section is refused."""
    table, results = import_module("faults.table"), import_module("faults.results")
    row, path = import_module("faults.verdict").RowResult, tmp_path / "FAULTS.md"
    late, sound = row("late", "≤ 2 s", "", "", "", ("not named",)), row("sound", "nothing", "", "", "", ())
    table.write_table(path, [("Large", [late, sound]), ("Small", [late])], [("fire", "elsewhere")], "", "a1")
    before = path.read_text("utf-8").splitlines()
    assert "1 passed, 2 failed." in before
    renewed = {"late": results.KeptResult(row("late", "≤ 2 s", "1 s", "", "", ()), "b2")}
    table.renew_rows(path, [("Large", renewed), ("Small", {})])
    after = path.read_text("utf-8").splitlines()
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert [new for _, new in changed[1:]] == ["| late | ≤ 2 s | 1 s |  |  | passed |", "2 passed, 1 failed."]
    assert "Renewed since: *late* (Large) at commit b2" in changed[0][1]
    table.renew_rows(path, [("Large", {"new": results.KeptResult(row("new", "", "", "", "", ()), "c3")})])
    lines = path.read_text("utf-8").splitlines()
    assert (
        lines.index("| new |  |  |  |  | passed |")
        == lines.index("| sound | nothing |  |  |  | passed |") + 1
    )
    assert "3 passed, 1 failed." in lines
    with pytest.raises(ValueError, match="no section 'Other'"):
        table.renew_rows(path, [("Other", renewed)])
