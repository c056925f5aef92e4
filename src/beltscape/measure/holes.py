"""Heights for cells that were not measured, from the rims of their holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.measure.rims import Hollows, Line, hollows, lines_through, slopes

_STEEP = (0.7, 1.4)
"""Rise over run across a hole: up to the first a slope (heaped material lies at some 35°), from the second a step."""
_LEVEL = (0.2, 0.5)
"""Slope of a surface at its rim: up to the first it is level and ends in a sharp edge, from the second a flank."""
_BEYOND_PX = 1.0
"""How far the upper side of a step goes on beyond its last measured point, at most and if half the gap is not less:
half a pixel because pixels have a size, and as much again because matchers lose what falls away from the camera."""
_CREVICE = (1.0, 2.0)
"""Depth over width of what opens between two rims. What is wider is seen and measured: a gap whose floor shows
further along it, this far down, went unmeasured because it is deep."""
_DOUBT_OF_CREVICES = 0.5
"""How much of that holds between flanks instead of level tops: rocks touch, and their gaps end above the floor."""
_HOLLOW = 1.0
"""Hollows that were not measured lie this many standard deviations of the surface's unevenness low."""
_UNSEEN = 3.0
"""And may lie down to so many of them below the lowest rim."""
_ONE_SIDED = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """A field without holes."""

    value_mm: NDArray[np.float64]
    """(Ny, Nx) measured values, and interpolated ones in the holes."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) one standard deviation; in the holes from what their rims leave open."""
    hole: NDArray[np.bool_]
    """(Ny, Nx) what was not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class _Guess:
    """What one line tells of the hole cells (H,)."""

    value: NDArray[np.float64]
    straight: NDArray[np.float64]
    """The line from rim to rim; NaN where only one was met."""
    weight: NDArray[np.float64]
    hidden: NDArray[np.float64]
    """Share of the gap that the upper rim hides from the camera, 0..1."""


def fill_holes(
    value_mm: NDArray[np.float64],
    sigma_mm: NDArray[np.float64],
    pinhole: NDArray[np.bool_],
    cell_mm: float,
    lean: NDArray[np.float64] | None = None,
) -> Filled:
    """Fill the NaN cells of a field (Ny, Nx) of heights over the belt.

    Each hole cell looks to the rims of its hole along five lines: across, along, both diagonals, and that on which
    the camera looks (``lean`` (2, Ny, Nx): tangents of the rays' slant in x and y; None: from straight above).
    Short lines count more.

    On a gentle rise a line gives the straight connection. Across a step it gives the lower side but for the last
    bit of the upper one: a step that falls away from the camera hides the gap's far part up to the ray that just
    passes it, and what hides and what a matcher loses beside it lies mostly behind and below. So lines that run
    along such a shadow, from one thing that hides to the next, do not raise it. A line from top to top over a gap
    that is deeper than wide, as other lines show, does not count either: it was not measured because it is deep.

    What is not steep sags by the unevenness that the measured surface itself has over such a gap: places that no
    camera matched are rather hollows than humps.

    Beyond the outermost measured cells the nearest ones continue. σ in a hole is that of a value anywhere from the
    lowest rim, and some of that unevenness below, to as far above the straight lines' mean, though not above the
    highest rim, with the rims' own σ; ``pinhole`` (Ny, Nx) are gaps between points of neighbouring pixels, where half
    of it is left.
    """
    hole = ~np.isfinite(value_mm)
    if hole.all():
        raise ValueError("nothing to interpolate from")
    if not hole.any():
        return Filled(value_mm, sigma_mm, hole)
    rim = _calmed(value_mm, hole)
    slant = np.zeros((2, *hole.shape)) if lean is None else lean
    lines = lines_through(rim, hole, slopes(value_mm, cell_mm), slant, cell_mm)
    floor = np.fmin.reduce([np.fmin(line.near_mm, line.far_mm) for line in lines])
    hollow = hollows(value_mm, cell_mm)
    mean, straight = _joined(lines, floor, cell_mm, hollow)
    shortest = np.min([line.near_at_mm + line.far_at_mm for line in lines], axis=0)
    unseen = _UNSEEN * hollow.depth_mm(np.where(np.isfinite(shortest), shortest, 0.0))
    ceiling = np.fmax.reduce([np.fmax(line.near_mm, line.far_mm) for line in lines])
    above = np.minimum(ceiling - straight, straight - floor)
    open_mm = (
        (np.clip(straight - floor + np.clip(above, 0, None), 0, None) + unseen)
        / np.sqrt(12)
        * np.where(pinhole[hole], 0.5, 1.0)
    )
    # what only one rim tells anything of lies outside: there the load may be any that is seen elsewhere
    spread = np.where(np.isfinite(straight), open_mm, float(np.nanstd(value_mm)))
    value, sigma = value_mm.copy(), sigma_mm.copy()
    # nothing measured says of a hollow that it reaches below the belt
    value[hole] = np.maximum(mean, np.fmin(floor, 0.0))
    sigma[hole] = np.hypot(spread, float(np.nanmedian(sigma_mm)))
    lost = ~np.isfinite(value)
    if lost.any():
        value, sigma = _continued(value, sigma, lost)
    return Filled(value, sigma, hole)


def _joined(
    lines: list[Line], floor: NDArray[np.float64], cell_mm: float, hollow: Hollows
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean guess of the lines, the first being the camera's own, and the mean of their straight connections."""
    view = _guess(lines[0], floor, 0.0, cell_mm, hollow)
    shadow = np.where(np.isfinite(view.straight), view.hidden, 0.0)
    total, sum_ = view.weight.copy(), view.weight * view.value
    straight_sum, straight_total = np.zeros_like(total), np.zeros_like(total)
    for line in lines:
        guess = view if line is lines[0] else _guess(line, floor, shadow, cell_mm, hollow)
        if line is not lines[0]:
            weight = guess.weight * np.where(guess.value > view.value, 1 - shadow, 1.0)
            total += weight
            sum_ += weight * guess.value
        both = np.isfinite(guess.straight)
        plain = np.where(both, 1 / np.maximum(line.near_at_mm + line.far_at_mm, cell_mm) ** 2, 0.0)
        straight_total += plain
        straight_sum += plain * np.where(both, guess.straight, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(total > 0, sum_ / total, np.nan), straight_sum / straight_total


def _guess(
    line: Line,
    floor: NDArray[np.float64],
    shadow: NDArray[np.float64] | float,
    cell_mm: float,
    hollow: Hollows,
) -> _Guess:
    """What a line tells; ``shadow`` (H,) is how much the camera's own line already explains."""
    near, far = line.near_mm, line.far_mm
    both = np.isfinite(near) & np.isfinite(far)
    with np.errstate(invalid="ignore", divide="ignore"):
        gap = line.near_at_mm + line.far_at_mm
        near_is_upper = near >= far
        upper, lower = np.maximum(near, far), np.minimum(near, far)
        drop = upper - lower
        from_upper = np.where(near_is_upper, line.near_at_mm, line.far_at_mm)
        straight = upper - drop * from_upper / gap
        away = np.where(near_is_upper, line.slant, -line.slant)
        hidden = np.minimum(gap, np.maximum(away, 0) * drop)
        level = _fade(np.where(near_is_upper, line.near_slope, line.far_slope), _LEVEL)
        bare = np.maximum(gap - hidden - cell_mm, 0)
        cut = np.minimum(bare / 2, _BEYOND_PX * cell_mm) + 0.5 * cell_mm
        step = lower + drop * np.clip((cut - from_upper) / cell_mm + 0.5, 0, 1)
        steep = 1 - _fade(drop / gap, _STEEP)
        # a flank that faces the camera is seen: the straight line stays
        sagging = straight - _HOLLOW * hollow.depth_mm(gap) * 4 * from_upper * (gap - from_upper) / gap**2
        sagging = straight + (1 - steep) * (sagging - straight)
        value = sagging + np.where(away < 0, steep * level, steep) * (step - sagging)
        flat = _fade(np.maximum(line.near_slope, line.far_slope), _LEVEL)
        deep = 1 - _fade((lower - floor) / gap, _CREVICE)
        deep = deep * np.maximum(flat, (1 - shadow) * _DOUBT_OF_CREVICES)
        weight = (1 - 0.999 * deep) / gap**2
    one = np.where(np.isfinite(near), near, far)
    one_at = np.where(np.isfinite(near), line.near_at_mm, line.far_at_mm)
    # a line that found only one rim cannot tell a slope: it counts little
    lone = np.where(np.isfinite(one), _ONE_SIDED / np.minimum(one_at, 1e12) ** 2, 0.0)
    return _Guess(
        np.where(both, value, np.nan_to_num(one)),
        np.where(both, straight, np.nan),
        np.where(both, weight, lone),
        np.where(both, steep * np.where(both, hidden, 0.0) / np.where(both, gap, 1.0), 0.0),
    )


def _fade(values: NDArray[np.float64], limits: tuple[float, float]) -> NDArray[np.float64]:
    """1 up to the first limit, falling to 0 at the second."""
    return np.clip((limits[1] - values) / (limits[1] - limits[0]), 0, 1)


def _calmed(value: NDArray[np.float64], hole: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Rim cells replaced by the median of the measured cells about them: one flying pixel moves no hole."""
    rows, columns = np.nonzero(np.asarray(ndimage.binary_dilation(hole), bool) & ~hole)
    padded = np.pad(value, 1, constant_values=np.nan)
    around = np.stack([padded[rows + i, columns + j] for i in range(3) for j in range(3)])
    around.sort(axis=0)  # NaN goes last
    number = np.isfinite(around).sum(axis=0)
    calm = value.copy()
    pick = np.arange(len(rows))
    calm[rows, columns] = 0.5 * (around[(number - 1) // 2, pick] + around[number // 2, pick])
    return calm


def _continued(
    value: NDArray[np.float64], sigma: NDArray[np.float64], lost: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The nearest known cell's value, with the whole field's relief as its σ."""
    nearest = ndimage.distance_transform_edt(lost, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    relief = float(np.std(value[~lost]))
    return value[tuple(nearest)], np.where(lost, np.hypot(sigma, relief), sigma)
