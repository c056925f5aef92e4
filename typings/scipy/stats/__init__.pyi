"""The chi-square distribution and ranks."""

import numpy as np
from numpy.typing import NDArray

class _ChiSquare:
    def cdf(self, x: float, df: float) -> np.float64: ...
    def ppf(self, q: float, df: float) -> np.float64: ...

chi2: _ChiSquare

def rankdata(a: NDArray[np.floating]) -> NDArray[np.float64]: ...

class _Line:
    slope: float

def linregress(x: list[float], y: list[float]) -> _Line: ...
def f_oneway(*samples: list[float]) -> tuple[float, float]: ...
