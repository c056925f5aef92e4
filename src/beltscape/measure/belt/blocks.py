"""Robust planes: of each block of pixels of a depth map, and of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.statistics import MAD_TO_SIGMA, TUKEY, compute_biweights

_MIN_SHARE = 0.5
"""A block with a smaller share of measured pixels gets no plane."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockPlanes:
    """Planes of the blocks that have one, in the camera's frame."""

    normals: NDArray[np.float64]
    """(M, 3) unit normals towards the camera."""
    centers_mm: NDArray[np.float64]
    """(M, 3) points of the planes at the blocks' centres."""
    rms_mm: NDArray[np.float64]
    """(M,) robust scatter of the pixels about their plane, along the ray."""
    row: NDArray[np.intp]
    """(M,) number of the block's row of blocks."""
    column: NDArray[np.intp]
    """(M,) number of the block's column of blocks."""

    def select(self, keep: NDArray[np.bool_]) -> BlockPlanes:
        """Return the blocks where ``keep`` (M,) is set."""
        return BlockPlanes(
            self.normals[keep], self.centers_mm[keep], self.rms_mm[keep], self.row[keep], self.column[keep]
        )


def fit_block_planes(depth: DepthMap, camera: Camera, side_px: int) -> BlockPlanes:
    """Fit a robust plane to every block of ``side_px`` × ``side_px`` pixels.

    The inverse depth of a plane is affine over the image, so each block is a linear fit of three parameters,
    iterated with Tukey weights.
    """
    height, width = (n // side_px * side_px for n in depth.depth_mm.shape)
    inverse = _split_blocks(1.0 / depth.depth_mm[:height, :width].astype(np.float64), side_px)
    rays = camera.rays()[:height, :width]
    design = np.stack(
        [_split_blocks(rays[..., 0], side_px), _split_blocks(rays[..., 1], side_px), np.ones_like(inverse)],
        -1,
    )
    enough = np.isfinite(inverse).mean(axis=1) >= _MIN_SHARE
    inverse, design = inverse[enough], design[enough]
    row, column = np.divmod(np.flatnonzero(enough), width // side_px)
    if not len(inverse):
        return BlockPlanes(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), row, column)
    middle = design.mean(axis=1)
    local = design.copy()
    local[..., :2] -= middle[:, None, :2]
    weight = np.isfinite(inverse).astype(np.float64)
    filled = np.where(weight > 0, inverse, 0.0)
    plane, scale = np.zeros((len(inverse), 3)), np.zeros(len(inverse))
    for _ in range(4):
        weighted = local * weight[..., None]
        normal_matrix = weighted.transpose(0, 2, 1) @ local
        normal_matrix += 1e-12 * np.trace(normal_matrix, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        right = weighted.transpose(0, 2, 1) @ filled[..., None]
        plane = cast("NDArray[np.float64]", np.linalg.solve(normal_matrix, right))[..., 0]
        residual = np.where(np.isfinite(inverse), inverse - (local @ plane[..., None])[..., 0], np.nan)
        scale = MAD_TO_SIGMA * np.nanmedian(np.abs(residual), axis=1) + 1e-12
        ratio = np.nan_to_num(residual / (TUKEY * scale[:, None]), nan=1.0)
        weight = np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)
    # w = a·x/z + b·y/z + c is the plane a·X + b·Y + c·Z = 1
    normal = plane.copy()
    normal[:, 2] -= np.sum(plane[:, :2] * middle[:, :2], axis=1)
    normal *= -1.0 / np.linalg.norm(normal, axis=1, keepdims=True)
    z = 1.0 / plane[:, 2]
    return BlockPlanes(normal, middle * z[:, None], scale * z**2, row, column)


def _split_blocks(plane: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Return the pixels (H, W) as blocks (blocks, side²)."""
    rows, columns = plane.shape[0] // side, plane.shape[1] // side
    return plane.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows * columns, side * side)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The plane of the points p with normal · p = offset."""

    normal: NDArray[np.float64]
    """(3,) unit, z positive."""
    offset_mm: float
    """Distance of the plane from the origin along the normal."""
    rms_mm: float
    """Robust scatter of the points about it."""
    sigma_rad: float
    """One standard deviation of the normal's direction (the worse axis), for independent points."""


def fit_plane(points_mm: NDArray[np.float64]) -> Plane:
    """Fit the plane z = a + b·x + c·y to points (N, 3), N ≥ 3, with Tukey weights on the robust scatter."""
    middle = np.median(points_mm, axis=0)
    local = points_mm - middle
    design = np.column_stack([np.ones(len(local)), local[:, :2]])
    weight = np.ones(len(local))
    answer, noise, normal_matrix = np.zeros(3), 0.0, np.eye(3)
    for _ in range(8):
        normal_matrix = (design * weight[:, None]).T @ design
        answer = np.linalg.solve(normal_matrix, design.T @ (weight * local[:, 2]))
        residual = local[:, 2] - design @ answer
        noise = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-9
        weight = compute_biweights(residual, noise)
    normal = np.array([-answer[1], -answer[2], 1.0])
    normal /= np.linalg.norm(normal)
    sigma = noise * np.sqrt(np.diag(np.linalg.inv(normal_matrix))[1:].max())
    return Plane(normal, float(normal @ (middle + np.array([0.0, 0.0, answer[0]]))), noise, float(sigma))
