"""Sensitivity of a camera's intrinsics, and of a pair's pose, to the corners they were estimated from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.solver.lens import (
    differentiate_by_pose,
    list_parameters,
    pack_intrinsics,
    project_with_jacobians,
)
from beltscape.core.arrays import Array
from beltscape.core.geometry.pose import Pose

SharedCorners = Mapping[str, tuple[NDArray[np.int64], NDArray[np.int64]]]
"""Ids of the corners that relate two cameras, by frame: those of the first camera and those of the second."""

NOISE_FLOOR_PX = 0.005
"""Least noise of a detected corner that is assumed, however small the residuals are."""


@dataclass(frozen=True, slots=True, eq=False)
class LensSensitivity:
    """A camera's intrinsics and their derivatives by its corners."""

    camera: str
    model: str
    """Name of the lens model."""
    intrinsics: Array
    """(W,) fx, fy, cx, cy and the coefficients of the lens model."""
    free: NDArray[np.bool_]
    """(W,) which ones were estimated from the corners; the others are taken as exact."""
    rows: Mapping[str, int]
    """Frame → index of its first coordinate among all coordinates of the camera's corners."""
    by_corners: Array
    """(2m, free) derivatives of the free intrinsics by all corners' coordinates, px."""
    sigma_px: float
    """One standard deviation of a coordinate, from the camera's own residuals."""


def compute_lens_sensitivity(
    detections: BoardDetections, calibration: MonocularCalibration, board_mm: Array
) -> LensSensitivity:
    """Differentiate a camera's calibration by its corners, implicitly at the minimum."""
    name, views = calibration.camera.name, detections.views[calibration.camera.name]
    ends = np.cumsum([2 * len(corners) for corners in views.values()])
    rows = {frame: int(end) - 2 * len(views[frame]) for frame, end in zip(views, ends, strict=True)}
    lens, model = pack_intrinsics(calibration.camera), calibration.camera.model
    free = np.array([calibration.sigma[parameter] > 0 for parameter in list_parameters(model)])
    used = [views[frame] for frame in calibration.cam_from_board]
    rotated = np.concatenate(
        [
            board_mm[c.ids] @ pose.rotation.T
            for c, pose in zip(used, calibration.cam_from_board.values(), strict=True)
        ]
    )
    counts = [len(corners) for corners in used]
    shifts = np.repeat([pose.translation_mm for pose in calibration.cam_from_board.values()], counts, axis=0)
    pixels, by_point, by_lens = project_with_jacobians(rotated + shifts, lens, model)
    jacobian = _eliminate_board_poses(
        differentiate_by_pose(by_point, rotated).reshape(-1, 6),
        by_lens.reshape(-1, len(lens))[:, free],
        _split_rows(2 * np.array(counts)),
    )
    where = np.concatenate([rows[f] + np.arange(2 * len(views[f])) for f in calibration.cam_from_board])
    squares = float(((pixels - np.concatenate([corners.pixels for corners in used])) ** 2).sum())
    freedom = 2 * sum(counts) - 6 * len(used) - int(free.sum())
    sigma = np.sqrt(squares / freedom) if freedom > 0 else 0.0
    by_corners = np.zeros((int(ends[-1]), int(free.sum())))
    by_corners[where] = _compute_pseudo_inverse(jacobian).T
    return LensSensitivity(name, model, lens, free, rows, by_corners, max(float(sigma), NOISE_FLOOR_PX))


def compute_pair_sensitivity(
    detections: BoardDetections,
    lenses: tuple[LensSensitivity, LensSensitivity],
    second_from_first: Pose,
    first_from_board: Mapping[str, Pose],
    board_mm: Array,
    common: SharedCorners,
) -> tuple[dict[str, Array], Array]:
    """Return a pair's `sensitivity` and `covariance` by implicit differentiation at the minimum."""
    by_board, by_rest, pixels = _differentiate_pair(
        lenses, second_from_first, first_from_board, board_mm, common
    )
    ends = [0, 2 * len(pixels[0]), 2 * (len(pixels[0]) + len(pixels[1]))]
    sides = [
        [start + np.arange(int(run.start), int(run.stop)) for run in _split_rows(2 * np.array(counts))]
        for start, counts in zip(ends, zip(*map(_count_corners, common.values()), strict=True), strict=False)
    ]
    frames = [np.concatenate(rows) for rows in zip(*sides, strict=True)]
    jacobian = _eliminate_board_poses(by_board, by_rest, frames)
    direct = _compute_pseudo_inverse(jacobian[:, :6])  # (6, rows): ξ by each coordinate at fixed intrinsics
    by_lens = np.split(direct @ jacobian[:, 6:], [int(lenses[0].free.sum())], axis=1)
    freedom = max(1 - (6 + 6 * len(common)) / ends[2], 0.1)
    sensitivity: dict[str, Array] = {}
    covariance: Array = np.zeros((6, 6))
    for side, lens in enumerate(lenses):
        views = detections.views[lens.camera]
        at = {frame: np.searchsorted(views[frame].ids, ids[side]) for frame, ids in common.items()}
        detected = np.concatenate([views[frame].pixels[corners] for frame, corners in at.items()])
        by_corners = -lens.by_corners @ by_lens[side].T
        where = [
            (lens.rows[frame] + 2 * corners[:, None] + np.arange(2)).ravel() for frame, corners in at.items()
        ]
        here = direct[:, ends[side] : ends[side + 1]]
        by_corners[np.concatenate(where)] += here.T
        sensitivity[lens.camera] = lens.sigma_px * by_corners
        # noise of the pair beyond the camera's own did not enter the estimate of the lens
        variance = float(((pixels[side] - detected) ** 2).sum()) / detected.size / freedom
        beyond = max(variance - lens.sigma_px**2, 0.0)
        covariance += sensitivity[lens.camera].T @ sensitivity[lens.camera] + beyond * here @ here.T
    return sensitivity, covariance


def _differentiate_pair(
    lenses: tuple[LensSensitivity, LensSensitivity],
    pair: Pose,
    first_from_board: Mapping[str, Pose],
    board_mm: Array,
    common: SharedCorners,
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Differentiate a pair's n corners, frame by frame, all of the first camera before all of the second.

    Returns
    -------
    (2n, 6) derivatives by the board's pose; (2n, 6 + free) by ξ and both cameras' free intrinsics; both pixels.
    """
    a, b = lenses
    (rotated_a, in_first_a), (rotated_b, in_first_b) = (
        _place_corners(first_from_board, {frame: ids[side] for frame, ids in common.items()}, board_mm)
        for side in (0, 1)
    )
    pixels_a, by_first, by_lens_a = project_with_jacobians(in_first_a, a.intrinsics, a.model)
    pixels_b, by_second, by_lens_b = project_with_jacobians(pair.apply(in_first_b), b.intrinsics, b.model)
    through_pair = by_second @ pair.rotation
    by_board = np.concatenate(
        [differentiate_by_pose(by_first, rotated_a), differentiate_by_pose(through_pair, rotated_b)]
    )
    rows, split = 2 * len(in_first_a), 6 + int(a.free.sum())
    by_rest = np.zeros((rows + 2 * len(in_first_b), split + int(b.free.sum())))
    by_rest[rows:, :6] = differentiate_by_pose(through_pair, in_first_b).reshape(-1, 6)
    by_rest[:rows, 6:split] = by_lens_a.reshape(-1, len(a.intrinsics))[:, a.free]
    by_rest[rows:, split:] = by_lens_b.reshape(-1, len(b.intrinsics))[:, b.free]
    return by_board.reshape(-1, 6), by_rest, (pixels_a, pixels_b)


def _place_corners(
    first_from_board: Mapping[str, Pose], common: Mapping[str, NDArray[np.int64]], board_mm: Array
) -> tuple[Array, Array]:
    """Return corners (n, 3) rotated into the first camera's axes, and in its frame."""
    rotated = [board_mm[ids] @ first_from_board[frame].rotation.T for frame, ids in common.items()]
    shifts = [first_from_board[frame].translation_mm for frame in common]
    in_first = [own + shift for own, shift in zip(rotated, shifts, strict=True)]
    return np.concatenate(rotated), np.concatenate(in_first)


def _eliminate_board_poses(
    by_board: Array, by_others: Array, frames: Sequence[slice | NDArray[np.int64]]
) -> Array:
    """Return derivatives (n, c) with each frame's board pose projected out: a root of the Schur complement."""
    projected = np.empty_like(by_others)
    for rows in frames:
        boards, others = by_board[rows], by_others[rows]
        projected[rows] = others - boards @ np.linalg.solve(boards.T @ boards, boards.T @ others)
    return projected


def _compute_pseudo_inverse(jacobian: Array) -> Array:
    """Return the pseudo-inverse (c, n): derivatives of the least-squares solution by its n right sides."""
    orthonormal, triangle = np.linalg.qr(jacobian)
    return np.linalg.solve(triangle, orthonormal.T)


def _count_corners(shared: tuple[NDArray[np.int64], NDArray[np.int64]]) -> tuple[int, int]:
    return len(shared[0]), len(shared[1])


def _split_rows(counts: NDArray[np.int64]) -> list[slice]:
    ends = np.cumsum(counts)
    return [slice(int(end - count), int(end)) for count, end in zip(counts, ends, strict=True)]
