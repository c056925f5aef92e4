"""Nearness s: inverse depth in steps of about a pixel, and the rows by which kernels project it.

s is 1/Z over a rig's `nearness_unit`, on the core's undistorted grid; native/view.hpp has the projection.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.rig import Rig

ON_AXIS = 0.1
"""Share of a baseline across the core's axis below which its whole length counts."""


def nearness_unit(rig: Rig, auxiliaries: Iterable[str]) -> float:
    """1/mm per step of s: a step moves a point before the core by about a pixel in the mean auxiliary.

    1 over the core's mean focal length (px) and the mean length (mm) of the baselines across the core's optical
    axis. An auxiliary on that axis counts with its whole baseline.
    """
    lengths = [_across(rig.cam_from_core[name].center_mm) for name in auxiliaries]
    return 1.0 / float(rig.core_camera.focal_px.mean() * np.mean(lengths))


def _across(center_mm: NDArray[np.float64]) -> float:
    whole, across = float(np.linalg.norm(center_mm)), float(np.linalg.norm(center_mm[:2]))
    return across if across > ON_AXIS * whole else whole


def view_row(rig: Rig, name: str, unit: float, core_step: int = 1, aux_step: int = 1) -> NDArray[np.float32]:
    """(21,) float32: how a camera sees the core's pixels by their nearness in steps of ``unit`` (1/mm).

    ``core_step`` and ``aux_step`` are for images averaged in blocks of so many pixels. The core itself sees its
    undistorted grid in its own image, whatever the nearness.
    """
    camera, pose = rig.cameras[name], rig.cam_from_core[name]
    core_focal, core_center = _in_blocks(rig.core_camera, core_step)
    focal, center = _in_blocks(camera, aux_step)
    ray = np.array(
        [
            [1 / core_focal[0], 0, -core_center[0] / core_focal[0]],
            [0, 1 / core_focal[1], -core_center[1] / core_focal[1]],
            [0, 0, 1],
        ]
    )
    direction, shift = pose.rotation @ ray, pose.translation_mm * unit
    return np.concatenate([direction.ravel(), shift, focal, center, camera.distortion]).astype(np.float32)


def _in_blocks(camera: Camera, step: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Focal lengths and centre, px, of images averaged in blocks: u_full = step · u + (step - 1) / 2."""
    return camera.focal_px / step, (camera.center_px - (step - 1) / 2) / step
