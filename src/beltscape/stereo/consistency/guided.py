"""Tie points found about where a depth map and the rig predict them, in two dimensions."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet, Image, to_grey
from beltscape.core.rig import Rig
from beltscape.stereo.consistency.tie_points import Array, TiePoints
from beltscape.stereo.correlation_peak import refined_peak

HALF_PX = 7
"""Half the side of a patch."""
REACHES_PX = (4, 16, 40)
"""The search grows to this distance while too few points of a camera are found; 40 px is a degree or two."""
_ENOUGH = 0.4
"""Share of a camera's points that must be found for the search to end."""
_CORRELATION = 0.7
"""Least normalised correlation of a match; by chance 225 pixels of speckle reach 0.5."""
_SMOOTH = 0.02
"""A patch whose inverse depth scatters more about a plane (share of it) holds an edge."""
_MEASURED = 0.7
"""Share of a patch that must have a depth."""


def guided_points(
    frame_set: FrameSet, rig: Rig, auxiliaries: Sequence[str], depth: DepthMap, points_px: Array
) -> TiePoints:
    """Find points (N, 2) of the core's undistorted grid in each auxiliary image, starting from their depth."""
    centres = np.rint(points_px).astype(int)
    height, width = depth.depth_mm.shape
    inside = ((centres >= HALF_PX) & (centres < np.array([width, height]) - HALF_PX)).all(axis=1)
    centres = centres[inside]
    planes, smooth = _planes(depth.depth_mm, centres)
    centres, planes = centres[smooth].astype(np.float64), planes[smooth]
    templates = _sampled(frame_set.images[rig.core], _core_pixels(rig, centres, planes), HALF_PX)
    found, searched = {}, {}
    for name in auxiliaries:
        found[name], searched[name] = _search(frame_set.images[name], rig, name, centres, planes, templates)
    return TiePoints(centres, planes[:, 0], found, searched)


def _planes(depth_mm: NDArray[np.float32], centres: NDArray[np.int64]) -> tuple[Array, NDArray[np.bool_]]:
    """Return (N, 3) inverse depth and its slopes by u and v (1/mm, per px) in patches, and where they are planes."""
    step = np.arange(-HALF_PX, HALF_PX + 1)
    window = depth_mm[
        centres[:, 1, None, None] + step[None, :, None], centres[:, 0, None, None] + step[None, None, :]
    ]
    window = window.reshape(len(centres), -1).astype(np.float64)
    measured = np.isfinite(window)
    inverse = np.where(measured, 1 / np.where(measured, window, 1.0), 0.0)
    u, v = (x.ravel().astype(np.float64) for x in np.meshgrid(step, step))
    basis = np.stack([np.ones_like(u), u, v], axis=1)
    weight = measured.astype(np.float64)
    normal = np.einsum("np,pi,pj->nij", weight, basis, basis) + 1e-9 * np.eye(3)
    planes = np.linalg.solve(normal, np.einsum("np,pi->ni", inverse, basis)[..., None])[..., 0]
    misfit = np.abs(inverse - planes @ basis.T) * weight
    scatter = misfit.sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
    smooth = (weight.mean(axis=1) >= _MEASURED) & (scatter < _SMOOTH * np.abs(planes[:, 0]))
    return planes, smooth


def _search(
    image: Image, rig: Rig, name: str, centres: Array, planes: Array, templates: NDArray[np.float32]
) -> tuple[Array, NDArray[np.bool_]]:
    """Where an auxiliary image shows the templates (N, 2), and which were searched in it."""
    place, slope = _auxiliary_pixels(rig, name, centres, planes)
    limit = np.array(image.shape[1::-1]) - HALF_PX
    inside = np.all((place >= HALF_PX) & (place < limit), axis=1)
    found = np.full(place.shape, np.nan)
    for reach in REACHES_PX:
        todo = np.flatnonzero(inside & np.isnan(found[:, 0]))
        areas = _sampled(image, (place[todo], slope[todo]), HALF_PX + reach)
        for i, area in zip(todo, areas, strict=True):
            peak = refined_peak(cv2.matchTemplate(area, templates[i], cv2.TM_CCOEFF_NORMED), _CORRELATION)
            if peak is not None:
                found[i] = place[i] + slope[i] @ (np.array(peak) - reach)
        if np.isfinite(found[inside, 0]).sum() >= _ENOUGH * max(inside.sum(), 1):
            break
    return found, inside


def _core_pixels(rig: Rig, centres: Array, planes: Array) -> tuple[Array, Array]:
    """Pixels (N, 2) of the distorted core image at the centres, and their derivatives (N, 2, 2) by u and v."""
    camera = rig.core_camera

    def project(points: Array, _: Array) -> Array:
        return (
            camera.distort((points - camera.center_px) / camera.focal_px) * camera.focal_px + camera.center_px
        )

    return _linearised(project, centres, planes)


def _auxiliary_pixels(rig: Rig, name: str, centres: Array, planes: Array) -> tuple[Array, Array]:
    """Pixels (N, 2) of an auxiliary image at the centres, on each patch's plane, and derivatives (N, 2, 2)."""
    core, camera, pose = rig.core_camera, rig.cameras[name], rig.cam_from_core[name]

    def project(points: Array, inverse_depth: Array) -> Array:
        rays = np.concatenate([(points - core.center_px) / core.focal_px, np.ones((len(points), 1))], axis=1)
        return camera.project(pose.apply(rays / inverse_depth[:, None]))

    return _linearised(project, centres, planes)


def _linearised(project, centres: Array, planes: Array) -> tuple[Array, Array]:
    """Value of a projection at the centres and central differences along the planes."""
    slope = np.empty((len(centres), 2, 2))
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = HALF_PX
        forth = project(centres + step, planes[:, 0] + HALF_PX * planes[:, 1 + axis])
        back = project(centres - step, planes[:, 0] - HALF_PX * planes[:, 1 + axis])
        slope[:, :, axis] = (forth - back) / (2 * HALF_PX)
    return project(centres, planes[:, 0]), slope


def _sampled(image: Image, where: tuple[Array, Array], half: int) -> NDArray[np.float32]:
    """Return (N, S, S) grey patches about places (N, 2), along derivatives (N, 2, 2); edges are repeated."""
    place, slope = where
    step = np.arange(-half, half + 1, dtype=np.float32)
    side = len(step)
    if not len(place):
        return np.empty((0, side, side), np.float32)
    du, dv = (x.ravel() for x in np.meshgrid(step, step))
    local = slope.astype(np.float32) @ np.stack([du, dv])
    grid = local + place.astype(np.float32)[:, :, None]
    # OpenCV remaps images of at most 32767 rows and columns
    rows = [
        cv2.remap(image, part[:, 0], part[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.array_split(np.nan_to_num(grid, nan=-1e4), max(1, -(-len(grid) // 30000)))
    ]
    return to_grey(np.concatenate(rows)).reshape(-1, side, side)
