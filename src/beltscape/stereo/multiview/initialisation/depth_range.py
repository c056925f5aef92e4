"""Where the surface is: near and far from the rig's geometry and a coarse look, without being told."""

from __future__ import annotations

import numpy as np

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.kernels import load
from beltscape.stereo.cameras import usable_auxiliaries
from beltscape.stereo.multiview.frame.frame import grid_unit, prepare_frame
from beltscape.stereo.multiview.initialisation.reliable_matches import find_reliable_matches, robust_range

PLANE_STEP_PX = 0.5
"""Distance of the planes in pixels of the small images."""
COARSE_WIDTH_PX = 306
"""The coarse look shrinks the images to about this width."""
_PARALLEL_RAD = np.deg2rad(3.0)
"""Optical axes closer to parallel than this do not say where the surface is."""
_AROUND_CONVERGENCE = (0.45, 2.2)
"""Where a surface may lie, in units of the depth at which the axes meet."""
_BASELINES = (1.2, 40.0)
"""Where a surface may lie, in baselines, when the axes are parallel."""


def find_depth_range(
    rig: Rig, frame_set: FrameSet, reporter: Reporter, threads: int = 0
) -> tuple[float, float]:
    """Near and far end of what is seen, along the core's optical axis, mm.

    Where the optical axes meet (or, for a parallel rig, how long the baselines are) bounds a coarse sweep of all
    auxiliaries; the surfaces that stand out clearly give the range, with margins.

    Raises
    ------
    ReconstructionError
        When no pair is left, or the coarse look finds no surface.
    """
    names = usable_auxiliaries(rig, frame_set)
    near, far = search_range(rig, names)
    kernels = load()
    step = max(1, round(rig.core_camera.size_px[0] / COARSE_WIDTH_PX))
    prepared = prepare_frame(rig, frame_set, names, step, kernels, threads)
    unit = grid_unit(rig, names, step)
    span = 1 / (far * unit), 1 / (near * unit)
    surface = find_reliable_matches(prepared, span, PLANE_STEP_PX, kernels, threads)
    reporter.step(f"looking for the surface in {frame_set.frame}", 1, 1)
    found = robust_range(surface)
    if found is None:
        raise ReconstructionError(
            f"frame {frame_set.frame}: no surface found between {near:.0f} and {far:.0f} mm; is the "
            "speckle projector on? Or give the depth range"
        )
    return max(near, 1 / (found[1] * unit)), 1 / (found[0] * unit)


def search_range(rig: Rig, auxiliaries: tuple[str, ...]) -> tuple[float, float]:
    """(near, far) in mm within which any surface this rig was built for must lie."""
    meeting = [depth for name in auxiliaries if (depth := _convergence_mm(rig, name)) is not None]
    if meeting:
        middle = float(np.median(meeting))
        return middle * _AROUND_CONVERGENCE[0], middle * _AROUND_CONVERGENCE[1]
    baseline = max(float(np.linalg.norm(rig.cam_from_core[name].center_mm)) for name in auxiliaries)
    return baseline * _BASELINES[0], baseline * _BASELINES[1]


def _convergence_mm(rig: Rig, name: str) -> float | None:
    """Depth at which the core's axis is closest to the auxiliary's; None for parallel or parting axes."""
    pose = rig.cam_from_core[name].inverse()
    axis = pose.rotation[:, 2]
    sine2 = 1.0 - axis[2] ** 2
    if sine2 < np.sin(_PARALLEL_RAD) ** 2:
        return None
    across = pose.translation_mm - np.dot(pose.translation_mm, axis) * axis
    depth = float(across[2] / sine2)
    return depth if depth > 0 else None
