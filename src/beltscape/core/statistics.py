"""Robust statistics: medians over standard deviations and variances, and Tukey's biweight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution: 1/Φ⁻¹(3/4)."""
MEDIAN_TO_MEAN_SIGMA = 1.2533
"""Standard deviation of a median over that of a mean, for normal errors: √(π/2)."""
CHI2_MEDIAN = 0.4549
"""Median of χ² with one degree of freedom; outliers hardly move it."""
TUKEY = 4.685
"""Tukey's biweight ends at this multiple of σ: 95 % efficiency with normal errors (Holland & Welsch 1977)."""


def compute_biweights(residual: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Return Tukey's biweights of residuals with this standard deviation: 1 for none, 0 from ``TUKEY`` σ on.

    References
    ----------
    Holland & Welsch, Commun. Stat. Theory Methods 6(9), 813–827, 1977, doi:10.1080/03610927708827533.
    """
    return np.clip(1 - (residual / (TUKEY * sigma)) ** 2, 0, None) ** 2
