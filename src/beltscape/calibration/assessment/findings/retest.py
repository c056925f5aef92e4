"""Second test of the camera network, with the lenses of the adjusted rig.

The network's first test uses the lenses that each camera's own views give. A lens that is off makes pairs and loops
disagree like a camera that moved. With the adjusted lenses only what is wrong with the cameras themselves remains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from beltscape.calibration.assessment.findings.fit_findings import list_network_findings
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.network.association import associate_cameras
from beltscape.calibration.network.global_optimisation import optimise_network
from beltscape.calibration.network.pairs import calibrate_pairs
from beltscape.calibration.solver.deterministic import single_thread
from beltscape.calibration.solver.perspective import fit_view_pose
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Silent

MIN_SHIFT = 0.02
"""A start was off if the adjustment moved its focal length by this share of it; good starts are within 0.002."""
AGREEMENT = (
    "pairs of cameras did not agree with the lenses that their own views gave; with those of the joint "
    "adjustment they do"
)


@dataclass(frozen=True, slots=True, eq=False)
class Retest:
    """The network under the adjusted lenses, and what this explains of its first test."""

    hierarchy: HierarchyResult
    """With the network of the adjusted lenses if these refute findings of the first test; else unchanged."""
    notes: tuple[str, ...]
    """What the first test found and the second refutes, in one line each; no faults."""


def retest_network(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> Retest:
    """Test the network again with the adjusted lenses, if its first test had findings."""
    notes = [*_describe_restarts(hierarchy, adjustment)]
    first = list_network_findings(hierarchy)
    if not first:
        return Retest(hierarchy, tuple(notes))
    try:
        with single_thread():
            again = _rebuild_network(hierarchy, adjustment)
    except CalibrationError:  # no pose fits a pair under these lenses: the first test stands
        return Retest(hierarchy, tuple(notes))
    if len(list_network_findings(again)) >= len(first):
        return Retest(hierarchy, tuple(notes))
    notes += _describe_starts(hierarchy, adjustment) or [AGREEMENT]
    return Retest(again, tuple(notes))


def _rebuild_network(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> HierarchyResult:
    """Return the hierarchy with pairs and network from the adjusted lenses and the adjusted shape of the board."""
    board_mm, detections = adjustment.geometry.points_mm, hierarchy.detections
    cameras: dict[str, MonocularCalibration] = {}
    for name, own in hierarchy.monocular.items():
        lens: Camera = adjustment.rig.cameras[name]
        views = {frame: detections.views[name][frame] for frame in own.cam_from_board}
        poses = {
            frame: fit_view_pose(lens, board_mm[corners.ids], corners.pixels, refine=True)
            for frame, corners in views.items()
        }
        # rms_px and σ stay those of the camera alone, with which pairs are compared
        cameras[name] = replace(own, camera=lens, cam_from_board=poses)
    pairs = calibrate_pairs(detections, cameras, board_mm, Silent())
    network = optimise_network(associate_cameras(hierarchy.rig.core, pairs))
    return replace(hierarchy, monocular=cameras, network=network)


def _describe_restarts(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> list[str]:
    """Return one line about the cameras that were started from the lens of like cameras."""
    restarts = [each for each in hierarchy.restarts if each.camera in adjustment.rig.cameras]
    if not restarts:
        return []
    final = _get_focals(adjustment.rig.cameras)
    sizes = ", ".join(
        f"{r.camera} {r.own_focal_px:.4g} px, now {final[r.camera]:.4g} px" for r in restarts[:4]
    )
    more = f" and {len(restarts) - 4} more" if len(restarts) > 4 else ""
    return [
        f"own views hardly determine the focal length of camera {sizes}{more}; they were started again from the "
        "lens of like cameras or the best of several"
    ]


def _describe_starts(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> list[str]:
    """Return one line for each camera whose lens the joint adjustment corrected far."""
    final = _get_focals(adjustment.rig.cameras)
    lines: list[str] = []
    for name, own in hierarchy.monocular.items():
        start = float(own.camera.focal_px.mean())
        if abs(final[name] - start) > MIN_SHIFT * final[name]:
            lines.append(
                f"the monocular start of camera {name} was off (focal length {start:.4g} px); the joint adjustment "
                f"corrected it to {final[name]:.4g} px"
            )
    return lines


def _get_focals(cameras: Mapping[str, Camera]) -> dict[str, float]:
    return {name: float(np.mean(camera.focal_px)) for name, camera in cameras.items()}
