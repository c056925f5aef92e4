"""The page of the models is what its program writes."""

from __future__ import annotations

import runpy

from tests.docs.system import ROOT

TOOL = runpy.run_path(str(ROOT / "tools/write_model_cards.py"))


def test_the_page_of_models_is_up_to_date() -> None:
    assert TOOL["PAGE"].read_text("utf-8") == TOOL["write_page"](), "run python tools/write_model_cards.py"
