"""Improvement of a surface: propagation near depth steps, dense least squares over all views, and twicing.

Propagation: pixels near depth steps may take over the surface of a pixel in one of eight directions.

Least squares determine a surface to a hundredth of a pixel. Every iteration warps the auxiliaries by the current
surface, including its slopes, forms the normal equations of every pixel (information and pull) from the residuals,
and fits a plane around each pixel over the largest window that agrees with the smaller ones.

Twicing corrects the bias by which the fit's windows flatten tops and edges. A fit over windows W maps the surface t
to W t, which is too low on tops and too high in hollows. The difference remains in the images as residuals that
neighbours have in common. W of it is added where it exceeds the noise (J. W. Tukey, Exploratory Data Analysis,
1977).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.least_squares import NormalEquations
from beltscape.kernels.planes import blur, dilate
from beltscape.stereo.multiview.frame import PreparedFrame, Radii
from beltscape.stereo.multiview.parallel import run_pair
from beltscape.stereo.multiview.surface import OCCLUDER_PX, Surface, detect_depth_steps, fill_nan


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquaresResult:
    """An optimised surface and how well the images determine it."""

    surface: Surface
    variance: NDArray[np.float32]
    """(H, W) of s, px², from noise, texture, views and window."""
    disagreement: NDArray[np.float32]
    """(H, W) deviation between the windows' planes, in units of the smaller window's variance."""
    used: NDArray[np.uint8]
    """(H, W) number of views that agree with the core."""
    information: NDArray[np.float32]
    """(H, W) of the pixel alone, 1/px²."""


def form_normal_equations(
    s: NDArray[np.float32], prepared: PreparedFrame, levels_px: int, model_variance: float
) -> NormalEquations:
    """Return the normal equations of inverse depth s (H, W), with the noise of the prepared frame.

    ``levels_px`` is the radius of the window in which levels are normalised.
    """
    context = prepared.context
    return context.kernels.normal_equations(
        s, prepared.core, prepared.coefficients, prepared.views, window=levels_px, floor=prepared.noise.floor,
        noise_variance=prepared.noise.levels, model_variance=model_variance, threads=context.threads,
    )  # fmt: skip


def solve_least_squares(
    surface: Surface, prepared: PreparedFrame, tolerances: tuple[float, ...], radii: Radii
) -> LeastSquaresResult:
    """Return the surface after one iteration per tolerance, with windows of ``radii``.

    A tolerance (px) is the distance from a pixel's plane up to which a neighbour counts.
    """
    context = prepared.context
    fit = used = information = None
    surface = surface.keep(context.kernels)
    for tolerance in tolerances:
        information, pull, used = form_normal_equations(
            surface.s, prepared, context.windows.levels_px, prepared.noise.model
        )
        fit = context.kernels.local_fit(
            information, pull, surface.s, surface.slope_u, surface.slope_v, radii=radii, tolerance=tolerance,
            threads=context.threads,
        )  # fmt: skip
        surface = Surface(fit.s, fit.slope_u, fit.slope_v)
    if fit is None or used is None or information is None:
        raise ValueError("the least squares need at least one tolerance")
    return LeastSquaresResult(surface, fit.variance, fit.disagreement, used, information)


_DIRECTIONS = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)], float)
"""Directions (columns, rows) from which candidates come."""


@dataclass(frozen=True, slots=True, eq=False)
class PropagationResult:
    """The surface of the selected candidates, with cost and margin."""

    surface: Surface
    cost: NDArray[np.float32]
    """(H, W) dissimilarity of the selected candidate, 0..1."""
    margin: NDArray[np.float32]
    """(H, W) difference to the cost of the next candidate with another s."""


def list_propagation_offsets(distances_px: tuple[int, ...], turn: int | None = None) -> NDArray[np.int32]:
    """Return the (8 · n, 2) offsets (du, dv) in eight directions at n distances.

    With a ``turn`` it is half of them: the straight directions at every other distance and the diagonals at the rest;
    the next turn has the other half.
    """
    unit = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
    straight, diagonal = unit[:4], unit[4:]
    taken = [unit if turn is None else (straight, diagonal)[(i + turn) % 2] for i in range(len(distances_px))]
    return np.concatenate(
        [np.rint(directions * distance) for directions, distance in zip(taken, distances_px, strict=True)]
    ).astype(np.int32)


def propagate(
    surface: Surface, prepared: PreparedFrame, distances_px: tuple[int, ...], turn: int | None = None
) -> PropagationResult:
    """Return the best of the surfaces continued from neighbours, compared in the views that see them.

    Candidates come from all directions at every distance or, with a ``turn``, from half of these in alternation.
    """
    context = prepared.context
    kernels, threads = context.kernels, context.threads
    buffers, active = run_pair(
        lambda: kernels.inverse_depth_buffers(surface.s, prepared.views, prepared.sizes, threads=threads),
        lambda: mask_near_steps(surface.s, reach_px=max(1, min(distances_px) // 2)),
        threads,
    )
    selected = kernels.propagate(
        surface.s, surface.slope_u, surface.slope_v, prepared.core, prepared.images, prepared.views, buffers,
        offsets=list_propagation_offsets(distances_px, turn), floor=prepared.noise.floor, tolerance=OCCLUDER_PX,
        active=active, threads=threads,
    )  # fmt: skip
    return PropagationResult(
        Surface(selected.s, selected.slope_u, selected.slope_v), selected.cost, selected.margin
    )


def mask_near_steps(s: NDArray[np.float32], reach_px: int) -> NDArray[np.uint8]:
    """Return (H, W) 1 within reach of a depth step; elsewhere all candidates are the same surface."""
    side = 2 * reach_px + 1
    return dilate(detect_depth_steps(s).astype(np.uint8), (side, side))


_WINDOW_PX = 7
"""Window in which the remaining shift is compared with its variance."""
_MOST_PX = 0.1
"""Limit of the remaining shift; a larger one is no flattening."""


def apply_twicing(surface: Surface, prepared: PreparedFrame, tolerance: float) -> Surface:
    """Return the surface with the flattening of its windows corrected; NaN stays.

    ``tolerance`` (px) is that of `solve_least_squares`.
    """
    context = prepared.context
    information, pull, _ = form_normal_equations(
        surface.s, prepared, context.windows.levels_px, prepared.noise.model
    )
    fit = context.kernels.local_fit(
        information, pull, surface.s, surface.slope_u, surface.slope_v, radii=context.windows.firm,
        tolerance=tolerance, flatten=0.0, threads=context.threads,
    )  # fmt: skip
    shift = fit.s - surface.s
    window = context.windows.boxes[_WINDOW_PX]
    energy, noise = (
        blur(np.minimum(plane, _MOST_PX**2, out=plane), window)
        for plane in (np.square(fill_nan(shift)), fill_nan(fit.variance))
    )
    share = 1 - noise / np.maximum(energy, np.float32(1e-12), out=energy)
    np.maximum(share, 0, out=share)
    return Surface(
        cast("NDArray[np.float32]", surface.s + share * shift),
        cast("NDArray[np.float32]", surface.slope_u + share * (fit.slope_u - surface.slope_u)),
        cast("NDArray[np.float32]", surface.slope_v + share * (fit.slope_v - surface.slope_v)),
    )
