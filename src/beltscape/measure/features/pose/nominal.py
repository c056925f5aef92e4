"""The nominal module rendered in the core camera's view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.measure.features.pose.solids import Solid, build_solids
from beltscape.target.module import Module

NO_PART = -1
"""Label of a pixel that shows no part of the module."""


@dataclass(frozen=True, slots=True, eq=False)
class NominalView:
    """The nearest part of the nominal module at each pixel of the core's undistorted grid."""

    label: NDArray[np.int16]
    """(H, W) 0 the base, i + 1 the i-th feature, NO_PART beside the module."""
    top: NDArray[np.bool_]
    """(H, W) whether the part is an upper face (a whole sphere counts as one)."""
    depth_mm: NDArray[np.float64]
    """(H, W) along the optical axis; NaN beside the module."""

    def face(self, label: int) -> NDArray[np.bool_]:
        """Return the pixels (H, W) of the upper face of one part."""
        return (self.label == label) & self.top


def render_nominal_view(module: Module, core_from_module: Pose, camera: Camera) -> NominalView:
    """Render the module by casting a ray through every pixel that can show it."""
    width, height = camera.size_px
    label = np.full((height, width), NO_PART, np.int16)
    top = np.zeros((height, width), bool)
    depth = np.full((height, width), np.inf)
    module_from_core = core_from_module.inverse()
    for index, solid in enumerate(build_solids(module)):
        window = _project_window(solid, core_from_module, camera)
        if window is None:
            continue
        rays = _compute_rays(camera, window) @ module_from_core.rotation.T
        z, upper = solid.intersect(module_from_core.translation_mm, rays.reshape(-1, 3))
        z, upper = z.reshape(rays.shape[:2]), upper.reshape(rays.shape[:2])
        nearer = (z < depth[window]) & (z > 0)
        depth[window] = np.where(nearer, z, depth[window])
        label[window] = np.where(nearer, index, label[window])
        top[window] = np.where(nearer, upper, top[window])
    depth[label == NO_PART] = np.nan
    return NominalView(label, top, depth)


def _project_window(solid: Solid, core_from_module: Pose, camera: Camera) -> tuple[slice, slice] | None:
    """Return the rows and columns that can show a solid; None if there are none."""
    corners = core_from_module.apply(solid.corners())
    if (corners[:, 2] <= 0).any():
        return None
    pixels = corners[:, :2] / corners[:, 2:] * camera.focal_px + camera.center_px
    low, high = np.floor(pixels.min(axis=0)).astype(int), np.ceil(pixels.max(axis=0)).astype(int) + 1
    low, high = np.maximum(low, 0), np.minimum(high, camera.size_px)
    return None if (low >= high).any() else (slice(low[1], high[1]), slice(low[0], high[0]))


def _compute_rays(camera: Camera, window: tuple[slice, slice]) -> NDArray[np.float64]:
    """Return the rays (h, w, 3) x/z, y/z, 1 of the pixels in a window."""
    v, u = np.mgrid[window]
    x, y = (u - camera.center_px[0]) / camera.focal_px[0], (v - camera.center_px[1]) / camera.focal_px[1]
    return np.stack([x, y, np.ones_like(x)], axis=-1)
