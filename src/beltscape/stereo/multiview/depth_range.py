"""The plane sweep over small images, and the depth range that it finds for a frame where the user gives none.

The sweep takes planes with semi-global aggregation and gives the first inverse depths. The range follows from the
rig's geometry and from coarse matching: the pixels whose plane is reliable in a sweep.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.core.statistics import compute_median
from beltscape.kernels import load_on_processor
from beltscape.stereo.cameras import list_usable_auxiliaries
from beltscape.stereo.multiview.frame import MatchContext, PreparedFrame, downsample
from beltscape.stereo.multiview.optimisation import form_normal_equations
from beltscape.stereo.multiview.preparation import prepare_frame
from beltscape.stereo.multiview.surface import pack_projections

_SMALL_JUMP, _LARGE_JUMP = 7, 40
"""Penalties of the aggregation for a jump by one plane and by more."""
_LEAST_PLANES = 4
"""The least that the kernel of the aggregation accepts."""


def shrink_frame(prepared: PreparedFrame, shrink: int) -> PreparedFrame:
    """Return the frame with all images ``shrink`` times smaller, for a sweep.

    Inverse depth s still counts pixels of the large grid; the spline coefficients remain those of the large images.
    """
    context = prepared.context
    return replace(
        prepared,
        core=downsample(prepared.filled_core, shrink),
        images=tuple(downsample(image, shrink) for image in prepared.images),
        views=pack_projections(
            context.rig, context.auxiliaries, context.inverse_depth_scale, context.step * shrink
        ),
    )


def sweep_planes(
    prepared: PreparedFrame, s_range: tuple[float, float], plane_step: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (H, W) inverse depth s of the plane of least cost, and (H, W) its margin over the second best.

    Planes lie ``plane_step`` apart within ``s_range`` = (far, near), from the farthest on. The cost is that of the
    two auxiliaries that match the core best on windows of 3 × 3 pixels; two, because opposite auxiliaries are
    rarely occluded together.
    """
    far, near = s_range
    context = prepared.context
    planes = max(_LEAST_PLANES, int(np.ceil((near - far) / plane_step)) + 1)
    index, margin = context.kernels.sweep_and_aggregate(
        prepared.core, prepared.images, prepared.views, far, plane_step, planes, prepared.noise.floor,
        _SMALL_JUMP, _LARGE_JUMP, best=2, threads=context.threads,
    )  # fmt: skip
    return (far + plane_step * index).astype(np.float32), margin


_LEAST_MARGIN = 0.1
"""Margin of the aggregated dissimilarity from which on a plane is reliable."""
_WINDOW_PX = 3
"""Radius of the window in which a match is examined, px of the small images."""
_MISFIT_VARIANCE = 0.2
"""Model variance of normalised levels for a surface that lies between two planes."""
_PATCH_PX, _PATCH_STEP = 60, 3
"""Smallest patch, in pixels, that is kept, and the difference in planes at which a patch ends."""
_ENDS = (0.0005, 0.9995)
"""Quantiles of the matched s that bound the range: the rest are stray matches."""
_MARGIN = (0.06, 0.03)
"""Margin in front of and behind the matches, as a share of the depth, for small tall objects that are missed."""
_ENOUGH_PX = 200
"""Number of matches below which they give no range."""


def find_reliable_matches(
    prepared: PreparedFrame, s_range: tuple[float, float], plane_step: float
) -> NDArray[np.float32]:
    """Return (N,) inverse depth s of the pixels that match reliably among planes ``plane_step`` apart.

    Their plane is best by a margin, an auxiliary agrees with it in least squares too, and they form patches.
    """
    s, margin = sweep_planes(prepared, s_range, plane_step)
    reliable = (margin >= _LEAST_MARGIN) & _mask_agreeing(s, prepared)
    if reliable.any():
        reliable &= _mask_overlap(compute_median(s[reliable]), prepared)
    return s[_mask_patches((s - s_range[0]) / plane_step, reliable)]


def compute_robust_range(s: NDArray[np.float32]) -> tuple[float, float] | None:
    """Return the (far, near) range of s (N,) with margins; None when there are too few values."""
    if len(s) < _ENOUGH_PX:
        return None
    far, near = np.quantile(s, _ENDS)
    return float(far) / (1 + _MARGIN[1]), float(near) / (1 - _MARGIN[0])


def _mask_agreeing(s: NDArray[np.float32], prepared: PreparedFrame) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels at which at least one auxiliary matches the core."""
    _, _, used = form_normal_equations(s, prepared, _WINDOW_PX, _MISFIT_VARIANCE)
    return used > 0


def _mask_overlap(s: float, prepared: PreparedFrame) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels that some auxiliary sees at inverse depth s.

    Outside it a wrong plane is best because the right one projects outside the images.
    """
    context = prepared.context
    plane = np.full(prepared.core.shape, s, np.float32)
    inside = [
        context.kernels.visible(plane, view, np.zeros_like(image), 0.0, threads=context.threads)
        for view, image in zip(prepared.views, prepared.images, strict=True)
    ]
    return np.any(inside, axis=0)


def _mask_patches(plane: NDArray[np.floating], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the part of the mask that forms coherent patches of planes (H, W); single pixels match by chance."""
    index = np.where(mask, plane, -1).round().astype(np.int16)
    cv2.filterSpeckles(index, -1, _PATCH_PX, _PATCH_STEP)
    return index >= 0


PLANE_STEP_PX = 0.5
"""Distance of the planes in pixels of the small images."""
COARSE_WIDTH_PX = 306
"""Approximate width of the images in coarse matching."""
_PARALLEL_RAD = np.deg2rad(3.0)
"""Angle between optical axes below which they count as parallel."""
_AROUND_CONVERGENCE = (0.45, 2.2)
"""Depth range of the search, in units of the depth at which the axes meet."""
_BASELINES = (1.2, 40.0)
"""Depth range of the search, in baselines, when the axes are parallel."""


def find_depth_range(
    rig: Rig, frame_set: FrameSet, reporter: Reporter, threads: int = 0
) -> tuple[float, float]:
    """Return the near and far end of the visible surfaces along the core's optical axis, mm.

    The point where the optical axes meet (for a parallel rig the length of the baselines) bounds a coarse sweep of
    all auxiliaries; its reliable matches give the range, with margins.

    Raises
    ------
    ReconstructionError
        When no pair is left, or coarse matching finds no surface.
    """
    names = list_usable_auxiliaries(rig, frame_set)
    near, far = compute_search_range(rig, names)
    step = max(1, round(rig.core_camera.size_px[0] / COARSE_WIDTH_PX))
    context = MatchContext.for_grid(rig, names, step, load_on_processor(), threads)
    unit = context.inverse_depth_scale
    s_range = 1 / (far * unit), 1 / (near * unit)
    matches = find_reliable_matches(prepare_frame(frame_set, context), s_range, PLANE_STEP_PX)
    reporter.step(f"looking for the surface in {frame_set.frame}", 1, 1)
    matched_range = compute_robust_range(matches)
    if matched_range is None:
        raise ReconstructionError(
            f"frame {frame_set.frame}: no surface found between {near:.0f} and {far:.0f} mm; is the "
            "speckle projector on? Or give the depth range"
        )
    return max(near, 1 / (matched_range[1] * unit)), 1 / (matched_range[0] * unit)


def compute_search_range(rig: Rig, auxiliaries: tuple[str, ...]) -> tuple[float, float]:
    """Return (near, far) in mm: the widest range in which this rig can measure a surface."""
    meeting = [depth for name in auxiliaries if (depth := _compute_convergence_mm(rig, name)) is not None]
    if meeting:
        middle = float(np.median(meeting))
        return middle * _AROUND_CONVERGENCE[0], middle * _AROUND_CONVERGENCE[1]
    baseline = max(float(np.linalg.norm(rig.cam_from_core[name].center_mm)) for name in auxiliaries)
    return baseline * _BASELINES[0], baseline * _BASELINES[1]


def _compute_convergence_mm(rig: Rig, name: str) -> float | None:
    """Return the depth at which the core's axis is closest to the auxiliary's; None if parallel or diverging."""
    pose = rig.cam_from_core[name].inverse()
    axis = pose.rotation[:, 2]
    sine2 = 1.0 - axis[2] ** 2
    if sine2 < np.sin(_PARALLEL_RAD) ** 2:
        return None
    across = pose.translation_mm - np.dot(pose.translation_mm, axis) * axis
    depth = float(across[2] / sine2)
    return depth if depth > 0 else None
