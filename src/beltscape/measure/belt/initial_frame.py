"""The initial estimate of the belt's frame: from the normals of small blocks, or from the plane of a flat belt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.measure.belt.blocks import BlockPlanes
from beltscape.measure.belt.flat_edges import EdgeYaw, fit_edge_yaw

_WING_ANGLE_RAD = np.deg2rad(4.0)
"""Normals inclined more than this to the median belong to a wing."""
_MIN_WING_SHARE = 0.04
"""With more of the blocks than this on wings, the belt is troughed."""


@dataclass(frozen=True, slots=True, eq=False)
class InitialFrame:
    """A frame within a few degrees of the belt's."""

    rotation: NDArray[np.float64]
    """(3, 3) start_from_camera; rows are x across, y along, z up."""
    troughed: bool
    """Whether the surface bends across, so that its shape determines its direction."""
    edges: EdgeYaw | None
    """Direction of a flat belt's edges; None for a troughed belt, or where no edge is visible."""


def find_initial_frame(
    depth: DepthMap, camera: Camera, blocks: BlockPlanes, points_mm: NDArray[np.float64]
) -> InitialFrame:
    """Estimate the frame from the belt's blocks of the depth map; ``points_mm`` (N, 3) sample these in its frame."""
    planes = _select_planar_blocks(blocks)
    along = _fit_belt_direction(planes.normals)
    rotation = build_frame(along, np.array([0.0, 0.0, -1.0]))
    angle = np.arctan2(planes.normals @ rotation[0], planes.normals @ rotation[2])
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(planes.normals @ along)))
    on_wing = np.abs(angle - np.median(angle)) > max(_WING_ANGLE_RAD, 4 * scatter)
    if on_wing.mean() > _MIN_WING_SHARE:
        return InitialFrame(rotation, True, None)
    return _find_flat_frame(depth, camera, points_mm, planes)


def build_frame(along: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows x, y, z (3, 3): y on the line ``along``, z nearest to ``up``, x towards the core image's +u."""
    along = along / np.linalg.norm(along)
    up = up - (up @ along) * along
    up = up / np.linalg.norm(up)
    across = np.cross(along, up)
    # a belt that runs along u does not determine the sign: then x points towards +v
    facing = across[0] if abs(across[0]) > 1e-3 else across[1]
    return np.stack([across, along, up]) * np.where([[True], [True], [False]], np.sign(facing), 1.0)


def _select_planar_blocks(planes: BlockPlanes) -> BlockPlanes:
    """Return the planes of the blocks that hold one surface."""
    if len(planes.rms_mm) < 30:
        raise MeasureError("empty belt: too few measured patches; project speckle or give a better frame")
    # exact data have no scatter: then the resolution of a float32 depth decides
    good = planes.rms_mm <= 3 * np.median(planes.rms_mm) + 1e-5 * np.median(planes.centers_mm[:, 2])
    return planes.select(good)


def _fit_belt_direction(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the direction (3,) that most normals are perpendicular to, by Cauchy weights."""
    weight = np.ones(len(normals))
    along = np.zeros(3)
    for _ in range(20):
        along = np.linalg.eigh((normals * weight[:, None]).T @ normals)[1][:, 0]
        deviation = np.abs(normals @ along)
        weight = 1 / (1 + (deviation / (2 * np.median(deviation) + 1e-6)) ** 2)
    return along


def _find_flat_frame(
    depth: DepthMap, camera: Camera, points_mm: NDArray[np.float64], planes: BlockPlanes
) -> InitialFrame:
    """Estimate the frame of a flat belt from its plane and its edges."""
    off_axis = np.linalg.norm(planes.centers_mm[:, :2], axis=1) / planes.centers_mm[:, 2]
    nearest = np.argsort(off_axis)[: max(5, len(off_axis) // 50)]
    normal = np.median(planes.normals, axis=0)
    normal /= np.linalg.norm(normal)
    offset = float(np.median(planes.centers_mm[nearest] @ normal))
    noise = 0.01 * abs(offset)  # wide enough for the first normal's error, too narrow for the floor
    for _ in range(12):
        off = points_mm @ normal - offset
        near = points_mm[np.abs(off) < 4 * noise]
        if len(near) < 0.02 * len(points_mm):
            raise MeasureError(
                "empty belt: no even surface under the optical axis; give an empty belt's frame"
            )
        middle = near.mean(axis=0)
        normal = np.linalg.eigh((near - middle).T @ (near - middle))[1][:, 0]
        normal *= -np.sign(normal[2])
        offset = float(middle @ normal)
        noise = max(MAD_TO_SIGMA * float(np.median(np.abs((near - middle) @ normal))), 1e-4)
    x_axis = np.array([1.0, 0.0, 0.0])
    rotation = build_frame(np.cross(normal, x_axis), normal)
    pixels = depth.points_mm(camera) @ rotation.T
    edges = fit_edge_yaw(pixels[..., :2], pixels[..., 2] - offset, 6 * noise)
    if edges is not None:
        across = np.cos(edges.angle_rad) * rotation[0] + np.sin(edges.angle_rad) * rotation[1]
        rotation = build_frame(cast("NDArray[np.float64]", np.cross(normal, across)), normal)
    return InitialFrame(rotation, False, edges)
