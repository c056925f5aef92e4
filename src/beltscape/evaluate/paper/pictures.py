"""Pictures and charts of the comparisons, with common colour scales, and the formatting of their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.figure import Figure

from beltscape.evaluate.paper.dimensions import DimensionRow
from beltscape.evaluate.paper.surfaces import ScoredDepth
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.depth_picture import GAPS, NO_ERROR, color_errors, shade_depth
from beltscape.report.drawing.legend import DIFFERENCE, NEAR_TO_FAR, Scale
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.pictures import Panel, quantile_range
from beltscape.report.drawing.plots import Form, make_panels

if TYPE_CHECKING:
    from matplotlib.axes import Axes


ROLES = {"paper": "fourth", "pairwise": "second", "multiview": "first", "time of flight": "third"}
"""Method → role of its bars in the palette."""


def make_depth_panels(found: Sequence[ScoredDepth], titles: Mapping[str, str]) -> list[Panel]:
    """Return the depths of a scene by several methods and the truth on one colour scale.

    ``titles`` tells by whom it was measured → what stands over its picture; all are on grids of one size.
    """
    truth = found[0].truth.depth_mm
    near, far = quantile_range(truth, 0.002)
    scale = Scale(near, far, NEAR_TO_FAR, label="depth, mm")
    panels = [
        Panel(
            shade_depth(one.depth.depth_mm, scale),
            titles[one.by],
            scale,
            GAPS,
            f"{one.depth.coverage:.0%} measured",
        )
        for one in found
    ]
    return [*panels, Panel(shade_depth(truth.astype(np.float32), scale), "truth", scale)]


def make_error_panels(
    found: Sequence[ScoredDepth], titles: Mapping[str, str], *, limit_mm: float
) -> list[Panel]:
    """Return the errors of several methods; ``limit_mm`` is the limit of the colour scale."""
    scale = Scale(-limit_mm, limit_mm, DIFFERENCE, label="measured minus true depth, mm")
    return [
        Panel(
            color_errors(one.depth.depth_mm - one.truth.depth_mm, one.truth.depth_mm, scale),
            f"{titles[one.by]}: error", scale, NO_ERROR, f"{one.score.depth.within_1mm:.1%} < 1 mm",
        )
        for one in found
    ]  # fmt: skip


def make_dimension_chart(rows: Sequence[DimensionRow], by: Mapping[str, str]) -> Chart:
    """Return the absolute errors of the dimensions, the paper's and those of ``by`` (method → name)."""
    who = {"paper": "the paper, as published", **by}
    key = ChartKey([KeyEntry(name, ROLES[one], "area") for one, name in who.items()])
    caption = "Absolute errors; bars to the left are better, each line is a factor of ten."
    return Chart.draw(partial(_plot_dimensions, rows, list(who)), caption, key)


def _plot_dimensions(rows: Sequence[DimensionRow], who: Sequence[str], form: Form) -> Figure:
    figure, (axis,) = make_panels(1, form, height=60 + 30 * len(rows), narrow_height=60 + 40 * len(rows))
    place = np.arange(len(rows), dtype=np.float64)
    high = (0.54 if form.narrow else 0.8) / len(who)
    for k, key in enumerate(who):
        errors = np.abs([_paper_error(row) if key == "paper" else row.error_mm(key) for row in rows])
        axis.barh(
            place + (k - (len(who) - 1) / 2) * high,
            np.maximum(errors, _LEAST_MM) - _LEAST_MM,
            high,
            left=_LEAST_MM,
            color=light(ROLES[key]),
        )
    _set_logarithmic(axis, "x")
    axis.set(xlim=(_LEAST_MM, 12), xlabel="absolute error, mm", yticks=place)
    axis.set_yticklabels(["" if form.narrow else row.dimension.name for row in rows])
    for row, top in zip(
        rows if form.narrow else (), place, strict=False
    ):  # a phone has no room beside the bars
        axis.text(_LEAST_MM * 1.1, top - 0.29, row.dimension.name, va="bottom")
    axis.set_ylim(len(rows) - 0.5, -0.7)
    axis.grid(axis="x")
    return figure


def make_motion_chart(travels_mm: Sequence[float], found: Sequence[ScoredDepth], ours: ScoredDepth) -> Chart:
    """Return the share within 1 mm and the median error of structured light over the travel between images."""
    key = ChartKey(
        [
            KeyEntry("structured light, 12 pictures", "second"),
            KeyEntry("Beltscape, one instant", "first", "dashed"),
        ]
    )
    caption = "Structured light on a moving belt, and Beltscape on the same rocks."
    return Chart.draw(partial(_plot_motion, travels_mm, found, ours), caption, key)


def _plot_motion(
    travels_mm: Sequence[float], found: Sequence[ScoredDepth], ours: ScoredDepth, form: Form
) -> Figure:
    figure, axes = make_panels(2, form, columns=2, height=270, narrow_height=220)
    x = np.array([travel if travel > 0 else _AT_REST_MM for travel in travels_mm])
    values = (
        [100 * one.score.depth.within_1mm for one in found],
        [one.score.depth.interior_median_mm for one in found],
    )
    lines = (100 * ours.score.depth.within_1mm, ours.score.depth.interior_median_mm)
    titles = ("within 1 mm of the truth, %", "median error away from edges, mm")
    for axis, y, own, title in zip(axes, values, lines, titles, strict=True):
        axis.plot(x, y, "o-", color=light("second"))
        axis.axhline(own, color=light("first"), linestyle="--")
        axis.set_xscale("log")
        axis.set(xlabel="belt between two pictures, mm", title=title)
        axis.set_xticks(x, ["at rest" if t == 0 else f"{t:g}" for t in travels_mm], minor=False)
        axis.minorticks_off()
        axis.grid()
    axes[0].set_ylim(0, 100)
    _set_logarithmic(axes[1], "y")
    return figure


def _set_logarithmic(axis: Axes, which: Literal["x", "y"]) -> None:
    """Make an axis logarithmic, with plain numbers at its ticks."""
    (axis.set_xscale if which == "x" else axis.set_yscale)("log")
    chosen = axis.xaxis if which == "x" else axis.yaxis
    chosen.set_major_formatter(lambda value, _place: f"{value:g}")
    chosen.set_minor_formatter(lambda _value, _place: "")


_LEAST_MM = 0.001
"""Left end of the logarithmic axis of errors; smaller errors have no bar."""
_AT_REST_MM = 0.01
"""Place of no travel on a logarithmic axis of travels, a decade below the shortest one."""


def _paper_error(row: DimensionRow) -> float:
    return row.dimension.table2_mm - row.dimension.actual_mm


SCENE_NAMES = {"belt_empty": "empty belt", "belt_loaded": "loaded belt", "module": "calibration module"}
"""Scene → its name in texts."""
METRICS = ("measured", "< 1 mm", "< 0.25 mm", "median", "bias", "robust σ", "gross", "σ ratio")
UNITS = (
    "Median, bias and robust σ in mm, more than 6 px from a true step; gross: off by more than 5 mm, of the "
    "measured; σ ratio: actual over predicted σ."
)
_MANY = 1000
"""Ratio above which only "over 1000 ×" is written."""
ERROR_MM = 1.0
"""Limit of the colour scale of the error pictures: four times the tolerance of the column "< 0.25 mm"."""


def format_metrics(one: ScoredDepth) -> list[str]:
    """Return the cells of `METRICS` for the scene's main region."""
    d = one.score.depth
    return [
        f"{d.coverage:.1%}", f"{d.within_1mm:.1%}", f"{d.within_quarter_mm:.1%}",
        format_number(d.interior_median_mm, 3),
        format_signed(d.interior_bias_mm), format_number(d.interior_robust_sigma_mm, 3), format_percent(d.gross),
        format_number(d.sigma_ratio, 2),
    ]  # fmt: skip


def format_number(value: float, digits: int) -> str:
    """Return a number with the given digits; a dash for NaN."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def format_signed(value: float) -> str:
    """Return an error in mm with its sign."""
    return f"{value:+.3f}".replace("-", "−") if np.isfinite(value) else "–"


def format_percent(value: float) -> str:
    """Return a share in percent."""
    return f"{value:.1%}" if np.isfinite(value) else "–"


def format_ratio(value: float) -> str:
    """Return a ratio; inf for a zero denominator."""
    if value > _MANY:
        return f"over {_MANY} ×" if np.isfinite(value) else "none without"
    return f"{value:.1f} ×"
