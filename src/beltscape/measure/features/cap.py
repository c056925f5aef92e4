"""The window of a depth map around a sphere, and the geometry of the sphere's visible cap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.measure.features.face import compute_rays
from beltscape.measure.features.smoothing import Smoothing

_OFF_MM, _MIN_SHARE = 4.0, 0.3
"""A sphere counts as absent if less than this share of its pixels lies within this distance of the nominal one."""


@dataclass(frozen=True, slots=True, eq=False)
class Cap:
    """A window (h, w) of the depth map around a sphere."""

    window: tuple[slice, slice]
    rays: NDArray[np.float64]
    """(h, w, 3)."""
    depth_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    information: NDArray[np.float64]
    """Information of each pixel about its own depth; 1 without an image."""
    on_sphere: NDArray[np.bool_]
    """Pixels of the sphere's nominal view."""
    valid: NDArray[np.bool_]
    """Those of them that are measured, away from missing ones."""


def crop_cap(
    depth: DepthMap,
    camera: Camera,
    sphere_mask: NDArray[np.bool_],
    center_mm: NDArray[np.float64],
    radius_mm: float,
    smoothing: Smoothing | None,
) -> Cap:
    """Return the window of the depth map around a nominal sphere."""
    window = _project_window(camera, center_mm, radius_mm, 1 if smoothing is None else smoothing.step)
    z, sigma = (values[window].astype(np.float64) for values in (depth.depth_mm, depth.sigma_mm))
    information = np.ones_like(z) if smoothing is None else smoothing.expand_information(window)
    on_sphere = sphere_mask[window].astype(np.float64) > 0
    valid = on_sphere & (np.asarray(ndimage.distance_transform_edt(np.isfinite(z))) > 2)
    return Cap(window, compute_rays(camera, *np.mgrid[window]), z, sigma, information, on_sphere, valid)


def is_present(cap: Cap, nominal: NDArray[np.float64]) -> bool:
    """Decide whether enough pixels of a sphere's nominal view lie near the nominal sphere (centre, radius)."""
    if not cap.on_sphere.any():
        return False
    near = np.abs(cap.depth_mm - compute_sphere_depth_mm(nominal, cap.rays))[cap.on_sphere] < _OFF_MM
    return bool(np.mean(near) >= _MIN_SHARE)


def _project_window(
    camera: Camera, center_mm: NDArray[np.float64], radius_mm: float, step: int
) -> tuple[slice, slice]:
    """Return the rows and columns around a sphere, in whole blocks of ``step`` pixels."""
    reach = 1.3 * radius_mm * float(camera.focal_px.max()) / center_mm[2] + 8
    middle = center_mm[:2] / center_mm[2] * camera.focal_px + camera.center_px
    low, high = np.maximum(middle - reach, 0).astype(int), np.minimum(middle + reach + 1, camera.size_px)
    low, high = low // step * step, np.maximum(high.astype(int), low) // step * step
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def compute_sphere_depth_mm(sphere: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the depth (...) of the near side of a sphere (centre, radius) on rays (..., 3); NaN beside it."""
    center, radius = sphere[:3], sphere[3]
    a, b = np.sum(rays**2, axis=-1), rays @ center
    with np.errstate(invalid="ignore"):
        return (b - np.sqrt(b * b - a * (center @ center - radius**2))) / a


def compute_incidence_deg(
    sphere: NDArray[np.float64], rays: NDArray[np.float64], depth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the angle of incidence (...), degrees; 90 beside the sphere."""
    normal = (rays * depth[..., None] - sphere[:3]) / sphere[3]
    cosine = -np.sum(normal * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
    return np.rad2deg(np.arccos(np.clip(np.nan_to_num(cosine), 0, 1)))
