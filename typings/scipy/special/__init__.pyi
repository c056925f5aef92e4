"""The error function and the distributions that follow from it."""

from typing import TypeVar, overload

import numpy as np
from numpy.typing import NDArray

_F = TypeVar("_F", bound=np.floating)

@overload
def erf(x: NDArray[_F]) -> NDArray[_F]: ...
@overload
def erf(x: float) -> np.float64: ...
def gammaincc(a: float, x: float) -> np.float64: ...
@overload
def ndtr(x: NDArray[_F]) -> NDArray[_F]: ...
@overload
def ndtr(x: float) -> np.float64: ...
