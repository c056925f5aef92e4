"""Numbers as the report writes them, and the columns that every comparison of depth has."""

from __future__ import annotations

import numpy as np

from beltscape.evaluate.paper.surfaces import ScoredDepth

SCENES = {"belt_empty": "empty belt", "belt_loaded": "loaded belt", "module": "calibration module"}
METRICS = ("measured", "< 1 mm", "< 0.25 mm", "median", "bias", "robust σ", "gross", "σ ratio")
UNITS = (
    "Median, bias and robust σ in mm, more than 6 px from a true step; gross: off by more than 5 mm, of the "
    "measured; σ ratio: actual over predicted σ."
)
_MANY = 1000
ERROR_MM = 1.0
"""Fullest colour of the error pictures."""


def metrics(one: ScoredDepth) -> list[str]:
    """Cells for `METRICS`, of the surface that the scene is about."""
    d = one.score.depth
    return [
        f"{d.coverage:.1%}", f"{d.within_1mm:.1%}", f"{d.within_quarter_mm:.1%}", number(d.interior_median_mm, 3),
        signed(d.interior_bias_mm), number(d.interior_robust_sigma_mm, 3), percent(d.gross),
        number(d.sigma_ratio, 2),
    ]  # fmt: skip


def number(value: float, digits: int) -> str:
    """So many digits; a dash for NaN."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def signed(value: float) -> str:
    """An error in mm with its sign."""
    return f"{value:+.3f}".replace("-", "−") if np.isfinite(value) else "–"


def percent(value: float) -> str:
    """A share."""
    return f"{value:.1%}" if np.isfinite(value) else "–"


def ratio(value: float) -> str:
    """How many times; inf over nothing."""
    if value > _MANY:
        return f"over {_MANY} ×" if np.isfinite(value) else "none without"
    return f"{value:.1f} ×"
