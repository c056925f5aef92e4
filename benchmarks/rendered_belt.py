"""The moving belt of another renderer: its flow, and the true heights of its load that the core sees in some frames.

Its truth holds depth maps of three frames and no height field. Places that the core does not see in any of them have
no true height here, so that cells which hold such a place are left out of the scores.
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.core.progress import Silent
from beltscape.evaluate.belt_scores import TrueBelt
from beltscape.pipeline.measuring import flow
from captures import read_true_rig
from live import make_plant

_WIDTH_PX = 612
_MATERIAL = 2
"""Label of the load in the truth's depth maps."""
_STEP_MM = 1.0
"""Cell of the true heights: a quarter of the cells that are scored."""
_REACH_MM = 1.2
"""Farthest true point of a place that counts as seen: points lie some 1.6 mm apart, and twice as far across steps."""


def read_rig(rendered: Path) -> Rig:
    """Return the true rig at the size of the moving belt's images."""
    rig = read_true_rig(rendered)
    return scale_rig(rig, _WIDTH_PX / rig.core_camera.size_px[0])


def measure_flow(rendered: Path, cache: Path, preset: str) -> flow.Flow:
    """Return the flow of the moving belt, with its encoder; its empty belt is reconstructed in ``cache``."""
    capture, empty = cache / f"capture{_WIDTH_PX}", cache / f"empty{_WIDTH_PX}" / "out"
    if not empty.is_dir():
        capture, empty = make_plant(rendered, read_true_rig(rendered), cache, _WIDTH_PX)
    encoder = capture / "encoder.csv"
    return flow.measure_flow_of_capture(
        capture, read_rig(rendered), empty, Silent(), encoder=encoder, preset=preset
    )


def read_volume_mm3(rendered: Path) -> float:
    """Return the true volume of the load."""
    return float(json.loads((rendered / "truth" / "belt_moving.json").read_text())["total_volume_mm3"])


def read_seen_heights(rendered: Path) -> TrueBelt:
    """Return the true heights of the load where the core sees it in a frame with a true depth map; NaN elsewhere."""
    truth = rendered / "truth"
    moving = json.loads((truth / "belt_moving.json").read_text())
    places = {Path(one["frame"]).stem: float(one["belt_position_mm"]) for one in moving["frames"]}
    core = json.loads((truth / "rig.json").read_text())["cameras"]["cam0"]
    core_from_world = Pose.of(core["R"], core["t"])
    profile = np.array(json.loads((truth / "belt.json").read_text())["cross_section"])
    points = list[NDArray[np.float64]]()
    for path in sorted(truth.glob("belt_moving_*_depth_cam0.npz")):
        seen = core_from_world.inverse().apply(_read_points(path, read_rig(rendered)))
        seen[:, 1] -= places[path.name.split("_")[2]]
        seen[:, 2] -= np.interp(seen[:, 0], *profile.T)
        points.append(seen)
    low, high = (find(np.concatenate(points)[:, :2], axis=0) for find in (np.min, np.max))
    x_mm, y_mm = (np.arange(low[k], high[k], _STEP_MM) for k in range(2))
    grid = np.stack(np.meshgrid(x_mm, y_mm), axis=-1)
    height_mm = np.full(grid.shape[:2], np.nan)
    for one in points:  # a place that two frames see gets the height of the later one: both are true
        tree = KDTree(one[:, :2])
        distance, nearest = tree.query(grid, distance_upper_bound=_REACH_MM)
        known = np.isfinite(distance)
        height_mm[known] = one[nearest[known], 2]
    return TrueBelt(x_mm, y_mm, height_mm, places, core_from_world)


def _read_points(path: Path, rig: Rig) -> NDArray[np.float64]:
    """Return (N, 3) the load's true points in the frame of the core; depths are those of its distorted pixels."""
    with np.load(path) as arrays:
        depth_mm, load = arrays["z_distorted"].astype(np.float64), arrays["label_distorted"] == _MATERIAL
    rows, columns = np.nonzero(load)
    core = rig.core_camera
    rays = cv2.undistortPoints(
        np.stack([columns, rows], axis=-1).astype(np.float64)[:, None], core.matrix, core.distortion
    )[:, 0]
    return np.column_stack([rays, np.ones(len(rays))]) * depth_mm[load][:, None]
