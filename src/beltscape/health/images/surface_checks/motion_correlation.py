"""Displacement of moving texture between two cameras and two instants, by correlation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beltscape.health.images.surface_checks.surface_samples import Surface, SurfaceGrid, Texture

_WINDOW = 24
"""Largest displacement that is searched, in cells of the grid: some 50 mm."""
_STATIC_SHARE = 0.4
"""The search ends at this share of the travel: a projected pattern stands still and is displaced by all of it."""
_LEAST_SHARE = 0.05
"""Least share of the grid that must be compared."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameTextures:
    """The textures of all cameras at one instant, and the surface."""

    textures: Mapping[str, Texture]
    surface: Surface
    own: Mapping[str, Texture]
    """The textures at the points of the surface."""


@dataclass(frozen=True, slots=True)
class Displacement:
    """Displacement of an auxiliary's texture against the core's, positive along the travel."""

    moving_mm: float
    """Displacement of what moves with the belt, seen by the two cameras at different instants."""
    across_mm: float
    """Its displacement across the travel: 0 for cameras that agree with the rig, early or late."""
    same_mm: float
    """Of the texture at one and at the other instant: a projected pattern, which stands still, contributes to it."""
    correlation: float
    """Least correlation of the moving texture."""


def measure_displacement(
    grid: SurfaceGrid,
    before: FrameTextures,
    now: FrameTextures,
    travel_mm: NDArray[np.float64],
    core: str,
    auxiliaries: tuple[str, ...],
) -> dict[str, Displacement]:
    """Return the displacement of each auxiliary against the core, from two frames.

    Four displacements are averaged: of the core before to the auxiliary now and back, on the surface of either
    frame. An error of the travel, shadows that move over the material, and errors of the depth cancel.

    Parameters
    ----------
    grid
        The grid of both frames.
    before, now
        The frames.
    travel_mm
        (3,) motion of the belt between them in the core's frame.
    core, auxiliaries
        Names of cameras that both frames have.
    """
    later = grid.sample_all(
        {name: now.textures[name] for name in (core, *auxiliaries)}, before.surface.points_mm + travel_mm
    )
    earlier = grid.sample_all(
        {name: before.textures[name] for name in (core, *auxiliaries)}, now.surface.points_mm - travel_mm
    )
    length = float(np.linalg.norm(travel_mm))
    along = grid.compute_image_direction(now.surface.points_mm, travel_mm / length)
    window = int(min(_WINDOW, _STATIC_SHARE * length * np.linalg.norm(along)))
    first, last = before.surface.is_smooth, now.surface.is_smooth
    result: dict[str, Displacement] = {}
    for name in auxiliaries:
        peaks = [
            find_peak(before.own[core], later[name], first, window),
            find_peak(before.own[name], later[core], first, window),
            find_peak(now.own[core], earlier[name], last, window),
            find_peak(now.own[name], earlier[core], last, window),
        ]
        signs = np.array([1.0, -1.0, 1.0, -1.0])
        mean = (signs[:, None] * np.array([peak[0] for peak in peaks])).mean(axis=0)
        at_rest = (
            find_peak(before.own[core], before.own[name], first, window)[0],
            find_peak(now.own[core], now.own[name], last, window)[0],
        )
        same = 0.5 * (at_rest[0] + at_rest[1])
        scale = float(along @ along)
        result[name] = Displacement(
            float(mean @ along) / scale,
            float(mean @ (-along[1], along[0])) / scale,
            float(same @ along) / scale,
            min(peak[1] for peak in peaks),
        )
    return result


def correlate_at_rest(
    one: Texture, other: Texture, where: NDArray[np.bool_], least_share: float = _LEAST_SHARE
) -> float:
    """Return the normalised correlation of two textures without displacement; 0 where too little is seen by both."""
    seen = where & np.isfinite(one) & np.isfinite(other)
    if seen.mean() < least_share:
        return 0.0
    return float(np.corrcoef(one[seen], other[seen])[0, 1])


def find_peak(
    one: Texture, other: Texture, where: NDArray[np.bool_], window: int, least_share: float = _LEAST_SHARE
) -> tuple[NDArray[np.float64], float]:
    """Return displacement (2,), column and row, of ``other`` against ``one``, and the correlation there.

    ``where`` selects the compared texture of ``one``, at least ``least_share`` of the grid. Without a peak inside the
    window the correlation is 0.
    """
    none = np.zeros(2), 0.0
    seen = where & np.isfinite(one) & np.isfinite(other)
    if seen.mean() < least_share or window < 2:
        return none
    is_known = np.isfinite(other)
    selected = np.where(seen, one - one[seen].mean(), 0).astype(np.float32)
    searched = np.where(is_known, other - other[seen].mean(), 0).astype(np.float32)
    surface = _correlate(selected, searched, window)
    surface /= max(float(np.sqrt((selected**2).sum() * (searched[seen] ** 2).sum())), 1e-9)
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    if not (0 < row < 2 * window and 0 < column < 2 * window):
        return none
    value = float(surface[row, column])
    offset = (
        column - window + _refine(surface[row, column - 1 : column + 2]),
        row - window + _refine(surface[row - 1 : row + 2, column]),
    )
    return np.array(offset), value


def _correlate(one: Texture, other: Texture, window: int) -> NDArray[np.float64]:
    """Return the sums of products (2·window + 1, 2·window + 1) over displacements of ``other`` up to ``window``."""
    shape = [fft.next_fast_len(side + window, real=True) for side in one.shape]
    spectrum = np.conj(fft.rfft2(one, shape)) * fft.rfft2(other, shape)
    sums = np.asarray(fft.irfft2(spectrum, shape), np.float64)
    side = 2 * window + 1
    return np.roll(sums, (window, window), (0, 1))[:side, :side]


def _refine(three: NDArray[np.float64]) -> float:
    """Return the vertex of the parabola through three values, from the middle one."""
    low, middle, high = (float(value) for value in three)
    bend = low - 2 * middle + high
    return 0.5 * (low - high) / bend if bend < 0 else 0.0
