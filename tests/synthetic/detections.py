"""Board corners without images: exact projections with known noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import Board, corner_points_mm


def make_detections(
    rig: Rig, board: Board, poses: Sequence[Pose], noise_px: float = 0.0, seed: int = 0,
    seen_by: Mapping[str, Sequence[int]] | None = None,
) -> BoardDetections:  # fmt: skip
    """Return every camera's corners of every board inside its image; ``seen_by`` limits a camera to some frames."""
    board_mm = corner_points_mm(board)
    rng = np.random.default_rng(seed)
    views: dict[str, dict[str, Corners]] = {}
    for name in rig.cameras:
        views[name] = {}
        for i, pose in enumerate(poses):
            noise = rng.normal(0, noise_px, (len(board_mm), 2))
            if seen_by is not None and i not in seen_by[name]:
                continue
            corners = project_corners(rig, name, pose, board_mm, noise)
            if len(corners) >= 8:
                views[name][f"{i:02d}"] = corners
    return BoardDetections(
        {n: c.size_px for n, c in rig.cameras.items()}, views, dict.fromkeys(rig.cameras, len(poses))
    )


def project_corners(
    rig: Rig, name: str, pose: Pose, board_mm: NDArray[np.float64], noise: NDArray[np.float64]
) -> Corners:
    """Return the corners of one board inside one camera's image, with noise."""
    camera = rig.cameras[name]
    pixels = camera.project((rig.cam_from_core[name] @ pose).apply(board_mm)) + noise
    inside = ((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1)).all(axis=1)
    return Corners(np.flatnonzero(inside).astype(np.int64), pixels[inside])


def replace_view(
    own: BoardDetections, camera: str, frame: str, pixels: NDArray[np.float64]
) -> BoardDetections:
    """Return the detections with other pixels in one view."""
    views = {name: dict(frames) for name, frames in own.views.items()}
    views[camera][frame] = Corners(views[camera][frame].ids, pixels)
    return BoardDetections(own.sizes_px, views, own.images)
