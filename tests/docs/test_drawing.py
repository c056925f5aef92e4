"""The drawing of a rig is the one that its program draws, of the laboratory as it is."""

from __future__ import annotations

import runpy

from docs.system import ROOT


def test_the_drawing_is_current():
    module = runpy.run_path(str(ROOT / "tools/draw_rig.py"))
    assert module["OUT"].read_text() == module["drawing"](), "run python tools/draw_rig.py"
