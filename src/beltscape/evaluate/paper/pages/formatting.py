"""Formatting of the report's numbers, and the common columns of its depth comparisons."""

from __future__ import annotations

import numpy as np

from beltscape.evaluate.paper.surfaces import ScoredDepth

SCENES = {"belt_empty": "empty belt", "belt_loaded": "loaded belt", "module": "calibration module"}
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
