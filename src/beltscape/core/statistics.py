"""Factor from a median absolute deviation to a standard deviation."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution: 1/Φ⁻¹(3/4)."""
