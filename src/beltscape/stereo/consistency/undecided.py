"""Textured points that fail to agree with a rig: where they outnumber those that agree, a camera is not sound."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.residuals import compute_pair_residuals
from beltscape.stereo.consistency.rig_consistency import CameraConsistency, RigConsistency
from beltscape.stereo.consistency.tie_points.tie_points import Array, TiePoints

AGREES_PX = 1.0
"""A point agrees with the rig within this distance from its epipolar line, px of the matched images."""


def find_undecided(
    consistency: RigConsistency,
    rig: Rig,
    depth: DepthMap | None,
    points: Array,
    searched: TiePoints | None = None,
) -> RigConsistency:
    """Return the consistency with "undecided" for sound auxiliaries in which more points fail than agree.

    A textured point (N, 2) in an auxiliary's view fails where the depth map has no depth and the search without it,
    ``searched``, finds it nowhere on its epipolar line, and where it is found off that line. A point with a depth
    that is not found again lies on an edge or behind one, as on heaps of stones, and says nothing.
    """
    if depth is None or not depth.measured.any():
        return consistency
    is_lost = ~_is_measured(depth, points)
    rays = (points - rig.core_camera.center_px) / rig.core_camera.focal_px
    surface = np.column_stack([rays, np.ones(len(rays))]) * float(np.nanmedian(depth.depth_mm))
    cameras: list[CameraConsistency] = []
    for each in consistency.cameras:
        camera = rig.cameras[each.camera]
        pixels = camera.project(rig.cam_from_core[each.camera].apply(surface))
        is_lost_here = is_lost & ((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1)).all(axis=1)
        agreeing = found = round(np.nan_to_num(each.agreement) * each.searched)
        if searched is not None:
            on_line = _is_on_line(searched, rig, each.camera)
            agreeing += int((is_lost_here & on_line).sum()) if consistency.guided else 0
            is_lost_here &= ~on_line
        failing = int(is_lost_here.sum()) + (each.points - found if consistency.guided else 0)
        is_open = each.state == "sound" and failing > agreeing
        cameras.append(replace(each, failing=failing, state="undecided" if is_open else each.state))
    return replace(consistency, cameras=tuple(cameras))


def _is_measured(depth: DepthMap, points: Array) -> NDArray[np.bool_]:
    """Return (N,) whether there is a depth at or beside each point (N, 2)."""
    measured = cv2.dilate(depth.measured.astype(np.uint8), np.ones((5, 5), np.uint8))
    column, row = np.rint(points).astype(np.int64).T
    return np.asarray(measured[row, column] > 0, np.bool_)


def _is_on_line(tie_points: TiePoints, rig: Rig, name: str) -> NDArray[np.bool_]:
    """Return (N,) which points were found on their epipolar lines in an auxiliary's image."""
    epipolar = compute_pair_residuals(tie_points, rig, name).epipolar_px
    return np.asarray(np.abs(epipolar) < AGREES_PX * tie_points.pixel_scale, np.bool_)
