"""Corners of a board with errors that are alike over 200 px of an image, as those of photographs are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import corner_points_mm
from tests.synthetic.camera_arrays import BOARD, SIZE_PX

LENGTH_PX = 200.0
WAVES = 60
"""Waves of a random field; its values are normal within a few per cent."""


def draw_field(pixels: NDArray[np.float64], rng: np.random.Generator, sigma_px: float) -> NDArray[np.float64]:
    """Return a random vector (n, 2) at each pixel, alike over `LENGTH_PX`."""
    waves, phases = rng.normal(0, 1 / LENGTH_PX, (WAVES, 2)), rng.uniform(0, 2 * np.pi, (WAVES, 2))
    angles = pixels @ waves.T
    return (
        sigma_px * np.sqrt(2 / WAVES) * np.stack([np.cos(angles + each).sum(axis=1) for each in phases.T], 1)
    )


def detect_correlated(
    rig: Rig,
    poses: Sequence[Pose],
    seed: int,
    *,
    alike_px: float,
    white_px: float = 0.02,
    board_mm: float = 0.0,
) -> BoardDetections:
    """Return the corners of a board known to ± ``board_mm``, with correlated and with independent noise."""
    rng = np.random.default_rng(seed)
    points = corner_points_mm(BOARD)
    points = points + rng.normal(0, 1, points.shape) * board_mm
    views: dict[str, dict[str, Corners]] = {name: {} for name in rig.cameras}
    for i, pose in enumerate(poses):
        for name, camera in rig.cameras.items():
            pixels = camera.project((rig.cam_from_core[name] @ pose).apply(points))
            inside = ((pixels >= 0) & (pixels <= np.array(SIZE_PX) - 1)).all(axis=1)
            seen = pixels[inside]
            noise = rng.normal(0, white_px, seen.shape) + draw_field(seen, rng, alike_px)
            views[name][f"{i:02d}"] = Corners(np.flatnonzero(inside).astype(np.int64), seen + noise)
    return BoardDetections(dict.fromkeys(rig.cameras, SIZE_PX), views, dict.fromkeys(rig.cameras, len(poses)))
