"""Numbers of operations of the matcher's kernels, from their headers in native/.

An operation is an addition, a multiplication, a division, a square root, a comparison with its selection, a minimum
or a maximum of one float; a fused multiply-add is two. Loads, stores, shuffles and addresses are none. Cells of a
byte count as a quarter, because four fit the place of a float.

The counts of networks are exact. The others were derived term by term, as the comments say, for Brown's lens. They
were compared once with the instructions of the level ``scalar`` (one float to an instruction; `valgrind
--tool=callgrind`, one call of each kernel): docs/explanation/performance.md has the ratios.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

_LENS = 3 + 1 + 6 + 14 + 4
"""view.hpp `image_of`: three products, r², a polynomial of degree 3, tangential terms, focal length and centre."""
_SWEPT = 9 + _LENS
"""plane_sweep.hpp `swept`: three multiply-adds, a division, two products, the lens."""
_SEEN = 15 + _LENS
"""view.hpp `see`, multiview_cost.hpp `sample_point`: as `swept`, with s per pixel instead of per plane."""
_SPOT = 15
"""plane_sweep.hpp `spot`: four comparisons, three selections, four conversions, the offsets, the index."""
_BILINEAR = 9
"""plane_sweep.hpp `bilinear`: three differences and three multiply-adds."""
_ROW_SUMS = 2 + 5 + 5
"""Three neighbours: their sum, the sum of their squares, the sum of their products with the core's."""
_DISSIMILARITY = 3 + 3 + 2 + 2 + 3
"""plane_sweep.hpp `dissimilarity`: both energies, their sum, the quotient, the clamp."""
_BYTE = 0.25
"""A cell of a byte, in operations."""
_PATHS = 8


def _count_sweep(given: Any, out: Sequence[Any]) -> float:
    # per voxel and view: projection, sample (less the level), rows' sums, the sums across (3 x 2), the dissimilarity,
    # its place among the best; per voxel: the mean; per cell and path seven bytes (aggregate.hpp `pixel`), the sum of
    # all paths and the search of the least, three times, in 16 bits
    del out
    view = _SWEPT + _SPOT + _BILINEAR + 1 + _ROW_SUMS + 6 + _DISSIMILARITY + 2 * given.best
    voxel = len(given.images) * view + given.best + 2 + _BYTE * (_PATHS * 7 + 2 * (_PATHS + 3))
    return given.core.size * given.planes * voxel


def _count_propagation(given: Any, out: Sequence[Any]) -> float:
    # per candidate and view: projection, sample, its pixel in the buffer and the comparison there (8), rows' sums,
    # sums down (3 x 2), dissimilarity, the mean over views (6); per candidate: its s (6), the mean (6), its place
    # among the kept ones (5 each); the choice: per path and pair of kept candidates seven (semi_global.hpp)
    del out
    pixels = given.core.size
    active = pixels if given.active is None else int(np.count_nonzero(given.active))
    view = _SEEN + _SPOT + _BILINEAR + 1 + 8 + _ROW_SUMS + 6 + _DISSIMILARITY + 6
    candidate = len(given.images) * view + 6 + 6 + 5 * given.candidates
    choice = _PATHS * given.candidates**2 * 7
    return pixels * candidate + active * (len(given.offsets) * candidate + choice)


_WARP = (15 + 6) + (_LENS + 7 + 6 + 6 + 6 + 6) + 12 + (36 + 4 * 14 + 21) + 3
"""warp.hpp: `ideal` and its derivative; the lens and its four derivatives; the footprint; spline.hpp `sample`: eight
weights and their slopes, four rows twice, three columns; the derivative by s."""


def _count_normal_equations(given: Any, out: Sequence[Any]) -> float:
    # per view: the warp; sums of columns (an addition and a multiply-add each) and across; the normalisation (8), the
    # residual (12), the misfits' sums, the equations (14); the core's own sums and normalisation once
    del out
    side, small = 2 * given.window + 1, 2 * given.residual_window + 1
    normalised = 3 * side + 2 * side + 8
    view = _WARP + normalised + 12 + 2 * small + 14
    return given.s.size * (len(given.views) * view + normalised + 2 * side + 2)


def _count_local_fit(given: Any, out: Sequence[Any]) -> float:
    # local_fit.hpp, per pixel: in the largest window each tap (12) and its sums and differences (5 to a pair); in
    # each window six multiply-adds to a pair and ten to a row; the solution (60) and the choice (15)
    del out
    largest = given.windows[-1]
    operations = 0.0
    for window in given.windows:
        rows = [window.reach[abs(row)] for row in range(-window.radius, window.radius + 1)]
        pairs = sum(reach for reach in rows if reach > 0)
        operations += 12 * pairs + 20 * sum(reach >= 0 for reach in rows) + 60 + 15
        if window is largest:
            operations += 12 * (2 * pairs + len(rows)) + 5 * pairs
    return given.s.size * operations


def _count_photo_consistency(given: Any, out: Sequence[Any]) -> float:
    # per view and each of five points: s on the plane (4), projection, sample, the difference (5); once per view: the
    # buffer (8) and both order statistics (14); per point of the core: the weight (1)
    del out
    points = 5 * (4 + 2 + _SEEN + _SPOT + _BILINEAR + 5)
    return given.planes[0].size * (len(given.images) * (points + 8 + 14) + 5)


def _count_layers(layers: Sequence[Any]) -> float:
    # a bias and a multiply-add to each weight; the rectification of all but the last layer
    return sum(2.0 * len(layer) * (layer.shape[1] - 1) for layer in layers) + sum(map(len, layers[:-1]))


def _count_network(given: Any, out: Sequence[Any]) -> float:
    del out
    return given.planes[0].size * (2 * len(given.planes) + _count_layers(given.layers))


def _count_network_of_programs(given: Any, out: Sequence[Any]) -> float:
    return out[0].size * (2 * len(given.ends) + len(given.program) + _count_layers(given.layers))


def _count_messages(given: Any, out: Sequence[Any]) -> float:
    del out
    return given.senders.shape[1] * _count_layers(given.layers)


def _count_buffers(given: Any, out: Sequence[Any]) -> float:
    # visibility.hpp `splat_row`: projection, five comparisons for the hit, two floors with clamps (8), four for the
    # whole square, the index, and four maxima
    del out
    return given.s.size * len(given.views) * (_SEEN + 5 + 8 + 4 + 2 + 4)


def _count_visible(given: Any, out: Sequence[Any]) -> float:
    del out
    return given.s.size * (_SEEN + 2 + 4 + 8 + 2 + 2)


def _count_warp(given: Any, out: Sequence[Any]) -> float:
    del out
    return given.s.size * _WARP


def _count_spline(given: Any, out: Sequence[Any]) -> float:
    # prefilter.hpp: a causal and an anticausal multiply-add along rows and along columns, and the gain
    del out
    return given.image.size * (2 * 4 + 2)


def _count_gather(given: Any, out: Sequence[Any]) -> float:
    # gathering.hpp: the clamped column and row and the index, for each value
    del given
    return 8.0 * sum(plane.size for plane in out)


def _count_candidates(given: Any, out: Sequence[Any]) -> float:
    # candidate_surfaces.hpp: on eight rays up to `reach` pixels are looked at, about half of them on the mean; nine
    # planes' s (4), and the support among them (9 x 8 x 4)
    del out
    return len(given.u) * (8 * given.reach / 2 * 2 + 9 * 4 + 9 * 8 * 4)


def _count_rounds(given: Any, out: Sequence[Any]) -> float:
    del out
    return given.senders.shape[1] * sum(_count_layers(layers) for layers in given.rounds)


_TWO_SUM = 7
"""native/cuda/planes.cuh `PreciseSum`: a sum with its rounding error."""
_MEDIAN = 2 * sum(24 - i for i in range(13))
"""native/cuda/planes.cuh `median_of_window`: a minimum and a maximum of every pair up to the middle one."""
_SEARCHED = 2 * 16
"""Pixels that the search for a mask looks at, of a row and of rows above and below: 16 px to the next step."""


def _count_means(given: Any, out: Sequence[Any]) -> float:
    return out[0].size * _TWO_SUM * sum(given.size)


def _count_moments(given: Any, out: Sequence[Any]) -> float:
    # as the means of the plane and of its squares; the square, the mean's, the difference and the maximum
    return out[0].size * (2 * _TWO_SUM * sum(given.size) + given.size[0] + 3)


def _count_filter(given: Any, out: Sequence[Any]) -> float:
    return 2.0 * out[0].size * given.weights.size


def _count_quantile(given: Any, out: Sequence[Any]) -> float:
    # statistics.cuh: the count, and eight digits of two values: the comparison above the digit, the digit's count
    del out
    return sum(each.size for each in given.arrays) * (2.0 + 2 * 8 * 2)


def _count_contrast(given: Any, out: Sequence[Any]) -> float:
    # contrast.hpp: the level and its sum; once more the level, its deviation, the square and its sum
    del out
    return 6.0 * given.image.size


def _count_sharpness(given: Any, out: Sequence[Any]) -> float:
    # sharpness.hpp: pairs of pixels along columns, which the three blurs share, and along rows, which they do not; a
    # multiply-add to each; the two differences and their four sums
    del out
    reach = float(given.radii.sum())
    return given.image.size * (given.radii[-1] + 2 * reach + 3 + 3 * reach + 3 + 2 + 6)


def _count_phases(given: Any, out: Sequence[Any]) -> float:
    # photometry.cuh: the sum of four neighbours, the product, the difference, its amount and its sum
    del out
    return 7.0 * given.image.size


def _count_extremes(given: Any, out: Sequence[Any]) -> float:
    return out[0].size * sum(given.size)


def _count_expression(given: Any, out: Sequence[Any]) -> float:
    return out[0].size * len(given.program)


def _count_each(number: int) -> Callable[[Any, Sequence[Any]], float]:
    """Return the count of a kernel with a number of operations for each element of its result."""

    def count(given: Any, out: Sequence[Any]) -> float:
        del given
        return number * out[0].size

    return count


def _count_plane(given: Any, out: Sequence[Any]) -> float:
    del out
    return given.plane.size


OPERATIONS: dict[str, Callable[[Any, Sequence[Any]], float]] = {
    "sweep_and_aggregate": _count_sweep,
    "propagate": _count_propagation,
    "normal_equations": _count_normal_equations,
    "local_fit": _count_local_fit,
    "photo_consistency": _count_photo_consistency,
    "evaluate_network": _count_network,
    "evaluate_network_of_programs": _count_network_of_programs,
    "pass_messages": _count_messages,
    "inverse_depth_buffers": _count_buffers,
    "visible": _count_visible,
    "warp": _count_warp,
    "spline_coefficients": _count_spline,
    "gather": _count_gather,
    "candidate_surfaces": _count_candidates,
    "exchange_messages": _count_rounds,
    "evaluate_expression": _count_expression,
    "average_windows": _count_means,
    "measure_moments": _count_moments,
    "find_extremes": _count_extremes,
    "median_of_windows": _count_each(_MEDIAN),
    "measure_distances": _count_each(_SEARCHED),
    "filter_plane": _count_filter,
    "find_quantile": _count_quantile,
    "average_plane": _count_plane,
    "average_areas": _count_plane,
    "average_blocks": _count_plane,
    "repeat_blocks": _count_each(1),
    "subsample_plane": _count_each(1),
    "interpolate_plane": _count_each(9),
    "measure_contrast": _count_contrast,
    "make_levels": _count_each(2),
    "measure_sharpness": _count_sharpness,
    "measure_phases": _count_phases,
    "list_pixels": _count_each(1),
    "put_pixels": _count_each(1),
    "assign_addresses": _count_each(1),
    "pick_best": _count_each(9),
}
"""By kernel: a function of its record and its results to the number of its operations."""
