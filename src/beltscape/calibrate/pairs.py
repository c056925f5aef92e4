"""Binocular calibration: the pose between every two cameras that share views (the paper's Section 2.2.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.corners import Sightings, spread_in_two_directions
from beltscape.calibrate.intrinsics import OUTLIER_FACTOR, PARAMETERS, Monocular
from beltscape.calibrate.jacobian import by_pose, project
from beltscape.calibrate.lens import intrinsics
from beltscape.core.errors import CalibrationError
from beltscape.core.pose import Pose
from beltscape.core.progress import Reporter

Array = NDArray[np.float64]

MIN_COMMON = 6
"""Corners that two cameras must share in a frame for it to count."""
NOISE_FLOOR_PX = 0.005
"""No detector finds corners better than so, whatever the residuals say."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two cameras and the pose between them."""

    first: str
    second: str
    second_from_first: Pose
    rms_px: float
    """Reprojection RMS in both images over the frames used, intrinsics fixed."""
    frames: tuple[str, ...]
    corners: int
    """Corners seen by both, over the frames used."""
    covariance: Array
    """(6, 6) of the twist ξ = (rad, mm) in ``second_from_first = true @ exp(ξ)`` (Eq. 14), to first order.

    It contains the noise of the corners, as large as the pair's own residuals show it, both directly and by way of
    the intrinsics that were found from the same corners. It does not contain what makes residuals without being
    noise: a bent board, a lens the model does not describe, images of different instants.
    """
    rejected: Mapping[str, str] = field(default_factory=dict)
    """Frame → why it was left out."""
    influence: Mapping[str, Array] = field(default_factory=dict)
    """camera → (2m, 6): ξ by each coordinate of all m corners of that camera, per standard deviation of the noise
    that the camera alone shows. Pairs share corners, so their errors hang together: ``Σ A.T @ B`` over the cameras of
    both pairs is the covariance between them. Empty: independent of all other pairs."""

    @property
    def variance(self) -> float:
        """How far the pair can be trusted, px²: the squared RMS over the corners that share it."""
        return self.rms_px**2 / self.corners


def calibrate_pairs(
    sightings: Sightings,
    cameras: Mapping[str, Monocular],
    board_mm: NDArray[np.float64],
    reporter: Reporter,
) -> tuple[Pair, ...]:
    """Every pair of cameras that shares views: n(n-1)/2 of them in a rig where all see the board (Eqs. 7-8)."""
    found: list[Pair] = []
    candidates = list(combinations(cameras, 2))
    for done, (first, second) in enumerate(candidates, start=1):
        pair = calibrate_pair(sightings, cameras[first], cameras[second], board_mm)
        if pair is not None:
            found.append(pair)
        reporter.step("calibrating pairs", done, len(candidates))
    return tuple(found)


def calibrate_pair(
    sightings: Sightings, first: Monocular, second: Monocular, board_mm: NDArray[np.float64]
) -> Pair | None:
    """The pose between two cameras, or None where they share no usable view."""
    names = first.camera.name, second.camera.name
    common = {
        frame: ids
        for frame, ids in sightings.common(*names).items()
        if len(ids) >= MIN_COMMON and spread_in_two_directions(board_mm[ids, :2])
        and frame not in first.rejected and frame not in second.rejected
    }  # fmt: skip
    rejected: dict[str, str] = {}
    while common:
        solution = _solve(sightings, first, second, board_mm, common)
        per_view = solution.view_rms_px
        median = float(np.median(list(per_view.values())))
        bad = {frame: e for frame, e in per_view.items() if e > max(OUTLIER_FACTOR * median, 0.3)}
        if not bad or len(bad) > len(common) // 3:
            corners = sum(len(ids) for ids in common.values())
            lenses = _lens(sightings, first, board_mm), _lens(sightings, second, board_mm)
            influence, covariance = _uncertainty(sightings, lenses, solution, board_mm, common, names)
            return Pair(
                *names, solution.second_from_first, solution.rms_px, tuple(common), corners, covariance,
                rejected, influence,
            )  # fmt: skip
        for frame, error in bad.items():
            rejected[frame] = f"RMS {error:.2f} px in the pair, the median frame has {median:.2f} px"
            del common[frame]
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    second_from_first: Pose
    rms_px: float
    view_rms_px: Mapping[str, float]
    first_from_board: Mapping[str, Pose]


def _solve(
    sightings: Sightings,
    first: Monocular,
    second: Monocular,
    board_mm: NDArray[np.float64],
    common: Mapping[str, NDArray[np.int64]],
) -> _Solution:
    def pixels(name: str) -> list[NDArray[np.float32]]:
        views = sightings.views[name]
        return [
            views[frame].pixels[np.searchsorted(views[frame].ids, ids)].astype(np.float32)
            for frame, ids in common.items()
        ]

    a, b = first.camera, second.camera
    try:
        result = cv2.stereoCalibrateExtended(
            [board_mm[ids].astype(np.float32) for ids in common.values()],
            pixels(a.name), pixels(b.name), a.matrix, a.distortion, b.matrix, b.distortion, a.size_px,
            np.eye(3), np.zeros(3), flags=cv2.CALIB_FIX_INTRINSIC,
            criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10),
        )  # fmt: skip
    except cv2.error as error:
        raise CalibrationError(
            f"cameras {a.name} and {b.name}: their {len(common)} common views give no pose ({error.err})"
        ) from error
    rms, rotation, translation, per_view = float(result[0]), result[5], result[6], result[-1]
    errors = np.sqrt((np.asarray(per_view) ** 2).mean(axis=1))
    return _Solution(
        Pose.of(rotation, translation),
        rms,
        {f: float(e) for f, e in zip(common, errors, strict=True)},
        {f: Pose.of(r, t) for f, r, t in zip(common, result[9], result[10], strict=True)},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Lens:
    """A camera's intrinsics, and how they hang on its corners."""

    intrinsics: Array
    """(9,) fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    free: NDArray[np.bool_]
    """(9,) those that were found from the corners; the others are held to be known."""
    rows: Mapping[str, int]
    """Frame → where the coordinates of its corners start among all of the camera's."""
    response: Array
    """(2m, free) derivatives of the free ones by all corners' coordinates, px."""
    sigma_px: float
    """Noise of a coordinate, from the camera's own residuals."""


def _lens(sightings: Sightings, own: Monocular, board_mm: Array) -> _Lens:
    views, camera = sightings.views[own.camera.name], own.camera
    ends = np.cumsum([2 * len(corners) for corners in views.values()])
    rows = {frame: int(end) - 2 * len(views[frame]) for frame, end in zip(views, ends, strict=True)}
    lens = intrinsics(camera)
    free = np.array([own.sigma[name] > 0 for name in PARAMETERS])
    slopes = np.zeros((int(ends[-1]), int(free.sum())))
    squares, freedom = 0.0, -int(free.sum())
    for frame, pose in own.cam_from_board.items():
        corners = views[frame]
        points = pose.apply(board_mm[corners.ids])
        pixels, by_point, by_lens = project(points, np.tile(lens, (len(points), 1)))
        by_board = by_pose(by_point, points - pose.translation_mm).reshape(-1, 6)
        here = slice(rows[frame], rows[frame] + 2 * len(corners))
        slopes[here] = _beyond(by_board, by_lens.reshape(-1, 9)[:, free])
        squares += float(((pixels - corners.pixels) ** 2).sum())
        freedom += 2 * len(corners) - 6
    sigma = np.sqrt(squares / freedom) if freedom > 0 else 0.0
    orthonormal, triangle = np.linalg.qr(slopes)
    response = np.linalg.solve(triangle, orthonormal.T).T
    return _Lens(lens, free, rows, response, max(float(sigma), NOISE_FLOOR_PX))


def _beyond(by_board: Array, by_others: Array) -> Array:
    """Derivatives (n, c) less what the frame's own board pose can make good: a root of the Schur complement."""
    orthonormal = np.linalg.qr(by_board)[0]
    return by_others - orthonormal @ (orthonormal.T @ by_others)


def _uncertainty(
    sightings: Sightings,
    lenses: tuple[_Lens, _Lens],
    solution: _Solution,
    board_mm: Array,
    common: Mapping[str, NDArray[np.int64]],
    names: tuple[str, str],
) -> tuple[dict[str, Array], Array]:
    """A pair's `influence` and `covariance`: implicit differentiation of the minimum that `_solve` found."""
    slopes, squares, where = [], np.zeros(2), ([], [])
    for frame, ids in common.items():
        by_board, by_rest, pixels = _derivatives(lenses, solution, frame, board_mm[ids])
        slopes.append(_beyond(by_board, by_rest))
        for side, (name, lens) in enumerate(zip(names, lenses, strict=True)):
            corners = sightings.views[name][frame]
            at = np.searchsorted(corners.ids, ids)
            squares[side] += ((pixels[side] - corners.pixels[at]) ** 2).sum()
            where[side].append((lens.rows[frame] + 2 * at[:, None] + np.arange(2)).ravel())
    stacked = np.concatenate(slopes)
    orthonormal, triangle = np.linalg.qr(stacked[:, :6])
    direct = np.linalg.solve(triangle, orthonormal.T)  # (6, rows): ξ by each coordinate, intrinsics held
    by_lens = np.split(direct @ stacked[:, 6:], [int(lenses[0].free.sum())], axis=1)
    per_side = [2 * len(ids) for ids in common.values()]
    starts = np.cumsum([0, *(2 * count for count in per_side)])[:-1]
    freedom = 1 - (6 + 6 * len(common)) / (2 * sum(per_side))
    influence, covariance = {}, np.zeros((6, 6))
    for side, (name, lens) in enumerate(zip(names, lenses, strict=True)):
        own = -lens.response @ by_lens[side].T
        mine = np.concatenate(
            [np.arange(s + side * n, s + (side + 1) * n) for s, n in zip(starts, per_side, strict=True)]
        )
        own[np.concatenate(where[side])] += direct[:, mine].T
        seen = max(float(np.sqrt(squares[side] / sum(per_side) / max(freedom, 0.1))), NOISE_FLOOR_PX)
        covariance += seen**2 * own.T @ own
        influence[name] = lens.sigma_px * own
    return influence, covariance


def _derivatives(
    lenses: tuple[_Lens, _Lens], solution: _Solution, frame: str, points_mm: Array
) -> tuple[Array, Array, tuple[Array, Array]]:
    """One frame's corners, all of the first camera before all of the second.

    Returns
    -------
    (4n, 6) derivatives by the board's pose; (4n, 6 + free) by ξ and both cameras' free intrinsics; their pixels.
    """
    pair, first_from_board = solution.second_from_first, solution.first_from_board[frame]
    in_first = first_from_board.apply(points_mm)
    turned = in_first - first_from_board.translation_mm
    count, (a, b) = 2 * len(in_first), lenses
    pixels_a, by_first, by_lens_a = project(in_first, np.tile(a.intrinsics, (len(in_first), 1)))
    pixels_b, by_second, by_lens_b = project(pair.apply(in_first), np.tile(b.intrinsics, (len(in_first), 1)))
    through_pair = by_second @ pair.rotation
    by_board = np.concatenate([by_pose(by_first, turned), by_pose(through_pair, turned)])
    by_rest = np.zeros((2 * count, 6 + int(a.free.sum() + b.free.sum())))
    by_rest[count:, :6] = by_pose(through_pair, in_first).reshape(-1, 6)
    by_rest[:count, 6 : 6 + int(a.free.sum())] = by_lens_a.reshape(-1, 9)[:, a.free]
    by_rest[count:, 6 + int(a.free.sum()) :] = by_lens_b.reshape(-1, 9)[:, b.free]
    return by_board.reshape(-1, 6), by_rest, (pixels_a, pixels_b)
