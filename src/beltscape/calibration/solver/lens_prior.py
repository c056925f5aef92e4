"""Prior knowledge of one camera's intrinsics from an earlier calibration, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.solver.lens import list_parameters, pack_intrinsics
from beltscape.core.geometry.camera import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LensPrior:
    """Mean and covariance of a camera's intrinsics; parameters without variance are fixed."""

    camera: Camera
    covariance: Array
    """(W, W) of fx, fy, cx, cy and the coefficients of the lens model."""

    @property
    def fixed(self) -> tuple[str, ...]:
        """Parameters that keep their value."""
        names = list_parameters(self.camera.model)
        return tuple(
            name for name, variance in zip(names, np.diag(self.covariance), strict=True) if variance <= 0
        )

    def compute_information(self) -> tuple[Array, Array]:
        """Return mean (W,) and information (W, W); 0 for fixed parameters."""
        free = np.diag(self.covariance) > 0
        information = np.zeros_like(self.covariance)
        information[np.ix_(free, free)] = np.linalg.inv(self.covariance[np.ix_(free, free)])
        return pack_intrinsics(self.camera), information
