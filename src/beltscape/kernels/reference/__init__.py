"""The reference back end: every kernel in plain NumPy, float64; the native kernels are tested against it.

The modules have the names of the families: `geometry`, `images`, `sweep`, `least_squares`, `selection`,
`networks`, `photometry`, `holes`; those of planes are in `opencv_planes`. `view` projects pixels into an auxiliary
for them; `shift_fit` is of least squares. The reference of the holes has its lines in `hole_rims`, its features in
`hole_features`, the continuation in `hole_continuation` and statistics of windows in `windows`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from beltscape.kernels import opencv_planes
from beltscape.kernels.reference import (
    geometry,
    holes,
    images,
    least_squares,
    networks,
    photometry,
    selection,
    shift_fit,
    sweep,
)

_FAMILIES = (geometry, holes, images, least_squares, shift_fit, networks, photometry, selection, sweep)


class ReferenceBackend:
    """Every kernel in NumPy on one thread."""

    name = "reference"

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`; of ``out`` only the shapes count."""
        del threads
        match kernel:
            case "sweep":
                return sweep.sweep(given, len(out[0]))  # pyrefly: ignore[bad-argument-type]
            case "rasterise_heights":
                return geometry.rasterise_heights(given, out[0].shape)  # pyrefly: ignore[bad-argument-type]
            case "inverse_depth_buffers":
                return geometry.inverse_depth_buffers(given, [(b.shape[1], b.shape[0]) for b in out])  # pyrefly: ignore[bad-argument-type]
            case _ if kernel in opencv_planes.KERNELS:
                return opencv_planes.run(kernel, given, out)
            case _:
                return _find_kernel(kernel)(given)


def _find_kernel(name: str) -> Callable[[Any], Sequence[NDArray[Any]]]:
    """Return the function of that name; no two families have a kernel of one name."""
    return next(getattr(family, name) for family in _FAMILIES if hasattr(family, name))
