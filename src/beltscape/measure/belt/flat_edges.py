"""The direction of a flat belt from its edges: straight steps down to the floor or up to a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.statistics import MAD_TO_SIGMA, compute_biweights


@dataclass(frozen=True, slots=True)
class EdgeYaw:
    """Direction of a belt's edges in the belt's plane."""

    angle_rad: float
    """Angle of the edges against the plane's second axis; positive towards minus the first."""
    sigma_rad: float
    """One standard deviation of the angle."""


def fit_edge_yaw(
    plane_mm: NDArray[np.float64], off_mm: NDArray[np.float64], tolerance_mm: float
) -> EdgeYaw | None:
    """Fit the direction of the straight steps that bound a plane; None where no long one is visible.

    ``plane_mm`` (H, W, 2) and ``off_mm`` (H, W) are each pixel's position in the plane and its height off it. Only
    borders with another surface measured nearby count, so that the border of the light does not.
    """
    points = _border_mask(off_mm, tolerance_mm)
    points = plane_mm[points]
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 40:
        return None
    step_mm = float(np.nanmedian(np.linalg.norm(np.diff(plane_mm, axis=1), axis=-1)))
    bin_mm = 3 * step_mm
    angle, offsets = _find_edge_direction(points, bin_mm)
    length = float(np.nanmax(plane_mm[..., 1]) - np.nanmin(plane_mm[..., 1]))
    lines = [
        line
        for offset in offsets
        if np.ptp((line := points[np.abs(_project_across(points, angle) - offset) < 2 * bin_mm])[:, 1]) > 0
        and len(line) >= 40
    ]
    fits = [fit for line in lines if (fit := _fit_line(line, angle, 0.3 * length, step_mm)) is not None]
    if not fits:
        return None
    weights = np.array([1 / sigma**2 for _, sigma in fits])
    mean = float(np.average([a for a, _ in fits], weights=weights))
    return EdgeYaw(mean, float(np.sqrt(1 / weights.sum())))


def _border_mask(off_mm: NDArray[np.float64], tolerance_mm: float) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of the plane next to a step."""
    measured = np.isfinite(off_mm)
    on = ndimage.binary_closing(measured & (np.abs(off_mm) < tolerance_mm), iterations=3)
    on = np.asarray(ndimage.binary_opening(on, iterations=3), bool)
    other = measured & (np.abs(off_mm) > 2 * tolerance_mm)
    other = np.asarray(ndimage.binary_opening(other, iterations=3), bool)
    if not other.any():
        return np.zeros_like(on)
    near = np.asarray(ndimage.distance_transform_edt(~other)) < 0.05 * off_mm.shape[1]
    border = on & ~np.asarray(ndimage.binary_erosion(on, border_value=1), bool)
    return border & near


def _project_across(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    return points[:, 0] * np.cos(angle) + points[:, 1] * np.sin(angle)


def _find_edge_direction(points: NDArray[np.float64], bin_mm: float) -> tuple[float, list[float]]:
    """Return the direction in which the points lie on the fewest lines, and the offsets of up to two of these."""
    best, best_score, best_counts, best_start = 0.0, -1.0, np.zeros(1), 0.0
    for angle in np.deg2rad(np.arange(-90, 90, 0.25)):
        across = _project_across(points, angle)
        start = float(across.min())
        counts = np.bincount(((across - start) / bin_mm).astype(np.intp)).astype(np.float64)
        score = float(np.sum(counts**2))
        if score > best_score:
            best, best_score, best_counts, best_start = float(angle), score, counts, start
    first = int(np.argmax(best_counts))
    offsets = [best_start + (first + 0.5) * bin_mm]
    apart = np.abs(np.arange(len(best_counts)) - first) * bin_mm > 0.2 * len(best_counts) * bin_mm
    rest = np.where(apart, best_counts, 0)
    if rest.max() > 0.3 * best_counts[first]:
        offsets.append(best_start + (int(np.argmax(rest)) + 0.5) * bin_mm)
    return best, offsets


def _fit_line(
    points: NDArray[np.float64], angle: float, least_mm: float, step_mm: float
) -> tuple[float, float] | None:
    """Return the angle (rad) of the line through the points and its standard deviation; None where it is short."""
    across = _project_across(points, angle)
    along = -points[:, 0] * np.sin(angle) + points[:, 1] * np.cos(angle)
    if np.ptp(along) < least_mm:
        return None
    design = np.column_stack([np.ones_like(along), along - along.mean()])
    weight: NDArray[np.float64] = np.ones_like(along)
    slope, noise = 0.0, 0.0
    for _ in range(5):
        weighted = design * weight[:, None]
        solved = cast("NDArray[np.float64]", np.linalg.solve(weighted.T @ design, weighted.T @ across))
        offset, slope = solved
        residual: NDArray[np.float64] = across - offset - design[:, 1] * slope
        noise = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-6
        weight = compute_biweights(residual, noise)
    # errors of neighbouring border pixels are correlated: ten of them count as one; an edge along the rows or
    # columns of pixels is located only to a fraction of a pixel over its whole length
    sigma = np.hypot(noise / np.sqrt(np.sum(weight * design[:, 1] ** 2) / 10), 0.3 * step_mm / np.ptp(along))
    return float(angle - np.arctan(slope)), float(sigma)
