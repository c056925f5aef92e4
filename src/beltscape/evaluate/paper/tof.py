"""Table 3 and Fig. 17: the module measured by a time-of-flight camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.paper.laboratory import Scene
from beltscape.evaluate.paper.surfaces import FRAME, ScoredDepth
from beltscape.evaluate.scores.frame_score import score_frame
from beltscape.evaluate.truth.simulated import Truth
from beltscape.files.reconstruction import read_frame
from beltscape.simulate.geometry.world import Station
from beltscape.simulate.rig_and_projector import DOWN
from beltscape.simulate.truth.core_truth import trace_core_view

TOF = "time of flight"
SMOOTHED_PX = 9
"""Edge of the median filter applied before dimensions are measured; without it noise hides the planes."""


def measure_time_of_flight(scene: Scene) -> ScoredDepth | None:
    """Return the depth of the capture's time-of-flight camera on its own grid; None without such a camera."""
    folder = scene.capture / "tof" / FRAME
    if scene.simulation is None or scene.simulation.scenario.tof is None or not folder.is_dir():
        return None
    found = read_frame(folder)
    height = scene.simulation.scenario.tof.height_mm
    truth = _truth(scene, found.rig, Pose(DOWN.copy(), DOWN @ [0.0, 0.0, -height]))
    scores = score_frame(found.depth, found.rig, truth)
    return ScoredDepth(scene.name, TOF, folder, found.depth, truth, scores)


def smooth_depth(found: ScoredDepth) -> ScoredDepth:
    """Return the depth after a square median filter of ``SMOOTHED_PX``; σ follows for independent noise (π/2 n)."""
    depth = found.depth
    share = np.float32(np.sqrt(np.pi / 2) / SMOOTHED_PX)
    flat = replace(
        depth, depth_mm=median_filter(depth.depth_mm, SMOOTHED_PX), sigma_mm=depth.sigma_mm * share
    )
    return replace(found, depth=flat)


def _truth(scene: Scene, rig: Rig, tof_from_world: Pose) -> Truth:
    """Return the truth on the camera's grid; without auxiliaries no pixel counts as occluded."""
    assert scene.simulation is not None
    view = trace_core_view(scene.simulation.world_at(0), Station(rig, tof_from_world))
    return replace(
        scene.truth,
        rig=rig,
        core_from_world=tof_from_world,
        depth_mm=view.depth_mm,
        label=view.label,
        occluded=np.zeros(view.label.shape, bool),
    )
