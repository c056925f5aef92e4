"""The figure tables of the manual equal the newest benchmark results."""

from __future__ import annotations

import runpy

import pytest

from tests.docs.system import ROOT

TOOL = runpy.run_path(str(ROOT / "tools/write_figures.py"))


@pytest.mark.parametrize("page", TOOL["PAGES"])
def test_the_figures_are_those_of_the_results(page):
    text = (ROOT / page).read_text()
    assert "<!-- figures: " in text
    assert TOOL["filled"](text, TOOL["RESULTS"].read_text()) == text, "run python tools/write_figures.py"


def test_another_result_changes_a_page():
    text, results = (ROOT / "docs/explanation/matching.md").read_text(), TOOL["RESULTS"].read_text()
    assert TOOL["filled"](text, results.replace("0.0023", "0.0099")) != text
