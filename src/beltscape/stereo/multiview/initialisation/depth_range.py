"""The depth range of a frame, from the rig's geometry and coarse matching, where the user gives none."""

from __future__ import annotations

import numpy as np

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.kernels import load
from beltscape.stereo.cameras import list_usable_auxiliaries
from beltscape.stereo.multiview.frame.context import MatchContext
from beltscape.stereo.multiview.frame.frame import prepare_frame
from beltscape.stereo.multiview.initialisation.reliable_matches import (
    compute_robust_range,
    find_reliable_matches,
)

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
    context = MatchContext.for_grid(rig, names, step, load(), threads)
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
