"""Least squares."""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

class OptimizeResult:
    cost: float
    fun: NDArray[np.float64]
    jac: NDArray[np.float64]
    message: str
    nfev: int
    status: int
    success: bool
    x: NDArray[np.float64]

_Residuals = Callable[[NDArray[np.float64]], NDArray[np.floating[Any]]]

def least_squares(
    fun: _Residuals,
    x0: NDArray[np.float64],
    jac: Literal["2-point", "3-point", "cs"] | Callable[[NDArray[np.float64]], NDArray[np.float64]] = ...,
    bounds: tuple[float | NDArray[np.float64], float | NDArray[np.float64]] = ...,
    method: Literal["trf", "dogbox", "lm"] = ...,
    ftol: float | None = ...,
    xtol: float | None = ...,
    gtol: float | None = ...,
    x_scale: float | NDArray[np.float64] | Literal["jac"] = ...,
    loss: Literal["linear", "soft_l1", "huber", "cauchy", "arctan"] = ...,
    f_scale: float = ...,
    *,
    max_nfev: int | None = ...,
) -> OptimizeResult: ...
