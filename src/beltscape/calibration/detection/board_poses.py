"""Groups of frames that show one pose of the board, as a board at rest does, by its corners in the images.

A comparison of held-out views keeps the frames of a group on one side of every split.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.core.arrays import Array

SAME_POSE = 0.02
"""Two frames show the same pose of the board if no camera's corners moved by more than this share of the board's size
in the image: 10 px of 500. A board at rest moves by 0.001, poses taken one by one by 0.1 and more."""
THINNED_CORNERS, MIN_COMMON = 48, 3
"""Corners of a view that are compared at most, and at least."""
FOLDS = 6
"""Number of parts of the views, each held out once."""


def cluster_frames(detections: BoardDetections, frames: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return the frames in groups of one pose of the board each, in the order of their first frames.

    Two frames are of one pose if they are in every camera that sees both, and in one at least; groups that share a
    frame are one. So a board that drifts slowly is one group, too, as it must be: its neighbours are near-identical.
    """
    corners = [_stack_corners(detections, name, frames) for name in detections.cameras]
    group = np.arange(len(frames))
    for i in range(1, len(frames)):
        moved = np.max(
            [_compute_displacements(pixels, i) for pixels in corners], axis=0
        )  # −1: not comparable
        same = np.flatnonzero((moved >= 0) & (moved < SAME_POSE))
        joined = np.unique(group[np.append(same, i)])
        group[np.isin(group, joined)] = joined[0]
    return [
        tuple(frame for frame, own in zip(frames, group, strict=True) if own == each)
        for each in np.unique(group)
    ]


def _stack_corners(detections: BoardDetections, name: str, frames: tuple[str, ...]) -> Array:
    """Return a camera's corners (F, n, 2), px, evenly thinned; NaN where it does not see them."""
    views = detections.views[name]
    count = 1 + max((int(corners.ids.max()) for corners in views.values()), default=0)
    pixels = np.full((len(frames), count, 2), np.nan)
    for k, frame in enumerate(frames):
        if frame in views:
            pixels[k, views[frame].ids] = views[frame].pixels
    return pixels[:, :: max(count // THINNED_CORNERS, 1)]


def _compute_displacements(pixels: Array, index: int) -> Array:
    """Return the median displacement (index,) from earlier frames, over the board's size; −1: no common corners."""
    now, before = pixels[index], pixels[:index]
    visible = np.isfinite(now[:, 0]) & np.isfinite(before[:, :, 0])
    size = float(np.linalg.norm(np.ptp(now[np.isfinite(now[:, 0])], axis=0))) if visible.any() else 1.0
    distance = np.linalg.norm(now - before, axis=2) / max(size, 1.0)
    pairs = zip(distance, visible, strict=True)
    return np.array([np.median(row[own]) if own.sum() >= MIN_COMMON else -1.0 for row, own in pairs])


def list_lens_folds(detections: BoardDetections, name: str) -> Iterator[tuple[list[str], list[str]]]:
    """Yield training and test frames of a camera; no pose of the board is in two folds.

    The poses are dealt out by the distance of their farthest corner from the middle, so that views of the image's
    edge are in every fold: where one fold holds them all, every model is extrapolated.
    """
    views, middle = detections.views[name], (np.array(detections.sizes_px[name]) - 1) / 2
    poses = cluster_frames(detections.restrict([name], views), tuple(views))
    poses.sort(key=lambda frames: -max(_find_reach_px(views[frame], middle) for frame in frames))
    count = min(FOLDS, len(poses) // 2)
    if count < 2:
        return
    folds = [[frame for frames in poses[i::count] for frame in frames] for i in range(count)]
    for fold in folds:
        yield [frame for frame in views if frame not in fold], [frame for frame in views if frame in fold]


def _find_reach_px(view: Corners, middle: Array) -> float:
    return float(np.linalg.norm(view.pixels - middle, axis=1).max())
