"""Distributions, ranks, a line and the analysis of variance."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

class _ChiSquare:
    def cdf(self, x: float, df: float) -> np.float64: ...
    def ppf(self, q: float, df: float) -> np.float64: ...

chi2: _ChiSquare

def rankdata(a: NDArray[np.floating]) -> NDArray[np.float64]: ...

class _Line:
    intercept: float
    slope: float

def linregress(
    x: Sequence[float] | NDArray[np.float64], y: Sequence[float] | NDArray[np.float64]
) -> _Line: ...
def f_oneway(*samples: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]: ...

class _Student:
    def ppf(self, q: float, df: float) -> float: ...

class _Fisher:
    def sf(self, x: float, dfn: float, dfd: float) -> float: ...

t: _Student
f: _Fisher
