"""The reference back end: every kernel in plain NumPy, float64; the native kernels are tested against it.

The modules have the names of the families: `geometry`, `images`, `sweep`, `least_squares`, `selection`,
`networks`, `holes`. `view` projects pixels into an auxiliary for them; the reference of the holes has its lines in
`hole_rims`, its features in `hole_features` and statistics of windows in `windows`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from beltscape.kernels.reference.geometry import (
    fuse_layers,
    inverse_depth_buffers,
    rasterise_heights,
    triangulate,
    visible,
)
from beltscape.kernels.reference.holes import fill_holes, hole_inputs
from beltscape.kernels.reference.images import (
    gather,
    spline_coefficients,
    warp,
)
from beltscape.kernels.reference.least_squares import local_fit, normal_equations
from beltscape.kernels.reference.networks import evaluate_network, pass_messages
from beltscape.kernels.reference.selection import candidate_surfaces, photo_consistency, propagate
from beltscape.kernels.reference.sweep import aggregate, sweep, sweep_and_aggregate

_KERNELS: dict[str, Callable[[Any], Sequence[NDArray[Any]]]] = {
    kernel.__name__: kernel
    for kernel in (
        aggregate, candidate_surfaces, evaluate_network, fill_holes, fuse_layers, gather, hole_inputs, local_fit,
        normal_equations, pass_messages, photo_consistency, propagate, spline_coefficients, sweep_and_aggregate,
        triangulate, visible, warp,
    )
}  # fmt: skip


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
                return sweep(given, len(out[0]))  # pyrefly: ignore[bad-argument-type]
            case "rasterise_heights":
                return rasterise_heights(given, out[0].shape)  # pyrefly: ignore[bad-argument-type]
            case "inverse_depth_buffers":
                return inverse_depth_buffers(given, [(b.shape[1], b.shape[0]) for b in out])  # pyrefly: ignore[bad-argument-type]
            case _:
                return _KERNELS[kernel](given)
