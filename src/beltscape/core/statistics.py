"""Robust statistics: medians and quantiles, their ratios to standard deviations, and Tukey's biweight.

NumPy's own median and quantile select several ranks at a time, for which it has no vector instructions: of 150,000
numbers they take 1.1 and 1.5 ms, and those here, which select one, 0.1 ms. Of 1,000 numbers its quantile takes 20 µs
and this one 4.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.floating)

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution: 1/Φ⁻¹(3/4)."""
MEDIAN_TO_MEAN_SIGMA = 1.2533
"""Standard deviation of a median over that of a mean, for normal errors: √(π/2)."""
CHI2_MEDIAN = 0.4549
"""Median of χ² with one degree of freedom; outliers hardly move it."""
TUKEY = 4.685
"""Tukey's biweight ends at this multiple of σ: 95 % efficiency with normal errors (Holland & Welsch 1977)."""


def compute_median(values: NDArray[np.floating]) -> float:
    """Return the median of an array of any shape, that of NumPy to the bit; NaN where a value is, or without any."""
    count = values.size
    if not count:
        return np.nan
    ordered = np.partition(values, count // 2, axis=None)
    upper = ordered[count // 2 :]
    if np.isnan(upper.max()):  # where NaN are sorted to
        return np.nan
    middle = upper[0] if count % 2 else (ordered[: count // 2].max() + upper[0]) / 2
    return float(middle)


def compute_quantile(values: NDArray[np.floating], share: float) -> float:
    """Return a quantile of an array of any shape, that of NumPy to the bit; NaN where a value is, or without any."""
    if not values.size:
        return np.nan
    place = (values.size - 1) * share
    rank = int(place)
    ordered = np.partition(values, rank, axis=None)
    low, beyond = ordered[rank], ordered[rank + 1 :]
    high = beyond.min() if beyond.size else low
    if np.isnan(beyond.max() if beyond.size else low):
        return np.nan
    part = place - rank
    return float(low + (high - low) * part if part < 0.5 else high - (high - low) * (1 - part))


def drop_nan(values: NDArray[Number]) -> NDArray[Number]:
    """Return the values (N,) of an array of any shape that are not NaN."""
    return values[~np.isnan(values)]


def compute_biweights(residual: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Return Tukey's biweights of residuals with this standard deviation: 1 for none, 0 from ``TUKEY`` σ on.

    References
    ----------
    Holland & Welsch, Commun. Stat. Theory Methods 6(9), 813–827, 1977, doi:10.1080/03610927708827533.
    """
    return np.clip(1 - (residual / (TUKEY * sigma)) ** 2, 0, None) ** 2
