"""What of a scene the cameras see and the projector lights, pixel by pixel of the core."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.depth_scores import interior_mask
from beltscape.evaluate.truth import occluded_mask
from beltscape.kernels import load
from captures import parse_true_camera

CLASSES = "unseen", "in shadow", "one view", "near a step", "elsewhere"
"""Names of the classes, in their order: a pixel belongs to the first that is true of it."""


@dataclass(frozen=True)
class TrueVisibility:
    """How many auxiliaries see the point of a pixel (H, W), and whether the projector lights it."""

    views: np.ndarray
    lit: np.ndarray

    def classify(self, true_depth_mm: np.ndarray) -> dict[str, np.ndarray]:
        """Return a mask (H, W) for each of the `CLASSES`; every pixel is in one of them."""
        conditions = (
            self.views == 0,
            ~self.lit,
            self.views == 1,
            ~interior_mask(true_depth_mm),
            np.ones(self.views.shape, bool),
        )
        first = np.argmax(conditions, axis=0)
        return {name: first == number for number, name in enumerate(CLASSES)}


def find_visibility(
    rig: Rig, true_depth_mm: np.ndarray, projector: Camera, projector_from_core: Pose
) -> TrueVisibility:
    """Return what the cameras of a rig see whose surface has this true depth (H, W) in the core."""

    def mask_seen(camera: Camera, cam_from_core: Pose) -> np.ndarray:
        cameras = {rig.core: rig.core_camera, camera.name: camera}
        poses = {rig.core: rig.cam_from_core[rig.core], camera.name: cam_from_core}
        hidden = occluded_mask(Rig(rig.core, cameras, poses), true_depth_mm, load())
        return np.isfinite(true_depth_mm) & ~hidden

    seen = [mask_seen(rig.cameras[name], rig.cam_from_core[name]) for name in rig.auxiliaries]
    return TrueVisibility(np.sum(seen, axis=0), mask_seen(projector, projector_from_core))


def read_projector(truth: Path) -> tuple[Camera, Pose]:
    """Return the projector of rendered captures as a camera, and its pose in the core's frame."""
    entry = json.loads((truth / "projector.json").read_text())
    core = json.loads((truth / "rig.json").read_text())["cameras"]["cam0"]
    camera = parse_true_camera("projector", entry, entry["size"])
    return camera, Pose.of(entry["R"], entry["t"]) @ Pose.of(core["R"], core["t"]).inverse()
