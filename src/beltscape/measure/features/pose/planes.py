"""Planes that a depth map holds: where the top of a module's base may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.measure.belt.blocks import BlockPlanes, fit_block_planes

_NEAR_MM, _TURN_RAD = 1.0, np.deg2rad(2.0)
"""Blocks this far off a plane, leaning this much, still belong to it."""
_FINE_PX = 16
"""Edge of a block at an image width of ``_FINE_OF_PX``: narrower than the gaps between features."""
_FINE_OF_PX = 1224


@dataclass(frozen=True, slots=True, eq=False)
class CandidatePlane:
    """Points p of the core's frame with normal · p = offset."""

    normal: NDArray[np.float64]
    """(3,) unit, towards the camera."""
    offset_mm: float
    area_mm2: float
    """Of the blocks that agree, as the camera sees them."""


def candidate_planes(depth: DepthMap, camera: Camera, most: int) -> list[CandidatePlane]:
    """Up to ``most`` planes, the ones with most blocks first, each from blocks no plane before it took."""
    side = max(8, round(_FINE_PX * camera.size_px[0] / _FINE_OF_PX))
    blocks = fit_block_planes(depth, camera, side)
    blocks = _kept(
        blocks, blocks.rms_mm <= max(4 * _low(blocks.rms_mm), 1e-5 * _low(blocks.centers_mm[:, 2]))
    )
    found: list[CandidatePlane] = []
    while len(found) < most and len(blocks.normals) >= 6:
        normal, offset, members = _largest(blocks)
        if members.sum() < 6:
            break
        area = float(np.sum((side * blocks.centers_mm[members, 2]) ** 2) / np.prod(camera.focal_px))
        found.append(CandidatePlane(normal, offset, area))
        blocks = _kept(blocks, ~members)
    return found


def _largest(blocks: BlockPlanes) -> tuple[NDArray[np.float64], float, NDArray[np.bool_]]:
    """The plane most blocks lie on: normal, offset mm, and which blocks."""
    normals, centers = blocks.normals, blocks.centers_mm
    tries = np.unique(np.linspace(0, len(normals) - 1, 400).astype(int))
    counts = [int(_members(blocks, normals[i], normals[i] @ centers[i]).sum()) for i in tries]
    best = tries[int(np.argmax(counts))]
    normal, offset = normals[best], float(normals[best] @ centers[best])
    members = _members(blocks, normal, offset)
    for _ in range(4):
        if members.sum() < 6:
            break
        middle = centers[members].mean(axis=0)
        local = centers[members] - middle
        normal = np.linalg.eigh(local.T @ local)[1][:, 0]
        normal *= -np.sign(normal @ middle)
        offset = float(normal @ middle)
        members = _members(blocks, normal, offset)
    return normal, offset, members


def _members(blocks: BlockPlanes, normal: NDArray[np.float64], offset_mm: float) -> NDArray[np.bool_]:
    return (np.abs(blocks.centers_mm @ normal - offset_mm) < _NEAR_MM) & (
        blocks.normals @ normal > np.cos(_TURN_RAD)
    )


def _kept(blocks: BlockPlanes, keep: NDArray[np.bool_]) -> BlockPlanes:
    return BlockPlanes(blocks.normals[keep], blocks.centers_mm[keep], blocks.rms_mm[keep])


def _low(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else 0.0
