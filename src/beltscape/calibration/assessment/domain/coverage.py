"""Coverage of the measuring volume: where each camera looks at it, but never saw the board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from beltscape.calibration.assessment.domain.general_lens import compute_general_covariance
from beltscape.calibration.assessment.domain.volume import MeasuringVolume
from beltscape.calibration.assessment.uncertainty.covariance import (
    compute_depth_jacobian,
    differentiate_camera,
)
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH = 0.08
"""Distance from the nearest corner, over the image's diagonal, within which the board reached a pixel: distortion is
smooth over it, and boards on a sound grid of poses leave no larger gap."""
UNCERTAIN_PX, UNUSABLE_PX = 0.1, 0.5
"""σ of a depth, as the shift in an image that it equals, from which it is remarked on, and from which it is unusable:
matching is certain to 0.03 px (`plan`), and finds little along epipolar lines that are off by half a pixel."""
MIN_CONTRAST = 5.0
"""Least ratio of such a σ to its median where the board was: corners with much noise are another fault."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraCoverage:
    """The part of the measuring volume that one camera sees."""

    camera: Camera
    pixels: Array
    """(N, 2) of the volume's points; beyond the lens's domain as extrapolated, NaN where not in the image."""
    is_reached: Mask
    """(N,) pixels that the board reached."""
    is_beyond: Mask
    """(N,) pixels beyond the lens's domain."""
    corners_px: Array
    """(K, 2) of the board, that the calibration used."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Coverage of a measuring volume by the views of the board."""

    volume: MeasuringVolume
    cameras: Mapping[str, CameraCoverage]
    """The core camera first."""
    sigma_mm: Array
    """(N,) σ of a depth if lenses need not follow their models exactly; NaN with fewer than two cameras, and where no
    lens is known."""
    sigma_px: Array
    """(N,) the same as a shift in an image."""
    is_uncertain: Mask
    """(N,) points in the core's image that a camera sees where the board never was, and whose σ is large by that."""
    is_unusable: Mask
    """(N,) those of them that cannot be measured, with those that no two lenses reach."""

    @property
    def is_needed(self) -> Mask:
        """(N,) points in the core's image."""
        return np.isfinite(next(iter(self.cameras.values())).pixels[:, 0])

    def share(self, mask: Mask) -> float:
        """Return the share of points in a mask (N,) among those in the core's image."""
        return float((mask & self.is_needed).sum() / max(int(self.is_needed.sum()), 1))


def assess_coverage(
    adjustment: BundleAdjustmentResult, limited: Rig, inflation: float, volume: MeasuringVolume
) -> Coverage:
    """Return the coverage of a volume; ``limited`` is the adjusted rig with its lenses' domains."""
    general, covariance = compute_general_covariance(adjustment)
    points = volume.points_mm
    cameras = {name: _view(adjustment, limited, name, points) for name in limited.cameras}
    core = cameras[limited.core]
    sigma_mm, unit_mm = _compute_sigma(_limit(general, limited), covariance, points)
    sigma_mm = inflation * sigma_mm
    sigma_px = sigma_mm / unit_mm
    sees = np.stack([np.isfinite(each.pixels[:, 0]) & ~each.is_beyond for each in cameras.values()])
    reached = np.stack([each.is_reached for each in cameras.values()])
    all_reached = (reached | ~sees).all(axis=0)
    usual_px = float(np.nanmedian(np.where(all_reached, sigma_px, np.nan))) if all_reached.any() else 0.0
    contrast_px = MIN_CONTRAST * (usual_px if np.isfinite(usual_px) else 0.0)
    needed = np.isfinite(core.pixels[:, 0])
    has_gap = needed & ~all_reached
    beyond = np.stack([each.is_beyond for each in cameras.values()])
    lost = needed & beyond.any(axis=0) & (~sees[0] | (sees.sum(axis=0) < 2))
    if not volume.is_given:
        lost = np.zeros_like(lost)  # a lens's domain is no gap in an image that need not be used whole
    sigma_mm[lost] = sigma_px[lost] = np.nan
    return Coverage(
        volume, cameras, sigma_mm, sigma_px,
        is_uncertain=lost | (has_gap & (sigma_px > max(UNCERTAIN_PX, contrast_px))),
        is_unusable=lost | (has_gap & (sigma_px > max(UNUSABLE_PX, contrast_px))),
    )  # fmt: skip


def _limit(general: Rig, limited: Rig) -> Rig:
    """Return the rig of general lenses within the domains of the calibrated ones."""
    cameras = {
        name: replace(camera, valid_radius_px=limited.cameras[name].valid_radius_px)
        for name, camera in general.cameras.items()
    }
    return Rig(general.core, cameras, general.cam_from_core)


def _compute_sigma(rig: Rig, covariance: Array, points: Array) -> tuple[Array, Array]:
    """Return σ of depths (N,) and the depth (N,) that one pixel of error in every image makes, mm."""
    jacobian = compute_depth_jacobian(rig, points)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian))
    normal = np.zeros((len(points), 3, 3))
    for name in rig.cameras:
        by_point, _, visible = differentiate_camera(rig, name, points)
        by_point = by_point * visible[:, None, None]
        normal += np.einsum("nri,nrj->nij", by_point, by_point)
    unit, known = np.full(len(points), np.nan), np.isfinite(sigma)
    unit[known] = np.sqrt(np.linalg.inv(normal[known])[:, 2, 2])
    return sigma, unit


def _view(adjustment: BundleAdjustmentResult, limited: Rig, name: str, points: Array) -> CameraCoverage:
    camera, index = limited.cameras[name], list(limited.cameras).index(name)
    observed = adjustment.bundle.observations
    corners = observed.pixels[adjustment.used & (observed.camera == index)]
    pixels, beyond = project_beyond(camera, limited.cam_from_core[name], points)
    within = (pixels >= -0.5) & (pixels <= np.array(camera.size_px) - 0.5)
    inside = within[:, 0] & within[:, 1]
    pixels[~inside] = np.nan
    reached = np.zeros(len(points), bool)
    if len(corners):
        distance, _ = KDTree(corners).query(pixels[inside])
        reached[inside] = np.asarray(distance) <= REACH * float(np.hypot(*camera.size_px))
    return CameraCoverage(camera, pixels, reached, inside & beyond, corners)


def project_beyond(camera: Camera, cam_from_core: Pose, points_mm: Array) -> tuple[Array, Mask]:
    """Return the pixels (N, 2) of points, and which lie beyond the lens's domain; NaN behind the camera.

    Beyond the domain the distance from the principal point grows with the angle off the axis as it does on average
    within: enough to say that a part of the image looks there.
    """
    in_camera = cam_from_core.apply(points_mm)
    pixels = camera.project(in_camera)
    beyond = np.isnan(pixels[:, 0]) & (in_camera[:, 2] > 0)
    if beyond.any():
        ideal = in_camera[beyond, :2] / in_camera[beyond, 2:]
        radius, edge = np.linalg.norm(ideal, axis=1), camera.valid_radius * (1 - 1e-9)
        at_edge = camera.distort(ideal * (edge / radius)[:, None]) * camera.focal_px
        pixels[beyond] = camera.center_px + at_edge * (np.arctan(radius) / np.arctan(edge))[:, None]
    return pixels, beyond
