"""Guided matching of tie points: a search around the positions that a depth map and the rig predict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet, Image, to_grey
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.tie_points.tie_points import Array, TiePoints
from beltscape.stereo.correlation_peak import refine_peak

_HALF_PX = 7
"""Half the side of a patch."""
_SEARCH_RADII_PX = (4, 16, 40)
"""The search radius grows while too few points of a camera are found; 40 px is a turn of one or two degrees."""
_ENOUGH = 0.4
"""Share of a camera's points that must be found for the search to end."""
_CORRELATION = 0.7
"""Least normalised correlation of a match; 225 pixels of speckle reach 0.5 by chance."""
_SMOOTH = 0.02
"""Greatest mean deviation of a patch's inverse depth from its plane, as a share of it; a larger one means an edge."""
_MEASURED = 0.7
"""Least share of a patch with a depth."""


def match_guided(
    frame_set: FrameSet, rig: Rig, auxiliaries: Sequence[str], depth: DepthMap, points_px: Array
) -> TiePoints:
    """Match points (N, 2) of the core's undistorted grid with each auxiliary image, starting from their depth."""
    centres = np.rint(points_px).astype(int)
    height, width = depth.depth_mm.shape
    inside = ((centres >= _HALF_PX) & (centres < np.array([width, height]) - _HALF_PX)).all(axis=1)
    centres = centres[inside]
    planes, is_smooth = _fit_planes(depth.depth_mm, centres)
    centres, planes = centres[is_smooth].astype(np.float64), planes[is_smooth]
    templates = _sample_patches(frame_set.images[rig.core], _distort_to_core(rig, centres, planes), _HALF_PX)
    observed: dict[str, Array] = {}
    searched: dict[str, NDArray[np.bool_]] = {}
    for name in auxiliaries:
        observed[name], searched[name] = _search(
            frame_set.images[name], rig, name, centres, planes, templates
        )
    return TiePoints(centres, planes[:, 0], observed, searched)


def _fit_planes(depth_mm: NDArray[np.float32], centres: NDArray[np.int64]) -> tuple[Array, NDArray[np.bool_]]:
    """Return (N, 3) inverse depth of patches with its slopes by u and v (1/mm, per px), and (N,) which are planar."""
    step = np.arange(-_HALF_PX, _HALF_PX + 1)
    window = depth_mm[
        centres[:, 1, None, None] + step[None, :, None], centres[:, 0, None, None] + step[None, None, :]
    ]
    window = window.reshape(len(centres), len(step) ** 2).astype(np.float64)
    measured = np.isfinite(window)
    inverse = np.where(measured, 1 / np.where(measured, window, 1.0), 0.0)
    u, v = (x.ravel().astype(np.float64) for x in np.meshgrid(step, step))
    basis = np.stack([np.ones_like(u), u, v], axis=1)
    weight = measured.astype(np.float64)
    normal = np.einsum("np,pi,pj->nij", weight, basis, basis) + 1e-9 * np.eye(3)
    right = np.einsum("np,pi->ni", inverse, basis)[..., None]
    planes = cast("NDArray[np.float64]", np.linalg.solve(normal, right))[..., 0]
    deviation = np.abs(inverse - planes @ basis.T) * weight
    scatter = deviation.sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
    is_smooth = (weight.mean(axis=1) >= _MEASURED) & (scatter < _SMOOTH * np.abs(planes[:, 0]))
    return planes, is_smooth


def _search(
    image: Image, rig: Rig, name: str, centres: Array, planes: Array, templates: NDArray[np.float32]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the positions of the templates in an auxiliary image (N, 2), and which were searched in it."""
    predicted, slope = _project_to_auxiliary(rig, name, centres, planes)
    limit = np.array(image.shape[1::-1]) - _HALF_PX
    inside = np.all((predicted >= _HALF_PX) & (predicted < limit), axis=1)
    observed = np.full(predicted.shape, np.nan)
    for radius in _SEARCH_RADII_PX:
        missing = np.flatnonzero(inside & np.isnan(observed[:, 0]))
        areas = _sample_patches(image, (predicted[missing], slope[missing]), _HALF_PX + radius)
        for i, area in zip(missing, areas, strict=True):
            peak = refine_peak(cv2.matchTemplate(area, templates[i], cv2.TM_CCOEFF_NORMED), _CORRELATION)
            if peak is not None:
                observed[i] = predicted[i] + slope[i] @ (np.array(peak) - radius)
        if np.isfinite(observed[inside, 0]).sum() >= _ENOUGH * max(inside.sum(), 1):
            break
    return observed, inside


def _distort_to_core(rig: Rig, centres: Array, planes: Array) -> tuple[Array, Array]:
    """Return the pixels (N, 2) of the distorted core image at the centres, and derivatives (N, 2, 2) by u and v."""
    camera = rig.core_camera

    def project(points: Array, _: Array) -> Array:
        return (
            camera.distort((points - camera.center_px) / camera.focal_px) * camera.focal_px + camera.center_px
        )

    return _linearise(project, centres, planes)


def _project_to_auxiliary(rig: Rig, name: str, centres: Array, planes: Array) -> tuple[Array, Array]:
    """Return the pixels (N, 2) of an auxiliary image at the centres, on their planes, and derivatives (N, 2, 2)."""
    core, camera, pose = rig.core_camera, rig.cameras[name], rig.cam_from_core[name]

    def project(points: Array, inverse_depth: Array) -> Array:
        rays = np.concatenate([(points - core.center_px) / core.focal_px, np.ones((len(points), 1))], axis=1)
        return camera.project(pose.apply(rays / inverse_depth[:, None]))

    return _linearise(project, centres, planes)


def _linearise(
    project: Callable[[Array, Array], Array], centres: Array, planes: Array
) -> tuple[Array, Array]:
    """Return a projection's values at the centres and its central differences along the planes."""
    slope = np.empty((len(centres), 2, 2))
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = _HALF_PX
        forth = project(centres + step, planes[:, 0] + _HALF_PX * planes[:, 1 + axis])
        back = project(centres - step, planes[:, 0] - _HALF_PX * planes[:, 1 + axis])
        slope[:, :, axis] = (forth - back) / (2 * _HALF_PX)
    return project(centres, planes[:, 0]), slope


def _sample_patches(image: Image, grid: tuple[Array, Array], half: int) -> NDArray[np.float32]:
    """Return (N, S, S) grey patches around centres (N, 2) with axes (N, 2, 2); the image's edges are repeated."""
    centres, axes = grid
    step = np.arange(-half, half + 1, dtype=np.float32)
    side = len(step)
    if not len(centres):
        return np.empty((0, side, side), np.float32)
    du, dv = (x.ravel() for x in np.meshgrid(step, step))
    offsets = axes.astype(np.float32) @ np.stack([du, dv])
    pixels = offsets + centres.astype(np.float32)[:, :, None]
    # OpenCV remaps images of at most 32767 rows and columns
    rows = [
        cv2.remap(image, part[:, 0], part[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.array_split(np.nan_to_num(pixels, nan=-1e4), max(1, -(-len(pixels) // 30000)))
    ]
    return to_grey(np.concatenate(rows)).reshape(-1, side, side)
