"""Charts for wide screens alone, for tests of commands that look at no report.

A chart is drawn twice, and drawing takes up to half of a command's time on a small capture. Tests of reports draw
both forms.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager

import pytest
from matplotlib.figure import Figure

from beltscape.report.drawing import charts
from beltscape.report.drawing.plots import NARROW, Form, to_svg


@contextmanager
def leave_out_narrow_charts() -> Generator[None]:
    """Leave the charts for phones empty until the context ends."""

    def draw(plot: Callable[[Form], Figure], form: Form) -> str:
        return '<svg viewBox="0 0 1 1"></svg>' if form is NARROW else to_svg(plot, form)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(charts, "to_svg", draw)
        yield
