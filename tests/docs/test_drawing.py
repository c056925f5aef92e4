"""The drawings of the manual equal what their programs draw from the settings."""

from __future__ import annotations

import runpy

import pytest

from tests.docs.system import ROOT

FIGURES = ("pyramid.svg", "candidates.svg", "hole.svg", "continuation.svg")


@pytest.fixture(autouse=True)
def tools_importable(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tools/drawings")


def test_rig_drawing_is_current():
    module = runpy.run_path(str(ROOT / "tools/drawings/draw_rig.py"))
    assert module["OUT"].read_text() == module["drawing"](), "run python tools/drawings/draw_rig.py"


@pytest.mark.parametrize("name", FIGURES)
def test_figure_is_current_and_shown(name):
    module = runpy.run_path(str(ROOT / "tools/drawings/draw_figures.py"))
    assert set(module["FIGURES"]) == set(FIGURES)
    drawn = module["FIGURES"][name]()
    assert (module["OUT"] / name).read_text() == drawn, "run python tools/drawings/draw_figures.py"
    assert any(f"images/{name}" in page.read_text() for page in (ROOT / "docs").rglob("*.md"))
