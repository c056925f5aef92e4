"""Constants of robust statistics: medians over standard deviations and variances."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution: 1/Φ⁻¹(3/4)."""
MEDIAN_TO_MEAN_SIGMA = 1.2533
"""Standard deviation of a median over that of a mean, for normal errors: √(π/2)."""
CHI2_MEDIAN = 0.4549
"""Median of χ² with one degree of freedom; outliers hardly move it."""
