"""RESULTS.md: each section is measured by itself and states its commit."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ORDER = ["Calibration", "Kernels"]


@pytest.fixture
def results(monkeypatch):
    spec = importlib.util.spec_from_file_location("benchmark_results", ROOT / "benchmarks" / "results.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


def section(results, title, lines, commit="0000000"):
    return results.Section(title, tuple(lines), commit, "2026-01-01", "v3", "0.1")


def test_a_section_measured_anew_replaces_its_own_and_keeps_the_others(results, tmp_path):
    path = tmp_path / "RESULTS.md"
    first = [section(results, title, ["old", "", "| a |"], "aaaaaaa") for title in ORDER]
    results.write_results(path, "Head.", first, ORDER)
    results.write_results(path, "Head.", [section(results, "Kernels", ["new"], "bbbbbbb")], ORDER)
    read = {s.title: s for s in results.read_results(path)}
    assert read["Calibration"] == first[0]
    assert (read["Kernels"].lines, read["Kernels"].commit) == (("new",), "bbbbbbb")
    assert [s.title for s in results.read_results(path)] == ORDER


def test_a_section_of_an_older_commit_says_how_old_it_is(results, tmp_path, monkeypatch):
    counts = {"old0000..HEAD": "7", "new0000..HEAD": "0"}
    monkeypatch.setattr(results, "_git", lambda *words: counts.get(words[-1], ""))
    path = tmp_path / "RESULTS.md"
    sections = [
        section(results, "Calibration", ["a"], "old0000"),
        section(results, "Kernels", ["b"], "new0000"),
    ]
    results.write_results(path, "Head.", sections, ORDER)
    old, new = (line for line in path.read_text().splitlines() if line.startswith("*Measured"))
    assert "old0000" in old and "7 commits before" in old
    assert "new0000" in new and "before the state" not in new
    assert [s.commit for s in results.read_results(path)] == ["old0000", "new0000"]


def test_every_section_that_ships_states_its_commit(results):
    text = (ROOT / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8")
    titles = [line[3:] for line in text.splitlines() if line.startswith("## ")]
    assert titles and [s.title for s in results.read_results(ROOT / "benchmarks" / "RESULTS.md")] == titles


def test_uncommitted_changes_are_marked_by_a_plus(results, monkeypatch):
    said = {"status": " M src/x.py", "rev-parse": "abc1234"}
    monkeypatch.setattr(results, "_git", lambda *words: said[words[0]])
    assert results.current_commit() == "abc1234+"
