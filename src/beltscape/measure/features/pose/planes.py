"""The planes of a depth map, as candidates for the upper face of a module's base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.measure.belt.blocks import BlockPlanes, fit_block_planes

_NEAR_MM, _TILT_RAD = 1.0, np.deg2rad(2.0)
"""Largest distance and inclination of a block that belongs to a plane."""
_FINE_PX = 16
"""Edge of a block at an image width of ``_FINE_OF_PX``, narrower than the gaps between features."""
_FINE_OF_PX = 1224
"""Image width for which ``_FINE_PX`` is given: that of the rendered captures."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidatePlane:
    """A plane of points p in the core's frame with normal · p = offset."""

    normal: NDArray[np.float64]
    """(3,) unit, towards the camera."""
    offset_mm: float
    area_mm2: float
    """Area of its blocks, as projected into the camera."""


def find_candidate_planes(depth: DepthMap, camera: Camera, most: int) -> list[CandidatePlane]:
    """Find up to ``most`` planes one after another, each from the blocks that earlier planes left."""
    side = max(8, round(_FINE_PX * camera.size_px[0] / _FINE_OF_PX))
    blocks = fit_block_planes(depth, camera, side)
    blocks = blocks.select(
        blocks.rms_mm
        <= max(4 * _median_or_zero(blocks.rms_mm), 1e-5 * _median_or_zero(blocks.centers_mm[:, 2]))
    )
    found: list[CandidatePlane] = []
    while len(found) < most and len(blocks.normals) >= 6:
        normal, offset, members = _find_largest_plane(blocks)
        if members.sum() < 6:
            break
        area = float(np.sum((side * blocks.centers_mm[members, 2]) ** 2) / np.prod(camera.focal_px))
        found.append(CandidatePlane(normal, offset, area))
        blocks = blocks.select(~members)
    return found


def _find_largest_plane(blocks: BlockPlanes) -> tuple[NDArray[np.float64], float, NDArray[np.bool_]]:
    """Return the plane with most blocks: normal, offset mm, and which blocks lie on it."""
    normals, centers = blocks.normals, blocks.centers_mm
    tries = np.unique(np.linspace(0, len(normals) - 1, 400).astype(int))
    counts = [int(_member_mask(blocks, normals[i], float(normals[i] @ centers[i])).sum()) for i in tries]
    best = tries[int(np.argmax(counts))]
    normal, offset = normals[best], float(normals[best] @ centers[best])
    members = _member_mask(blocks, normal, offset)
    for _ in range(4):
        if members.sum() < 6:
            break
        middle = centers[members].mean(axis=0)
        local = centers[members] - middle
        normal = np.linalg.eigh(local.T @ local)[1][:, 0]
        normal *= -np.sign(normal @ middle)
        offset = float(normal @ middle)
        members = _member_mask(blocks, normal, offset)
    return normal, offset, members


def _member_mask(blocks: BlockPlanes, normal: NDArray[np.float64], offset_mm: float) -> NDArray[np.bool_]:
    return (np.abs(blocks.centers_mm @ normal - offset_mm) < _NEAR_MM) & (
        blocks.normals @ normal > np.cos(_TILT_RAD)
    )


def _median_or_zero(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else 0.0
