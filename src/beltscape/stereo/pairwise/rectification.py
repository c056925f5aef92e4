"""Multi-epipolar rectification of the core camera and any auxiliary to common rows (the paper's 2.3.1, Eq. 21).

It is Bouguet's alignment with the core as reference: the new x axis is the baseline from the core to the auxiliary,
and the new optical axis is the core's, made orthogonal to the baseline. So the core is always the left image,
disparity is positive for any direction of the baseline, and the core's image is rotated with little perspective.

Both images of a rectified pair are interpolated once. Local contrast is equalised before matching, since the
brightness of two cameras differs.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet, Image, to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

_STEP = 16
"""The number of disparities of OpenCV's SGBM is a multiple of 16."""
_BORDER_SAMPLES = 33
"""Points along each border of an image by which its rectified extent is found."""
_STRIP_ROWS = 32
"""Rows of the maps computed at a time; a strip stays in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedPair:
    """A core and an auxiliary view whose corresponding points lie on the same row."""

    core: str
    auxiliary: str
    rectified_from_core: Pose
    """Core frame → rectified frame at the core's centre: a rotation only."""
    rectified_from_aux: Pose
    """Auxiliary frame → parallel frame at the auxiliary's centre: a rotation only."""
    focal_px: float
    """Focal length of both rectified views, in u and v."""
    core_center_px: tuple[float, float]
    """(cu, cv) of the rectified core view."""
    aux_center_px: tuple[float, float]
    """(cu, cv) of the rectified auxiliary view: shifted in u so that disparity starts near 0."""
    size_px: tuple[int, int]
    """(width, height) of both rectified views."""
    baseline_mm: float
    disparities: int
    """Number of disparities, from 0 on, that cover the depth range; a multiple of 16."""
    core_map: NDArray[np.float32]
    """(H, W, 2) float32: pixel of the distorted core image for each rectified core pixel."""
    aux_map: NDArray[np.float32]
    """(H, W, 2) float32: pixel of the distorted auxiliary image for each rectified auxiliary pixel."""

    @property
    def offset_px(self) -> float:
        """Difference by which the shift of the auxiliary's centre reduces the disparity."""
        return self.aux_center_px[0] - self.core_center_px[0]

    def disparity_from_depth(self, depth_mm: NDArray[np.floating] | float) -> NDArray[np.float64]:
        """Return the disparity u_core − u_aux, px, of a depth along the rectified axis, mm (Eqs. 22-23)."""
        return self.focal_px * self.baseline_mm / np.asarray(depth_mm, np.float64) - self.offset_px

    def depth_from_disparity(self, disparity_px: NDArray[np.floating] | float) -> NDArray[np.float64]:
        """Return the depth along the rectified axis, mm, of a disparity, px (Eq. 23)."""
        return self.focal_px * self.baseline_mm / (np.asarray(disparity_px, np.float64) + self.offset_px)

    def project_core_rays(self, rays: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rectified pixels (..., 2) of core rays x/z, y/z (..., 2), and rectified over core depth (...)."""
        homogeneous = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
        rotated = homogeneous @ self.rectified_from_core.rotation.T
        return rotated[..., :2] / rotated[..., 2:] * self.focal_px + self.core_center_px, rotated[..., 2]


def rectify_pair(
    rig: Rig, auxiliary: str, depth_range_mm: tuple[float, float], *, oversampling: float = 1.0
) -> RectifiedPair:
    """Rectify the core and one auxiliary for surfaces within a depth range.

    Parameters
    ----------
    rig
        The calibrated rig.
    auxiliary
        Name of the auxiliary camera.
    depth_range_mm
        (near, far) along the core's optical axis.
    oversampling
        Focal length of the rectified views over the core's.

    Raises
    ------
    ReconstructionError
        When the range is empty or the two cameras have no common field of view in it.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, section 2.3.1, Eq. 21.
    """
    near_mm, far_mm = depth_range_mm
    if not 0 < near_mm < far_mm < np.inf:
        raise ReconstructionError(f"depth range {near_mm:g} … {far_mm:g} mm is empty; give 0 < near < far")
    core, aux = rig.core_camera, rig.cameras[auxiliary]
    to_core, to_aux, baseline_mm = _align_to_baseline(rig, auxiliary)
    focal_px = oversampling * float(np.mean(core.focal_px))
    box, low_mm, high_mm = _find_common_view(rig, auxiliary, to_core, focal_px, depth_range_mm)
    offset_px = focal_px * baseline_mm / high_mm - 1.0
    span_px = focal_px * baseline_mm / low_mm + 1.0 - offset_px
    disparities = _STEP * int(np.ceil(span_px / _STEP))
    # the view starts after the first `disparities` columns, which SGBM leaves empty
    core_center = (disparities - box[0], -box[1])
    aux_center = (core_center[0] + offset_px, core_center[1])
    size = (disparities + int(np.ceil(box[2] - box[0])) + 1, int(np.ceil(box[3] - box[1])) + 1)
    return RectifiedPair(
        core=rig.core,
        auxiliary=auxiliary,
        rectified_from_core=to_core,
        rectified_from_aux=to_aux,
        focal_px=focal_px,
        core_center_px=core_center,
        aux_center_px=aux_center,
        size_px=size,
        baseline_mm=baseline_mm,
        disparities=disparities,
        core_map=_make_source_map(core, to_core, focal_px, core_center, size),
        aux_map=_make_source_map(aux, to_aux, focal_px, aux_center, size),
    )


def count_upright_turns(pair: RectifiedPair) -> int:
    """Return the number of quarter turns, 0 to 3, by which `numpy.rot90` turns the pair's images upright.

    The images of a pair with a vertical baseline lie on their side.
    """
    right, down = pair.rectified_from_core.rotation[:2, 0]
    # the core's +u axis points right in the upright image
    return int(np.round(float(np.arctan2(down, right)) / (np.pi / 2))) % 4


def _align_to_baseline(rig: Rig, auxiliary: str) -> tuple[Pose, Pose, float]:
    """Return rectified_from_core, rectified_from_aux (rotations) and the baseline, mm."""
    pose = rig.cam_from_core[auxiliary]
    baseline = pose.center_mm
    length = float(np.linalg.norm(baseline))
    if length == 0:
        raise ReconstructionError(f"cameras {rig.core} and {auxiliary} stand on one spot; no depth from them")
    x = baseline / length
    z = np.array([0.0, 0.0, 1.0]) - x[2] * x
    if np.linalg.norm(z) < 0.1:
        raise ReconstructionError(
            f"camera {auxiliary} stands on the optical axis of {rig.core}; this pair cannot be rectified"
        )
    z /= np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z])
    return Pose.of(rotation, np.zeros(3)), Pose.of(rotation @ pose.rotation.T, np.zeros(3)), length


def _find_common_view(
    rig: Rig, auxiliary: str, to_core: Pose, focal_px: float, depth_range_mm: tuple[float, float]
) -> tuple[tuple[float, float, float, float], float, float]:
    """Return the box (u0, v0, u1, v1) about the principal point that both cameras see, and its depth range, mm."""
    core_rays = _border_rays(rig.core_camera, distorted=False) @ to_core.rotation.T
    if core_rays[:, 2].min() < 0.05:
        raise ReconstructionError(f"camera {auxiliary} stands nearly in the view of {rig.core}; leave it out")
    core_from_aux = rig.cam_from_core[auxiliary].inverse()
    aux_rays = core_from_aux.rotation @ _border_rays(rig.cameras[auxiliary], distorted=True).T
    seen: list[NDArray[np.float64]] = []
    for depth in depth_range_mm:
        scale = (depth - core_from_aux.translation_mm[2]) / aux_rays[2]
        points = core_from_aux.translation_mm + (aux_rays * np.where(scale > 0, scale, np.nan)).T
        seen.append(points @ to_core.rotation.T)
    aux_pixels = np.concatenate([focal_px * p[:, :2] / p[:, 2:] for p in seen])
    core_pixels = focal_px * core_rays[:, :2] / core_rays[:, 2:]
    low, high = core_pixels.min(axis=0), core_pixels.max(axis=0)
    if np.isfinite(
        aux_pixels
    ).all():  # otherwise some of its rays miss the plane, and the core's whole view is used
        low, high = np.maximum(low, aux_pixels.min(axis=0)), np.minimum(high, aux_pixels.max(axis=0))
    if not (high - low > 16).all():
        raise ReconstructionError(
            f"cameras {rig.core} and {auxiliary} share no view between {depth_range_mm[0]:.0f} and "
            f"{depth_range_mm[1]:.0f} mm; check the rig or the depth range"
        )
    reach = core_rays[:, 2]
    near_mm, far_mm = depth_range_mm[0] * float(reach.min()), depth_range_mm[1] * float(reach.max())
    return (float(low[0]), float(low[1]), float(high[0]), float(high[1])), near_mm, far_mm


def _border_rays(camera: Camera, *, distorted: bool) -> NDArray[np.float64]:
    """Return (N, 3) rays with z = 1 along the border of the image, or of the undistorted pinhole grid."""
    width, height = camera.size_px
    u, v = np.linspace(0, width - 1, _BORDER_SAMPLES), np.linspace(0, height - 1, _BORDER_SAMPLES)
    border = np.concatenate(
        [
            np.stack([u, np.zeros_like(u)], axis=-1),
            np.stack([u, np.full_like(u, height - 1)], axis=-1),
            np.stack([np.zeros_like(v), v], axis=-1),
            np.stack([np.full_like(v, width - 1), v], axis=-1),
        ]
    )
    ideal = camera.undistort(border) if distorted else (border - camera.center_px) / camera.focal_px
    return np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)


OUTSIDE_PX = -1e4
"""Coordinate of what no pixel of the image shows: OpenCV's remap has no other mark."""


def _make_source_map(
    camera: Camera,
    rectified_from_cam: Pose,
    focal_px: float,
    center_px: tuple[float, float],
    size_px: tuple[int, int],
) -> NDArray[np.float32]:
    """Return the (H, W, 2) float32 distorted pixel of each rectified pixel, for a single interpolation."""
    border = np.abs(_border_rays(camera, distorted=True)[:, :2])
    # a lens that is valid in a part of its image only has no border; its domain limits it by itself
    limit = 1.15 * border.max(axis=0) if np.isfinite(border).all() else np.full(2, np.inf)
    x = (np.arange(size_px[0]) - center_px[0]) / focal_px
    source = np.empty((size_px[1], size_px[0], 2), np.float32)
    for top in range(0, size_px[1], _STRIP_ROWS):  # strips stay in the cache
        y = (np.arange(top, min(top + _STRIP_ROWS, size_px[1])) - center_px[1]) / focal_px
        u, v = np.meshgrid(x, y)
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ rectified_from_cam.rotation
        depth = np.ascontiguousarray(rays[..., 2])
        behind = depth < 0.05
        depth[behind] = 1.0
        ideal_x, ideal_y = rays[..., 0] / depth, rays[..., 1] / depth
        distorted = camera.distort_axes(ideal_x, ideal_y)
        outside = behind | (np.abs(ideal_x) > limit[0]) | (np.abs(ideal_y) > limit[1])
        outside |= np.isnan(distorted[0]) | np.isnan(distorted[1])
        for axis, values in enumerate(distorted):
            pixels = values * camera.focal_px[axis] + camera.center_px[axis]
            pixels[outside] = OUTSIDE_PX
            source[top : top + len(y), :, axis] = pixels
    return source


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedImages:
    """A rectified pair of one frame."""

    pair: RectifiedPair
    core: Image
    auxiliary: Image


def rectify_images(frame_set: FrameSet, pair: RectifiedPair) -> RectifiedImages:
    """Return both images of a pair on their common rows, interpolated once from the distorted images."""
    core = cv2.remap(frame_set.images[pair.core], pair.core_map, None, cv2.INTER_CUBIC)
    auxiliary = cv2.remap(frame_set.images[pair.auxiliary], pair.aux_map, None, cv2.INTER_CUBIC)
    return RectifiedImages(pair, core, auxiliary)


_FLOOR = 0.2
"""Contrast of the square root of 8-bit counts that noise causes: shot and read noise of a few counts."""
_GAIN = 25.0
"""Counts per unit of contrast, so that SGBM's gradient cap hardly clips."""


def take_square_root(image: Image) -> NDArray[np.float32]:
    """Return the (H, W) float32 square root of the luminance in 8-bit counts, whose noise is uniform."""
    counts = to_grey(image) * np.float32(255.0 / np.iinfo(image.dtype).max)
    return np.sqrt(counts + np.float32(1.0))


def equalise_contrast(root: NDArray[np.float32], radius_px: float) -> NDArray[np.uint8]:
    """Return (H, W) uint8 levels of local mean 128 and equal local contrast over a Gaussian neighbourhood."""
    mean = cv2.GaussianBlur(root, (0, 0), radius_px)
    variance = cv2.GaussianBlur(root * root, (0, 0), radius_px) - mean * mean
    scale = _GAIN / (np.sqrt(np.maximum(variance, 0)) + _FLOOR)
    return np.clip(128.5 + scale * (root - mean), 0, 255).astype(np.uint8)


def quantise_root(image: Image) -> NDArray[np.uint8]:
    """Return the (H, W) uint8 square root of the counts, stretched to the full range."""
    root = take_square_root(image)
    return np.rint(np.clip(root * (255 / max(float(root.max()), 1e-6)), 0, 255)).astype(np.uint8)
