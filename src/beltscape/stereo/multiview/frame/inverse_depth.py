"""Nearness s: inverse depth in steps of about a pixel, and the rows by which kernels project it.

s is 1/Z over a rig's `inverse_depth_scale`, on the core's undistorted grid; native/view.hpp has the projection.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.rig import Rig

ON_AXIS = 0.1
"""Share of a baseline across the core's axis below which its whole length counts."""


def inverse_depth_scale(rig: Rig, auxiliaries: Iterable[str]) -> float:
    """1/mm per step of s: a step moves a point before the core by about a pixel in the mean auxiliary.

    1 over the core's mean focal length (px) and the mean length (mm) of the baselines across the core's optical
    axis. An auxiliary on that axis counts with its whole baseline.
    """
    lengths = [_across(rig.cam_from_core[name].center_mm) for name in auxiliaries]
    return 1.0 / float(rig.core_camera.focal_px.mean() * np.mean(lengths))


def _across(center_mm: NDArray[np.float64]) -> float:
    whole, across = float(np.linalg.norm(center_mm)), float(np.linalg.norm(center_mm[:2]))
    return across if across > ON_AXIS * whole else whole


def packed_projection(
    rig: Rig, name: str, unit: float, core_step: int = 1, aux_step: int = 1
) -> NDArray[np.float32]:
    """(21,) float32: how a camera sees the core's pixels by their nearness in steps of ``unit`` (1/mm).

    ``core_step`` and ``aux_step`` are for images averaged in blocks of so many pixels. The core itself sees its
    undistorted grid in its own image, whatever the nearness.
    """
    camera, pose = rig.cameras[name], rig.cam_from_core[name]
    focal, center = _in_blocks(camera, aux_step)
    ray = _core_rays(rig, core_step)
    direction, shift = pose.rotation @ ray, pose.translation_mm * unit
    return np.concatenate([direction.ravel(), shift, focal, center, camera.distortion]).astype(np.float32)


def displaced_projection(rig: Rig, shift: NDArray[np.float64], step: int) -> NDArray[np.float32]:
    """(21,) float32: the core's own pinhole, in blocks of ``step``, that sees everything displaced by ``shift``.

    ``shift`` (3,) is in mm times the grid's unit.
    """
    focal, center = _in_blocks(rig.core_camera, step)
    ray = _core_rays(rig, step)
    return np.concatenate([ray.ravel(), shift, focal, center, np.zeros(5)]).astype(np.float32)


def _core_rays(rig: Rig, step: int) -> NDArray[np.float64]:
    """(3, 3) inverse matrix of the core's pinhole, of images averaged in blocks."""
    focal, center = _in_blocks(rig.core_camera, step)
    return np.array(
        [[1 / focal[0], 0, -center[0] / focal[0]], [0, 1 / focal[1], -center[1] / focal[1]], [0, 0, 1]]
    )


def _in_blocks(camera: Camera, step: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Focal lengths and centre, px, of images averaged in blocks: u_full = step · u + (step - 1) / 2."""
    return camera.focal_px / step, (camera.center_px - (step - 1) / 2) / step
