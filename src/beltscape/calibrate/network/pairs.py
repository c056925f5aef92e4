"""Binocular calibration: the pose between every two cameras that share views (the paper's Section 2.2.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.detection.corners import BoardDetections, has_planar_extent
from beltscape.calibrate.intrinsics.sensitivity import (
    LensSensitivity,
    compute_lens_sensitivity,
    compute_pair_sensitivity,
)
from beltscape.calibrate.intrinsics.zhang import OUTLIER_FACTOR, MonocularCalibration
from beltscape.calibrate.solver.bundle import Bundle
from beltscape.calibrate.solver.bundle_data import BundlePrior, Geometry, Observations
from beltscape.calibrate.solver.lens import pack_intrinsics
from beltscape.calibrate.solver.levenberg_marquardt import minimise
from beltscape.core.errors import CalibrationError
from beltscape.core.pose import Pose
from beltscape.core.progress import Reporter

Array = NDArray[np.float64]

MISFIT_FACTOR = 1.5
"""Two cameras may fit so much worse than each alone before their frames are taken for different instants."""
MIN_COMMON = 6
"""Corners that two cameras must share in a frame for it to count."""


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

    It contains the noise of the corners, as large as the pair's own residuals show it, what the cameras' own noise
    does by way of the intrinsics found from the same corners, and, where the pair fits worse than its cameras alone,
    that the frames are not of one instant. It does not contain a bent board or a lens the model does not describe.
    """
    rejected: Mapping[str, str] = field(default_factory=dict)
    """Frame → why it was left out."""
    sensitivity: Mapping[str, Array] = field(default_factory=dict)
    """camera → (2m, 6): ξ by each coordinate of all m corners of that camera, per standard deviation of the noise
    that the camera alone shows. Pairs share corners, so their errors hang together: ``Σ A.T @ B`` over the cameras of
    both pairs is the covariance between them. Empty: independent of all other pairs."""

    @property
    def variance(self) -> float:
        """How far the pair can be trusted, px²: the squared RMS over the corners that share it."""
        return self.rms_px**2 / self.corners


def calibrate_pairs(
    detections: BoardDetections,
    cameras: Mapping[str, MonocularCalibration],
    board_mm: NDArray[np.float64],
    reporter: Reporter,
) -> tuple[Pair, ...]:
    """Every pair of cameras that shares views: n(n-1)/2 of them in a rig where all see the board (Eqs. 7-8)."""
    sensitivities = {
        name: compute_lens_sensitivity(detections, own, board_mm) for name, own in cameras.items()
    }
    found: list[Pair] = []
    candidates = list(combinations(cameras, 2))
    for done, (first, second) in enumerate(candidates, start=1):
        both = sensitivities[first], sensitivities[second]
        pair = calibrate_pair(detections, cameras[first], cameras[second], board_mm, both)
        if pair is not None:
            found.append(pair)
        reporter.step("calibrating pairs", done, len(candidates))
    return tuple(found)


def calibrate_pair(
    detections: BoardDetections,
    first: MonocularCalibration,
    second: MonocularCalibration,
    board_mm: NDArray[np.float64],
    sensitivities: tuple[LensSensitivity, LensSensitivity] | None = None,
) -> Pair | None:
    """The pose between two cameras, or None where they share no usable view.

    ``sensitivities`` of the two, where they are known already, save their computation.

    Raises
    ------
    CalibrationError
        When the common views give no pose.
    """
    names = first.camera.name, second.camera.name
    common = {
        frame: ids
        for frame, ids in detections.find_common_corners(*names).items()
        if len(ids) >= MIN_COMMON and has_planar_extent(board_mm[ids, :2])
        and frame not in first.rejected and frame not in second.rejected
    }  # fmt: skip
    rejected: dict[str, str] = {}
    while common:
        solution = _solve_pair(detections, first, second, board_mm, common)
        per_view = solution.view_rms_px
        median = float(np.median(list(per_view.values())))
        bad = {frame: e for frame, e in per_view.items() if e > max(OUTLIER_FACTOR * median, 0.3)}
        if not bad or len(bad) > len(common) // 3:
            corners = sum(len(ids) for ids in common.values())
            a, b = sensitivities or [
                compute_lens_sensitivity(detections, own, board_mm) for own in (first, second)
            ]
            pose, boards = solution.second_from_first, solution.first_from_board
            sensitivity, covariance = compute_pair_sensitivity(
                detections, (a, b), pose, boards, board_mm, common
            )
            covariance = covariance + _compute_misfit_covariance(solution, first, second)
            return Pair(
                *names, pose, solution.rms_px, tuple(common), corners, covariance, rejected, sensitivity
            )  # fmt: skip
        for frame, error in bad.items():
            rejected[frame] = f"RMS {error:.2f} px in the pair, the median frame has {median:.2f} px"
            del common[frame]
    return None


def _compute_misfit_covariance(
    solution: _Solution, first: MonocularCalibration, second: MonocularCalibration
) -> Array:
    """(6, 6) what frames that are not of one instant add: each is off by what the two cameras fit worse than alone.

    The board moved in between, by a distance and a turn of which the pixels tell the size only; over F frames it
    averages to 1/√F. Without it, weights by the noise alone would follow one such frame into the absurd.
    """
    alone = max(first.rms_px, second.rms_px)
    excess_px = np.sqrt(max(solution.rms_px**2 - (MISFIT_FACTOR * alone) ** 2, 0.0))
    boards = solution.first_from_board.values()
    distance_mm = float(np.median([pose.translation_mm[2] for pose in boards]))
    angle = excess_px / float(np.mean([own.camera.focal_px.mean() for own in (first, second)]))
    return np.diag(np.repeat([angle, angle * distance_mm], 3) ** 2) / len(solution.first_from_board)


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    second_from_first: Pose
    rms_px: float
    view_rms_px: Mapping[str, float]
    first_from_board: Mapping[str, Pose]


def _solve_pair(
    detections: BoardDetections,
    first: MonocularCalibration,
    second: MonocularCalibration,
    board_mm: NDArray[np.float64],
    common: Mapping[str, NDArray[np.int64]],
) -> _Solution:
    """The bundle of two cameras with known lenses and a board as drawn (Eqs. 7-8)."""
    bundle = Bundle(
        _collect_observations(detections, first, second, common), _make_prior(first, second, board_mm)
    )
    try:
        found = minimise(bundle, _initialise_geometry(first, second, board_mm, tuple(common))).state
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"cameras {first.camera.name} and {second.camera.name}: "
            f"their {len(common)} common views give no pose ({error})"
        ) from error
    squares = (bundle.compute_errors_px(found) ** 2).sum(axis=1)
    frame = bundle.observations.frame
    per_view = np.sqrt(np.bincount(frame, squares) / np.bincount(frame))
    boards = zip(common, found.board_rotation, found.board_translation_mm, strict=True)
    return _Solution(
        Pose(found.cam_rotation[1], found.cam_translation_mm[1]),
        float(np.sqrt(squares.mean())),
        {f: float(e) for f, e in zip(common, per_view, strict=True)},
        {f: Pose(rotation, translation) for f, rotation, translation in boards},
    )


def _collect_observations(
    detections: BoardDetections,
    first: MonocularCalibration,
    second: MonocularCalibration,
    common: Mapping[str, NDArray[np.int64]],
) -> Observations:
    """The common corners, in both images."""
    return Observations.of(
        (camera, frame, ids, view.pixels[np.searchsorted(view.ids, ids)])
        for frame, (name, ids) in enumerate(common.items())
        for camera, own in enumerate((first, second))
        for view in (detections.views[own.camera.name][name],)
    )


def _make_prior(first: MonocularCalibration, second: MonocularCalibration, board_mm: Array) -> BundlePrior:
    """Neither lenses nor board are adjusted."""
    lenses = np.stack([pack_intrinsics(own.camera) for own in (first, second)])
    return BundlePrior(lenses, np.zeros((2, 9, 9)), np.zeros((2, 9), bool), board_mm, np.zeros(3))


def _initialise_geometry(
    first: MonocularCalibration, second: MonocularCalibration, board_mm: Array, frames: Sequence[str]
) -> Geometry:
    """The pose that most frames agree on, the board as the first camera alone sees it."""
    boards = [first.cam_from_board[frame] for frame in frames]
    pair = _select_medoid(
        [second.cam_from_board[f] @ board.inverse() for f, board in zip(frames, boards, strict=True)],
        float(np.median([np.linalg.norm(board.translation_mm) for board in boards])),
    )
    return Geometry(
        np.stack([pack_intrinsics(own.camera) for own in (first, second)]),
        np.stack([np.eye(3), pair.rotation]),
        np.stack([np.zeros(3), pair.translation_mm]),
        np.stack([board.rotation for board in boards]),
        np.stack([board.translation_mm for board in boards]),
        board_mm,
    )


def _select_medoid(poses: Sequence[Pose], distance_mm: float) -> Pose:
    """The pose that is nearest to the others, turns counted by what they move at a distance."""
    features = np.stack(
        [np.concatenate([distance_mm * pose.rotation.ravel(), pose.center_mm]) for pose in poses]
    )
    apart = np.linalg.norm(features[:, None] - features[None], axis=2)
    return poses[int(np.argmin(apart.sum(axis=1)))]
