"""The chi-square distribution."""

import numpy as np

class _ChiSquare:
    def cdf(self, x: float, df: float) -> np.float64: ...
    def ppf(self, q: float, df: float) -> np.float64: ...

chi2: _ChiSquare
