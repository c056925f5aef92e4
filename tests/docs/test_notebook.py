"""The notebook runs from its first cell to its last, and what its cells end with shows itself."""

from __future__ import annotations

import ast
import contextlib
import json
from typing import Any

import pytest

from tests.docs.system import ROOT

NOTEBOOK = ROOT / "docs/tutorials/notebook.ipynb"


def run_cell(source: str, names: dict[str, Any]) -> Any:
    """Run a cell and return the value of its last line, as a notebook does."""
    tree = ast.parse(source)
    last = tree.body[-1]
    if not isinstance(last, ast.Expr):
        exec(compile(tree, "cell", "exec"), names)
        return None
    tree.body.pop()
    exec(compile(tree, "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)


@pytest.mark.thorough
def test_the_notebook_runs(tmp_path):
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    with contextlib.chdir(tmp_path):
        shown = [run_cell("".join(cell["source"]), names) for cell in cells if cell["cell_type"] == "code"]
    assert sum(value is not None for value in shown) == len(shown)
    pictures = [value._repr_html_() for value in shown if hasattr(value, "_repr_html_")]
    assert len(pictures) == 5
    assert all("data:image/png;base64," in html for html in pictures)
    assert abs(names["volume"].volume_mm3 * 1e-6 / names["true_litres"] - 1) < 0.03
    assert (tmp_path / "load.ply").stat().st_size > 1_000_000


def test_the_notebook_holds_no_results():
    """Results would grow old unseen; whoever opens the notebook makes them."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert all(cell["outputs"] == [] for cell in cells if cell["cell_type"] == "code")
