"""Normalised inverse depth s, whose unit is about a pixel of disparity, and packed projections for the kernels.

s is 1/Z divided by a rig's `inverse_depth_scale`, on the core's undistorted grid. A packed projection is a row of 39
numbers that maps a pixel of that grid with its s into a camera's image; `kernels.projection` defines it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.kernels.projection import pack_lens

ON_AXIS = 0.1
"""Share of a baseline across the core's axis below which its whole length counts."""


def compute_inverse_depth_scale(rig: Rig, auxiliaries: Iterable[str], step: int = 1) -> float:
    """Return the unit of s in 1/mm on the grid of blocks of ``step`` px: about a pixel in the mean auxiliary.

    At full size it is 1 over the product of the core's mean focal length (px) and the mean length (mm) of the
    baselines across the core's optical axis. An auxiliary on that axis counts with its whole baseline.
    """
    lengths = [_measure_across_axis(rig.cam_from_core[name].center_mm) for name in auxiliaries]
    return 1.0 / float(rig.core_camera.focal_px.mean() * np.mean(lengths)) * step


def _measure_across_axis(center_mm: NDArray[np.float64]) -> float:
    whole, across = float(np.linalg.norm(center_mm)), float(np.linalg.norm(center_mm[:2]))
    return across if across > ON_AXIS * whole else whole


def pack_projection(
    rig: Rig, name: str, unit: float, core_step: int = 1, aux_step: int = 1
) -> NDArray[np.float32]:
    """Return the (39,) projection of the core's grid into a camera, for s in units of ``unit`` (1/mm).

    The images may be averaged in blocks of ``core_step`` and ``aux_step`` pixels. For the core's name it is the
    projection of the undistorted grid into the core's own distorted image, which does not depend on s.
    """
    camera, pose = rig.cameras[name], rig.cam_from_core[name]
    focal, center = _scale_to_blocks(camera, aux_step)
    ray = _invert_core_matrix(rig, core_step)
    direction, shift = pose.rotation @ ray, pose.translation_mm * unit
    lens = pack_lens(camera.model, camera.distortion, camera.valid_radius)
    return np.concatenate([direction.ravel(), shift, focal, center, lens]).astype(np.float32)


def pack_projections(rig: Rig, auxiliaries: tuple[str, ...], unit: float, step: int) -> NDArray[np.float32]:
    """Return the (n, 39) projections of the core's grid into the auxiliaries, all averaged in the same blocks."""
    return np.stack([pack_projection(rig, name, unit, step, step) for name in auxiliaries])


def crop_projection(view: NDArray[np.float32], first_u: int, first_v: int) -> NDArray[np.float32]:
    """Return the (39,) projection of the grid whose pixel (0, 0) is (first_u, first_v) of the given one."""
    direction = view[:9].astype(np.float64).reshape(3, 3).copy()
    direction[:, 2] += first_u * direction[:, 0] + first_v * direction[:, 1]
    return np.concatenate([direction.ravel(), view[9:]]).astype(np.float32)


def subsample_projection(view: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    """Return the (39,) projection of the grid of every ``stride``-th row and column, from ``stride // 2`` on."""
    direction = view[:9].astype(np.float64).reshape(3, 3).copy()
    direction[:, 2] += stride // 2 * (direction[:, 0] + direction[:, 1])
    direction[:, :2] *= stride
    return np.concatenate([direction.ravel(), view[9:]]).astype(np.float32)


def _invert_core_matrix(rig: Rig, step: int) -> NDArray[np.float64]:
    """Return the (3, 3) inverse camera matrix of the core for images averaged in blocks."""
    focal, center = _scale_to_blocks(rig.core_camera, step)
    return np.array(
        [[1 / focal[0], 0, -center[0] / focal[0]], [0, 1 / focal[1], -center[1] / focal[1]], [0, 0, 1]]
    )


def _scale_to_blocks(camera: Camera, step: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return focal lengths and centre, px, for images averaged in blocks: u_full = step · u + (step - 1) / 2."""
    return camera.focal_px / step, (camera.center_px - (step - 1) / 2) / step
