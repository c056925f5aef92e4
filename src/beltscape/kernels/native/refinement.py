"""`normal_equations` and `local_fit` in C++."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_refine import fit_input, normal_input
from beltscape.kernels.protocol.local_fit import RADII, LocalFit
from beltscape.kernels.protocol.normal_equations import NormalEquations


class Refinement:
    """The kernels of native/bind_refine.cpp."""

    _module: ModuleType

    def normal_equations(
        self,
        s: NDArray[np.floating],
        core: NDArray[np.floating],
        coefficients: Sequence[NDArray[np.floating]],
        views: NDArray[np.floating],
        *,
        window: int = 7,
        floor: float,
        noise_variance: float,
        model_variance: float,
        gate: float = 3.0,
        residual_window: int = 2,
        threads: int = 0,
    ) -> NormalEquations:
        """See `beltscape.kernels.protocol.normal_equations`."""
        given = normal_input(
            s, core, coefficients, views, window=window, residual_window=residual_window, floor=floor,
            noise_variance=noise_variance, model_variance=model_variance, gate=gate,
        )  # fmt: skip
        out = NormalEquations(
            np.empty_like(given.s), np.empty_like(given.s), np.empty(given.s.shape, np.uint8)
        )
        self._module.normal_equations(
            given.s, given.core, given.coefficients, list(given.views), window, residual_window, floor,
            noise_variance, model_variance, gate, *out, threads,
        )  # fmt: skip
        return out

    def local_fit(
        self,
        information: NDArray[np.floating],
        pull: NDArray[np.floating],
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        *,
        radii: Sequence[tuple[int, float]] = RADII,
        tolerance: float,
        confidence_width: float = 2.0,
        prior_information: float = 1.0,
        flatten: float = 1.0,
        threads: int = 0,
    ) -> LocalFit:
        """See `beltscape.kernels.protocol.local_fit`."""
        fields = {"information": information, "pull": pull, "s": s, "slope_u": slope_u, "slope_v": slope_v}
        given = fit_input(fields, radii, tolerance, confidence_width, prior_information, flatten)
        shape = given.fields[0].shape
        out = LocalFit(*(np.empty(shape, np.float32) for _ in range(5)), np.empty(shape, np.uint8))
        windows = [(radius, taps.tolist(), reach) for radius, taps, reach in given.windows]
        self._module.local_fit(
            *given.fields, windows, tolerance, confidence_width, prior_information, flatten, *out, threads
        )
        return out
