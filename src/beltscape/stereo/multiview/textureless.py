"""Textureless regions, such as the discs of projected markers: their surface is continued from the rim.

A disc is found in the core's levels: bright over a whole window that is larger than a dot. A quadratic surface is
fitted robustly to s in a ring around it. Where the ring is one smooth surface, the disc is taken to continue it.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Floats
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.kernels.planes import dilate, erode, find_pixel_kernels
from beltscape.kernels.statistics import find_percentile
from beltscape.stereo.multiview.frame import PreparedFrame
from beltscape.stereo.multiview.surface import Surface

_WINDOW_PX = 9
"""Window that is larger than a dot, at scale 1."""
_BRIGHT = 0.15, 99.0
"""A pixel is lit from this share of the levels' percentile on."""
_RIM_PX = 3
"""Width of a disc's blurred edge."""
_RING_PX = 10
"""Width of the ring around a disc to which the quadratic is fitted, at scale 1."""
_LARGEST_PX = 80
"""Largest extent of a disc at scale 1."""
_SMOOTH_PX = 0.08
"""Largest robust deviation of the ring from its quadratic."""
_LEAST_INFORMATION = 0.25
"""See `_QUANTILE`."""
_QUANTILE = 0.33
"""A region has texture where this quantile of its information exceeds `_LEAST_INFORMATION` times the outer median."""
_LEAST_RING = 60
"""Least number of pixels of a ring; a quadratic has six coefficients."""
_ROUNDS = 6
"""Iterations of the robust fit at most."""
_SETTLED_PX = 1e-3
"""The fit has converged if no coefficient changes by more."""
_RIDGE = 1e-9
"""Regularisation of the fit's moments, so that a ring cut to a line still has a quadratic."""


class FilledDiscs(NamedTuple):
    """A surface whose textureless discs are continued from their rims."""

    surface: Surface
    mask: NDArray[np.bool_]
    """(H, W) pixels of the discs that were filled."""


def fill_textureless_discs(surface: Surface, information: Floats, prepared: PreparedFrame) -> FilledDiscs:
    """Return the surface with the textureless discs that have smooth rims filled.

    ``information`` (H, W) is that of the least squares: a region that has texture of its own is no disc.
    """
    scale = prepared.context.scale
    discs = np.asarray(prepared.context.kernels.replay(_mask_bright_regions, prepared))
    # of OpenCV's algorithms for eight neighbours this one takes a third of the time of the others
    count, labels, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(
        discs, 8, cv2.CV_32S, cv2.CCL_BBDT
    )
    filled = np.zeros(surface.s.shape, bool)
    found: list[NDArray[np.floating | np.signedinteger]] = []
    s = surface.s
    reach = int(np.ceil((_RING_PX + _RIM_PX) * scale))
    for label in range(1, count):
        left, top, width, height = (int(v) for v in boxes[label, :4])
        if max(width, height) > _LARGEST_PX * scale:
            continue
        rows = slice(max(0, top - reach), top + height + reach)
        columns = slice(max(0, left - reach), left + width + reach)
        inside = labels[rows, columns] == label
        if inside.all() or _has_texture(information[rows, columns], inside):
            continue
        fit = _fit_quadratic(s[rows, columns], inside, discs[rows, columns] > 0, scale)
        if fit is not None:
            filled[rows, columns][inside] = True
            places = np.nonzero(inside)
            found.append(np.stack([places[0] + rows.start, places[1] + columns.start, *fit]))
    if not found:
        return FilledDiscs(surface, filled)
    at_v, at_u, *values = np.concatenate(found, axis=1)
    planes = surface.s, surface.slope_u, surface.slope_v
    changed = (_put(plane, at_v, at_u, new) for plane, new in zip(planes, values, strict=True))
    return FilledDiscs(Surface(*changed), filled)


def _put(plane: Floats, rows: Floats, columns: Floats, values: Floats) -> Floats:
    """Return the plane (H, W) with other values (N,) at some pixels."""
    kernels, values = find_pixel_kernels(plane), values.astype(np.float32)
    if kernels:
        places = kernels.keep(rows.astype(np.float32)), kernels.keep(columns.astype(np.float32))
        return kernels.put_pixels(plane, places, values)
    changed = plane.copy()
    changed[rows.astype(int), columns.astype(int)] = values
    return changed


def _has_texture(information: Floats, inside: NDArray[np.bool_]) -> bool:
    """Return whether the least squares have information inside a region, compared with that around it."""
    return _find_lower_quantile(information[inside], _QUANTILE) > _LEAST_INFORMATION * _find_lower_quantile(
        information[~inside], 0.5
    )


def _find_lower_quantile(values: Floats, share: float) -> float:
    """Return a quantile without interpolation; for few values this is faster than `numpy.quantile`."""
    at = int(share * (values.size - 1))
    return float(np.partition(values, at)[at])


def _mask_bright_regions(prepared: PreparedFrame) -> NDArray[np.uint8]:
    """Return (H, W) 1 in regions that are lit over whole windows, including their rims."""
    core, box = prepared.filled_core, prepared.context.windows.boxes[_WINDOW_PX]
    even = (erode(core, box) > _BRIGHT[0] * find_percentile(core[::4, ::4], _BRIGHT[1])).astype(np.uint8)
    grown = box[0] + 2 * int(np.ceil(_RIM_PX * prepared.context.scale))
    return dilate(even, (grown, grown))


def _fit_quadratic(
    s: Floats, inside: NDArray[np.bool_], any_disc: NDArray[np.bool_], scale: float
) -> tuple[Floats, Floats, Floats] | None:
    """Return s and its slopes at the N pixels ``inside``, from the quadratic through the ring around them.

    None if that is not smooth.
    """
    size = 2 * int(np.ceil(_RING_PX * scale)) + 1
    near = cv2.dilate(inside.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    ring = near & ~any_disc & np.isfinite(s)
    if ring.sum() < _LEAST_RING:
        return None
    places = np.nonzero(inside)
    middle_v, middle_u = (axis.mean() for axis in places)
    v, u = (
        (axis - middle) / size for axis, middle in zip(np.nonzero(ring), (middle_v, middle_u), strict=True)
    )
    ring_terms, target, weight = _make_terms(u, v), s[ring].astype(np.float64), np.ones(len(u))
    coefficients, spread = np.zeros(6), np.inf
    for _ in range(_ROUNDS):
        weighted = ring_terms * weight  # sums by einsum: BLAS's depend on the number of threads
        moments, pull = np.einsum("in,jn->ij", weighted, ring_terms), np.einsum("in,n->i", weighted, target)
        moments[np.diag_indices(6)] += _RIDGE * np.trace(moments)
        previous, coefficients = coefficients, cast("NDArray[np.float64]", np.linalg.solve(moments, pull))
        off = np.abs(target - coefficients @ ring_terms)
        spread = MAD_TO_SIGMA * _find_lower_quantile(off, 0.5)
        if np.abs(coefficients - previous).max() < _SETTLED_PX:
            break
        weight = 1 / (1 + (off / max(2 * spread, 1e-3)) ** 2)
    if spread > _SMOOTH_PX:
        return None
    _, by_u, by_v, by_uu, by_uv, by_vv = coefficients
    v, u = ((axis - middle) / size for axis, middle in zip(places, (middle_v, middle_u), strict=True))
    du, dv = (by_u + 2 * by_uu * u + by_uv * v) / size, (by_v + by_uv * u + 2 * by_vv * v) / size
    inner = coefficients @ _make_terms(u, v)
    return inner.astype(np.float32), du.astype(np.float32), dv.astype(np.float32)


def _make_terms(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the terms (6, N) of a quadratic at places (N,)."""
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])
