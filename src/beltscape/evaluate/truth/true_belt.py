"""The empty belt of a simulated plant, found in its true depth."""

from __future__ import annotations

import numpy as np

from beltscape.core.belt.empty_belt import Belt
from beltscape.core.depth import DepthMap
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.simulate.truth.core_truth import trace_core_view

_TRUE_SIGMA_MM = 0.02
"""σ of the empty belt's true depth: that of a measured empty belt, so that it adds nothing of its own."""


def find_true_belt(scene: SimulatedScene) -> Belt:
    """Return the empty belt of a scene's plant, whatever lies on it in the scene."""
    plant = SimulatedScene(scene.scenario.model_copy(update={"kind": "belt_empty"}))
    depth = trace_core_view(plant.world_at(0), plant.station).depth_mm
    seen = np.isfinite(depth)
    sigma = np.where(seen, _TRUE_SIGMA_MM, np.nan).astype(np.float32)
    empty = DepthMap(depth.astype(np.float32), sigma, seen.astype(np.uint8), seen.astype(np.float32))
    return find_belt(empty, plant.station.rig.core_camera)
