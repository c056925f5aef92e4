"""Phase-shifting profilometry: phase of shifted fringes, its σ, and the unwrapped projector column.

N images of intensity A + B·cos(φ − 2πk/N) give by least squares (Zuo et al., Optics and Lasers in Engineering 109,
2018, 23-59, doi:10.1016/j.optlaseng.2018.04.019)

    φ = atan2(Σ Iₖ sin 2πk/N, Σ Iₖ cos 2πk/N),   B = 2/N · √(Σ² + Σ²),   σ_φ = √(2/N) · σ_I / B.

A coarse fringe set determines the period of the next finer one: hierarchical temporal unwrapping
(Zuo et al., Optics and Lasers in Engineering 85, 2016, 84-103, doi:10.1016/j.optlaseng.2016.04.022, section 2.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Phase:
    """The phase of one fringe set."""

    phase: Array
    """(H, W) radians in 0 … 2π."""
    modulation: Array
    """(H, W) B, counts."""
    sigma: Array
    """(H, W) one standard deviation of the phase, radians; inf without modulation."""


def estimate_phase(images: NDArray[np.floating], noise: NDArray[np.floating]) -> Phase:
    """Return the phase of N ≥ 3 images (N, H, W) shifted by 1/N period each; ``noise`` (H, W) is their σ, counts."""
    steps = 2 * np.pi * np.arange(len(images)) / len(images)
    sine, cosine = (np.tensordot(f(steps), images.astype(np.float64), 1) for f in (np.sin, np.cos))
    modulation = 2 / len(images) * np.hypot(sine, cosine)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.sqrt(2 / len(images)) * noise / modulation
    return Phase(
        np.mod(np.arctan2(sine, cosine), 2 * np.pi), modulation, np.where(modulation > 0, sigma, np.inf)
    )


def unwrap_phases(phases: Sequence[Phase], periods_px: Sequence[float], gate: float) -> tuple[Array, Array]:
    """Return the projector column (H, W) and its σ (H, W), px; NaN where two fringe sets contradict each other.

    Parameters
    ----------
    phases
        Coarse first; the first has a single period.
    periods_px
        Of each, on the projector.
    gate
        Largest difference of two sets in units of their common σ; it is also limited to a third of the finer period.
    """
    column = phases[0].phase / (2 * np.pi) * periods_px[0]
    sigma = phases[0].sigma / (2 * np.pi) * periods_px[0]
    # the single fringe of the first set wraps at the image border, so the phase may fall to either side there
    for phase, period in zip(phases[1:], periods_px[1:], strict=True):
        fine, fine_sigma = (value / (2 * np.pi) * period for value in (phase.phase, phase.sigma))
        off = np.mod(fine - column + period / 2, period) - period / 2
        limit = np.minimum(gate * np.hypot(sigma, fine_sigma), period / 3)
        column = np.where(np.abs(off) <= limit, column + off, np.nan)
        sigma = np.where(np.isfinite(column), fine_sigma, np.nan)
    return column, sigma
