"""A real stereo pair with point correspondences, and the errors of a depth map against them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.depth_scores import compute_robust_sigma

GROSS_PX = 1.0
"""A larger difference is a false match, not noise, which is hundredths of a pixel."""
_STEP = 1e-4
"""Relative step of depth for differences: the projection is nearly linear over it."""
_ITERATIONS = 8
"""Gauss-Newton steps; the problem is nearly linear, so that three reach rounding."""
_MEASURED_SHARE = 0.5
"""Least measured share of a subset for its median depth."""


@dataclass(frozen=True, slots=True, eq=False)
class CorrespondenceError:
    """Differences of a depth map from the correspondences, in px of the auxiliary image."""

    along_px: NDArray[np.float64]
    """(N,) depth map minus reference along the epipolar line, positive = nearer; NaN: no depth."""

    @property
    def points(self) -> int:
        """Number of correspondences."""
        return len(self.along_px)

    @property
    def measured(self) -> float:
        """Share of them with a depth."""
        return float(np.isfinite(self.along_px).mean())

    @property
    def median_px(self) -> float:
        """Median of the differences (bias)."""
        return float(np.median(self._finite))

    @property
    def robust_sigma_px(self) -> float:
        """1.4826·MAD of the differences."""
        return compute_robust_sigma(self._finite)

    @property
    def p95_px(self) -> float:
        """95th percentile of the absolute differences."""
        return float(np.percentile(np.abs(self._finite), 95))

    @property
    def gross(self) -> float:
        """Share of the measured ones with more than 1 px."""
        return float((np.abs(self._finite) > GROSS_PX).mean())

    @property
    def _finite(self) -> NDArray[np.float64]:
        return self.along_px[np.isfinite(self.along_px)]


@dataclass(frozen=True, slots=True, eq=False)
class SpecklePair:
    """A rig of two cameras, their images, and corresponding points of subsets in both."""

    name: str
    rig: Rig
    frame_set: FrameSet
    depth_range_mm: tuple[float, float]
    """(near, far) depth range of the scene along the core's optical axis."""
    core_px: NDArray[np.float64]
    """(N, 2) px in the distorted core image."""
    aux_px: NDArray[np.float64]
    """(N, 2) px in the distorted auxiliary image."""

    def compare(self, depth: DepthMap, *, subset_px: int = 1) -> CorrespondenceError:
        """Return the differences of the depth map from the reference along the epipolar line.

        Parameters
        ----------
        depth
            On the core's undistorted grid.
        subset_px
            Edge of the square whose median depth is used, odd: 1 tests the noise, the reference's own subset the
            bias.
        """
        rays = self.rig.core_camera.undistort(self.core_px)
        depth_mm = _depth_at(self.rig, depth, rays, subset_px)
        direction = _epipolar_direction(self.rig, rays, self.reference_depth_mm())
        return CorrespondenceError(
            ((_project_rays(self.rig, rays, depth_mm) - self.aux_px) * direction).sum(axis=1)
        )

    def reference_depth_mm(self) -> NDArray[np.float64]:
        """Return the depth (N,) at which the core's ray passes closest to the reference in the auxiliary image."""
        return triangulate_depth_mm(self.rig, self.core_px, self.aux_px, float(np.mean(self.depth_range_mm)))

    def epipolar_px(self) -> NDArray[np.float64]:
        """Return the signed distance (N,) of the reference from its epipolar line, the calibration's error."""
        rays = self.rig.core_camera.undistort(self.core_px)
        depth_mm = self.reference_depth_mm()
        direction = _epipolar_direction(self.rig, rays, depth_mm)
        off = self.aux_px - _project_rays(self.rig, rays, depth_mm)
        return direction[:, 0] * off[:, 1] - direction[:, 1] * off[:, 0]


def triangulate_depth_mm(
    rig: Rig, core_px: NDArray[np.float64], aux_px: NDArray[np.float64], start_mm: float
) -> NDArray[np.float64]:
    """Return the depth (N,) of core pixels (N, 2) that projects closest to auxiliary pixels (N, 2), both distorted.

    Gauss-Newton in inverse depth, in which the auxiliary's pixel moves almost linearly.
    """
    rays = rig.core_camera.undistort(core_px)
    inverse = np.full(len(rays), 1 / start_mm)
    step = _STEP / start_mm
    for _ in range(_ITERATIONS):
        at = _project_rays(rig, rays, 1 / inverse)
        slope = (_project_rays(rig, rays, 1 / (inverse + step)) - at) / step
        inverse = inverse + ((aux_px - at) * slope).sum(axis=1) / (slope * slope).sum(axis=1)
    return 1 / inverse


def _project_rays(rig: Rig, rays: NDArray[np.float64], depth_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distorted auxiliary pixels (N, 2) of core rays (N, 2) x/z, y/z at depths (N,)."""
    name = rig.auxiliaries[0]
    points = np.column_stack([rays, np.ones(len(rays))]) * depth_mm[:, None]
    return rig.cameras[name].project(rig.cam_from_core[name].apply(points))


def _epipolar_direction(
    rig: Rig, rays: NDArray[np.float64], depth_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return unit vectors (N, 2) along the epipolar lines in the distorted auxiliary image, towards the near end."""
    moved = _project_rays(rig, rays, depth_mm * (1 - _STEP)) - _project_rays(rig, rays, depth_mm)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


def _depth_at(rig: Rig, depth: DepthMap, rays: NDArray[np.float64], subset_px: int) -> NDArray[np.float64]:
    """Return bilinear depth (N,) at core rays (N, 2), the median over a subset; NaN if under half is measured."""
    camera = rig.core_camera
    center = rays * camera.focal_px + camera.center_px
    offsets = np.arange(subset_px) - subset_px // 2
    rows, cols = center[:, 1, None, None] + offsets[:, None], center[:, 0, None, None] + offsets
    places = np.stack(np.broadcast_arrays(rows, cols))
    # one map for all: a neighbour that is not measured makes the sample NaN
    found = ndimage.map_coordinates(depth.depth_mm.astype(np.float64), places, order=1, cval=np.nan)
    found = np.asarray(found).reshape(len(rays), -1)
    enough = np.isfinite(found).mean(axis=1) >= _MEASURED_SHARE
    result = np.full(len(rays), np.nan)
    result[enough] = np.nanmedian(found[enough], axis=1)
    return result
