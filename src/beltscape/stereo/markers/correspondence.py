"""Correspondence of markers between the cameras of a rig: a common numbering of their grids."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels, load
from beltscape.stereo.markers.grid import SIDE, MarkerGrid
from beltscape.stereo.multiview.initialisation.depth_range import compute_search_range

_MAX_ERROR_RADII = 0.3
"""Largest reprojection error of a marker, in its radii; hiding half of a disc shifts its centroid by 0.42."""
_MAX_ERROR_PX = 2.0
"""Largest reprojection error of small markers, px: the accuracy of rig and centroid."""
_MIN_CONSISTENT, _MIN_CONSISTENT_SHARE = 4, 0.7
"""Least number of consistent markers of an accepted numbering, and their share of the common ones; four of five by
chance are rarer than one in a thousand."""


def align_grids(grids: Mapping[str, MarkerGrid], rig: Rig) -> dict[str, MarkerGrid]:
    """Return the grids with the rows and columns of the camera with the most markers; among equals, of the core.

    Every other grid is turned (0, 90, 180, 270°) and, where whole rows or columns are missing, shifted so that the
    rays of most markers intersect; a grid in which hardly any do is left out.
    """
    if not grids:
        return {}
    kernels = load()
    reference = max(grids, key=lambda name: (grids[name].count, name == rig.core))
    aligned = {reference: grids[reference]}
    for name in grids:
        if name == reference:
            continue
        best, best_score = None, (0, 0.0)
        for option in grids[name].list_numberings():
            count, error, common = _compare_pair({reference: grids[reference], name: option}, rig, kernels)
            if count >= max(_MIN_CONSISTENT, _MIN_CONSISTENT_SHARE * common) and (count, -error) > best_score:
                best, best_score = option, (count, -error)
        if best is not None:
            aligned[name] = best
    return {name: aligned[name] for name in grids if name in aligned}


def _compare_pair(grids: Mapping[str, MarkerGrid], rig: Rig, kernels: Kernels) -> tuple[int, float, int]:
    """Return how many markers of two cameras are consistent, their mean error (px), and how many are common."""
    names = list(grids)
    pixels = np.stack([_undistort_centers(grids[name], rig, name) for name in names])
    points = kernels.triangulate(np.stack([rig.projection(name) for name in names]), pixels)
    error = _reprojection_errors_px(points, pixels, rig, names)
    limit = np.stack([_max_error_px(grids[name]) for name in names])
    near, far = compute_search_range(rig, rig.auxiliaries)
    consistent = (error < limit).all(axis=0) & (points[:, 2] > near) & (points[:, 2] < far)
    common = int(np.isfinite(pixels).all(axis=(0, 2)).sum())
    return int(consistent.sum()), float(error[:, consistent].mean()) if consistent.any() else np.inf, common


def _undistort_centers(grid: MarkerGrid, rig: Rig, name: str) -> NDArray[np.float64]:
    """Return the (16, 2) undistorted pixels; NaN where not detected."""
    camera = rig.cameras[name]
    pixels = camera.undistort(grid.center_px.reshape(-1, 2)) * camera.focal_px + camera.center_px
    pixels[~grid.detected.reshape(-1)] = np.nan
    return pixels


def _max_error_px(grid: MarkerGrid) -> NDArray[np.float64]:
    """Return the (16,) largest accepted reprojection error of each marker."""
    typical = float(np.nanmedian(grid.radius_px))
    return np.full(SIDE * SIDE, max(_MAX_ERROR_PX, _MAX_ERROR_RADII * typical))


def _reprojection_errors_px(
    points_mm: NDArray[np.float64], pixels: NDArray[np.float64], rig: Rig, names: list[str]
) -> NDArray[np.float64]:
    """Return the (n, N) distance of undistorted pixels from the projected points; inf behind a camera."""
    errors: list[NDArray[np.float64]] = []
    for name, measured in zip(names, pixels, strict=True):
        local = rig.cam_from_core[name].apply(points_mm)
        camera = rig.cameras[name]
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = local[:, :2] / local[:, 2:] * camera.focal_px + camera.center_px
        distance = np.linalg.norm(expected - measured, axis=-1)
        errors.append(np.where(local[:, 2] > 0, distance, np.where(np.isfinite(distance), np.inf, np.nan)))
    return np.array(errors)
