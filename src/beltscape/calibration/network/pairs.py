"""Binocular calibration: the relative pose of every two cameras that share views (the paper's Section 2.2.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, has_planar_extent
from beltscape.calibration.intrinsics.sensitivity import (
    LensSensitivity,
    SharedCorners,
    compute_lens_sensitivity,
    compute_pair_sensitivity,
)
from beltscape.calibration.intrinsics.zhang import OUTLIER_FACTOR, MonocularCalibration
from beltscape.calibration.solver.bundle import Bundle, Geometry, Observations
from beltscape.calibration.solver.lens import stack_intrinsics
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.calibration.solver.prior import BundlePrior
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.progress import Reporter

MISFIT_FACTOR = 1.5
"""Factor on the cameras' own RMS above which a pair's frames are taken to be of different instants."""
PRECISE = Damping(start=1e-6, tolerance=1e-6)
"""Damping of a pair's adjustment: the last step is below a thousandth of the poses' σ, and follows at once."""
MIN_COMMON = 6
"""Corners that two cameras must share in a frame for the frame to be used."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two cameras and their relative pose."""

    first: str
    second: str
    second_from_first: Pose
    rms_px: float
    """Reprojection RMS in both images over the frames used, with fixed intrinsics."""
    frames: tuple[str, ...]
    corners: int
    """Corners seen by both, over the frames used; where none is, those of the camera that sees fewer."""
    covariance: Array
    """(6, 6) of the twist ξ = (rad, mm) in ``second_from_first = true @ exp(ξ)`` (Eq. 14), to first order.

    It contains the noise of the corners, estimated from the pair's own residuals; the noise of the intrinsics, which
    were estimated from the same corners; and, if the pair fits worse than its cameras alone, the effect of frames
    that are not of one instant. It does not contain a bent board or a lens that the model does not describe.
    """
    rejected: Mapping[str, str] = field(default_factory=dict[str, str])
    """Frame → reason of the rejection."""
    sensitivity: Mapping[str, Array] = field(default_factory=dict[str, Array])
    """camera → (2m, 6): derivatives of ξ by each coordinate of all m corners of that camera, in standard deviations
    of the camera's own noise. Pairs share corners, so their errors are correlated: ``Σ A.T @ B`` over the cameras of
    both pairs is the covariance between them. Empty: independent of all other pairs."""

    @property
    def variance(self) -> float:
        """Variance that ranks pairs, px²: the squared RMS over the number of corners."""
        return self.rms_px**2 / self.corners


def calibrate_pairs(
    detections: BoardDetections,
    cameras: Mapping[str, MonocularCalibration],
    board_mm: NDArray[np.float64],
    reporter: Reporter,
    core: str | None = None,
) -> tuple[Pair, ...]:
    """Calibrate every pair of cameras that shares views, n(n-1)/2 pairs if all see the board (Eqs. 7-8).

    With ``core`` only its own n-1 pairs.
    """
    sensitivities = {
        name: compute_lens_sensitivity(detections, camera, board_mm) for name, camera in cameras.items()
    }
    pairs: list[Pair] = []
    candidates = [pair for pair in combinations(cameras, 2) if core is None or core in pair]
    for done, (first, second) in enumerate(candidates, start=1):
        both = sensitivities[first], sensitivities[second]
        pair = calibrate_pair(detections, cameras[first], cameras[second], board_mm, both)
        if pair is not None:
            pairs.append(pair)
        reporter.step("calibrating pairs", done, len(candidates))
    return tuple(pairs)


def calibrate_pair(
    detections: BoardDetections,
    first: MonocularCalibration,
    second: MonocularCalibration,
    board_mm: NDArray[np.float64],
    sensitivities: tuple[LensSensitivity, LensSensitivity] | None = None,
) -> Pair | None:
    """Calibrate the relative pose of two cameras; return None if they share no usable view.

    ``sensitivities`` of the two, where they are known already, save their computation.

    Raises
    ------
    CalibrationError
        When the common views give no pose.
    """
    names = first.camera.name, second.camera.name
    common = {
        frame: shared
        for frame, shared in detections.find_shared_corners(*names).items()
        if all(len(ids) >= MIN_COMMON and has_planar_extent(board_mm[ids]) for ids in shared)
        and frame not in first.rejected and frame not in second.rejected
    }  # fmt: skip
    rejected: dict[str, str] = {}
    while common:
        solution = _solve_pair(detections, first, second, board_mm, common)
        per_view = solution.view_rms_px
        median = float(np.median(list(per_view.values())))
        outliers = {frame: e for frame, e in per_view.items() if e > max(OUTLIER_FACTOR * median, 0.3)}
        if not outliers or len(outliers) > len(common) // 3:
            corners = sum(min(len(ids) for ids in shared) for shared in common.values())
            a, b = sensitivities or [
                compute_lens_sensitivity(detections, camera, board_mm) for camera in (first, second)
            ]
            pose, boards = solution.second_from_first, solution.first_from_board
            sensitivity, covariance = compute_pair_sensitivity(
                detections, (a, b), pose, boards, board_mm, common
            )
            covariance = covariance + _compute_misfit_covariance(solution, first, second)
            return Pair(
                *names, pose, solution.rms_px, tuple(common), corners, covariance, rejected, sensitivity
            )  # fmt: skip
        for frame, error in outliers.items():
            rejected[frame] = f"RMS {error:.2f} px in the pair, the median frame has {median:.2f} px"
            del common[frame]
    return None


def _compute_misfit_covariance(
    solution: _Solution, first: MonocularCalibration, second: MonocularCalibration
) -> Array:
    """Return the covariance (6, 6) that frames of different instants add, from the excess of the pair's RMS.

    The board moved in between; the pixels determine only the size of that translation and rotation. Over F frames it
    averages to 1/√F. Without this term, weights from noise alone would follow a single such frame.
    """
    alone = max(first.rms_px, second.rms_px)
    excess_px = np.sqrt(max(solution.rms_px**2 - (MISFIT_FACTOR * alone) ** 2, 0.0))
    boards = solution.first_from_board.values()
    distance_mm = float(np.median([pose.translation_mm[2] for pose in boards]))
    angle = excess_px / float(np.mean([camera.camera.focal_px.mean() for camera in (first, second)]))
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
    common: SharedCorners,
) -> _Solution:
    """Adjust the bundle of two cameras with fixed lenses and the nominal board (Eqs. 7-8)."""
    bundle = Bundle(
        _collect_observations(detections, first, second, common), _make_prior(first, second, board_mm)
    )
    try:
        start = _initialise_geometry(first, second, board_mm, tuple(common))
        geometry = minimise(bundle, start, PRECISE).state
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"cameras {first.camera.name} and {second.camera.name}: "
            f"their {len(common)} common views give no pose"
        ) from error
    squares = (bundle.compute_errors_px(geometry) ** 2).sum(axis=1)
    frame = bundle.observations.frame
    per_view = np.sqrt(np.bincount(frame, squares) / np.bincount(frame))
    boards = zip(common, geometry.board_rotation, geometry.board_translation_mm, strict=True)
    return _Solution(
        Pose(geometry.cam_rotation[1], geometry.cam_translation_mm[1]),
        float(np.sqrt(squares.mean())),
        {f: float(e) for f, e in zip(common, per_view, strict=True)},
        {f: Pose(rotation, translation) for f, rotation, translation in boards},
    )


def _collect_observations(
    detections: BoardDetections,
    first: MonocularCalibration,
    second: MonocularCalibration,
    common: SharedCorners,
) -> Observations:
    """Return the shared corners in both images."""
    return Observations.from_views(
        (index, frame, ids, view.pixels[np.searchsorted(view.ids, ids)])
        for frame, (name, shared) in enumerate(common.items())
        for index, (camera, ids) in enumerate(zip((first, second), shared, strict=True))
        for view in (detections.views[camera.camera.name][name],)
    )


def _make_prior(first: MonocularCalibration, second: MonocularCalibration, board_mm: Array) -> BundlePrior:
    """Return a prior that fixes lenses and board."""
    cameras = first.camera, second.camera
    lenses, models = stack_intrinsics(cameras), tuple(camera.model for camera in cameras)
    width = lenses.shape[1]
    none = np.zeros((2, width, width)), np.zeros((2, width), bool)
    return BundlePrior(models, lenses, *none, board_mm, np.zeros(3))


def _initialise_geometry(
    first: MonocularCalibration, second: MonocularCalibration, board_mm: Array, frames: Sequence[str]
) -> Geometry:
    """Return the medoid of the frames' relative poses, with the board's poses of the first camera."""
    boards = [first.cam_from_board[frame] for frame in frames]
    pair = _select_medoid(
        [second.cam_from_board[f] @ board.inverse() for f, board in zip(frames, boards, strict=True)],
        float(np.median([np.linalg.norm(board.translation_mm) for board in boards])),
    )
    return Geometry(
        stack_intrinsics([first.camera, second.camera]),
        np.stack([np.eye(3), pair.rotation]),
        np.stack([np.zeros(3), pair.translation_mm]),
        np.stack([board.rotation for board in boards]),
        np.stack([board.translation_mm for board in boards]),
        board_mm,
    )


def _select_medoid(poses: Sequence[Pose], distance_mm: float) -> Pose:
    """Return the medoid of poses; rotations are weighted by the displacement that they cause at a distance."""
    features = np.stack(
        [np.concatenate([distance_mm * pose.rotation.ravel(), pose.center_mm]) for pose in poses]
    )
    apart = np.linalg.norm(features[:, None] - features[None], axis=2)
    return poses[int(np.argmin(apart.sum(axis=1)))]
