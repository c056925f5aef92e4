"""Scenes that rays are cast into."""

from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

class EmbreeScene:
    @overload
    def run(
        self,
        vec_origins: NDArray[np.float32],
        vec_directions: NDArray[np.float32],
        dists: NDArray[np.float32] | None = ...,
        *,
        query: Literal["OCCLUDED"],
    ) -> NDArray[np.int32]: ...
    @overload
    def run(
        self,
        vec_origins: NDArray[np.float32],
        vec_directions: NDArray[np.float32],
        dists: NDArray[np.float32] | None = ...,
        *,
        output: Literal[True],
    ) -> dict[str, NDArray[Any]]: ...
