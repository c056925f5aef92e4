"""Robust bundle adjustment of the hierarchy's rig, its lenses and the board's shape.

It starts with observations, geometry and prior from the hierarchy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.network.two_sides import compute_place_sigma
from beltscape.calibration.solver.bundle import (
    Bundle,
    Geometry,
    Indices,
    Observations,
    compute_student_weights,
    estimate_student_sigma,
    select_corners,
)
from beltscape.calibration.solver.lens import (
    compute_lens_prior,
    list_parameters,
    pad_rows,
    stack_intrinsics,
    unpack_intrinsics,
)
from beltscape.calibration.solver.levenberg_marquardt import (
    Damping,
    LinearisedBundle,
    minimise,
    single_thread,
)
from beltscape.calibration.solver.prior import RIGID_SIGMA_MM, BundlePrior, build_loose_modes
from beltscape.core.arrays import Array
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import Board, BoardSet, corner_points_mm

SHAPE_SIGMA_SHARE = 0.002
"""Prior standard deviation of a corner about its nominal position, over the board's diagonal."""


def collect_observations(
    hierarchy: HierarchyResult, detections: BoardDetections, names: tuple[str, ...]
) -> tuple[tuple[str, ...], Observations]:
    """Return the frames and corners of some cameras, which are numbered in the given order."""
    frames: list[str] = []
    views: list[tuple[int, int, Indices, Array]] = []
    for frame in detections.frames:
        seeing = [
            name for name in names if frame in detections.views[name] and _is_used(hierarchy, name, frame)
        ]
        for name in seeing:
            corners = detections.views[name][frame]
            views.append((names.index(name), len(frames), corners.ids, corners.pixels))
        if seeing:
            frames.append(frame)
    return tuple(frames), Observations.from_views(views)


def _is_used(hierarchy: HierarchyResult, name: str, frame: str) -> bool:
    return frame not in hierarchy.monocular[name].rejected


def initialise_geometry(
    hierarchy: HierarchyResult, observations: Observations, frames: Sequence[str], board_mm: Array
) -> Geometry:
    """Return the hierarchy's rig with the boards at the poses that all cameras together give."""
    rig = hierarchy.rig
    boards = [_find_board_pose(hierarchy, frame) for frame in frames]
    start = Geometry(
        intrinsics=stack_intrinsics(rig.cameras.values()),
        cam_rotation=np.stack([rig.cam_from_core[name].rotation for name in rig.cameras]),
        cam_translation_mm=np.stack([rig.cam_from_core[name].translation_mm for name in rig.cameras]),
        board_rotation=np.stack([pose.rotation for pose in boards]),
        board_translation_mm=np.stack([pose.translation_mm for pose in boards]),
        points_mm=board_mm,
    )
    return minimise(Bundle(observations, _fix_rig(rig, board_mm)), start, Damping(tolerance=1e-6)).state


def _find_board_pose(hierarchy: HierarchyResult, frame: str) -> Pose:
    """Return core_from_board of a frame by the camera that sees the most corners."""
    name = max(
        (name for name in hierarchy.rig.cameras if frame in hierarchy.monocular[name].cam_from_board),
        key=lambda name: len(hierarchy.detections.views[name][frame]),
    )
    seen = hierarchy.monocular[name].cam_from_board[frame]
    return hierarchy.rig.cam_from_core[name].inverse() @ seen


def _fix_rig(rig: Rig, board_mm: Array) -> BundlePrior:
    """Return the prior that leaves only the board's poses free."""
    models = tuple(camera.model for camera in rig.cameras.values())
    lenses = stack_intrinsics(rig.cameras.values())
    cameras, width = lenses.shape
    free, information = np.zeros((cameras, width), bool), np.zeros((cameras, width, width))
    poses = tuple(range(cameras))
    return BundlePrior(models, lenses, information, free, board_mm, np.zeros(3), poses)


def get_monocular_sigma(hierarchy: HierarchyResult) -> Array:
    """Return the noise (C,) of a corner's coordinate, px, that each camera alone has."""
    return np.array([hierarchy.monocular[name].rms_px / np.sqrt(2) for name in hierarchy.rig.cameras])


def make_prior(hierarchy: HierarchyResult, board_mm: Array) -> BundlePrior:
    """Return the prior of lenses and board: given lenses, lenses in general, and the board's drawing."""
    cameras = hierarchy.rig.cameras
    priors = [_find_lens_prior(hierarchy.monocular[name], camera) for name, camera in cameras.items()]
    free = [
        np.array([each not in hierarchy.monocular[name].fixed for each in list_parameters(camera.model)])
        for name, camera in cameras.items()
    ]
    diagonal = float(np.linalg.norm(np.ptp(board_mm, axis=0)))
    return BundlePrior(
        tuple(camera.model for camera in cameras.values()), pad_rows(mean for mean, _ in priors),
        pad_rows(information for _, information in priors), pad_rows(free),
        board_mm, np.full(3, SHAPE_SIGMA_SHARE * diagonal),
        tuple(i for i, name in enumerate(cameras) if name in hierarchy.fixed_poses),
    )  # fmt: skip


def _find_lens_prior(monocular: MonocularCalibration, camera: Camera) -> tuple[Array, Array]:
    """Return mean and information of a camera's intrinsics: of an earlier calibration, or of lenses in general."""
    return monocular.prior.compute_information() if monocular.prior else compute_lens_prior(camera)


ROBUST_ROUNDS = 4
"""Rounds of reweighting with Student's t."""
NEAR = Damping(start=1e-9)
"""Damping from a start near the minimum: the usual start value of 1e-4 takes two steps more."""
REWEIGHTED = Damping(start=1e-7, tolerance=1e-5)
"""Damping of a round of reweighting, whose minimum the next round moves by more than this tolerance."""
MAX_NOISE_RATIO = 1.5
"""Largest ratio of a camera's noise to the rig's, and of the rig's to a camera's."""
MISFIT_FACTOR, MISFIT_PX = 1.6, 0.15
"""A camera is not synchronous if its residuals in the rig exceed its own by this factor, and exceed this many px."""
SIGNIFICANT, SUSPECT = 2.0, 1.0
"""Least variance of the board's shape over that of its noise for the shape to be adjusted, and to be looked into:
before it is adjusted, the noise is estimated too high by what the shape adds to the residuals."""


@dataclass(frozen=True, slots=True, eq=False)
class BundleAdjustmentResult:
    """Result of the bundle adjustment."""

    rig: Rig
    bundle: Bundle
    geometry: Geometry
    frames: tuple[str, ...]
    """Frames in the order of the geometry's board poses."""
    used: NDArray[np.bool_]
    """(N,) which corners the final adjustment used."""
    sigma_px: Array
    """(C,) one standard deviation of a corner's coordinate, by camera."""
    shape_mm: Array
    """(P, 3) the board's corners minus their nominal positions; 0 in axes without significant deviation. Boards of
    a set whose place was estimated are taken where the adjustment finds them."""
    own_view_cameras: tuple[str, ...]
    """Cameras whose intrinsics follow from their own views, because the cameras' views are inconsistent."""

    def linearise(self) -> LinearisedBundle:
        """Return the normal equations at the final geometry, which give the covariance."""
        return self.bundle.linearise(self.geometry)

    def count_used_corners(self) -> dict[tuple[str, str], int]:
        """Return (camera, frame) → corners that the final adjustment used."""
        observed, frames = self.bundle.observations, len(self.frames)
        view = observed.camera * frames + observed.frame
        counts = np.bincount(view[self.used], minlength=len(self.rig.cameras) * frames)
        return {
            (name, frame): int(counts[i * frames + k])
            for i, name in enumerate(self.rig.cameras)
            for k, frame in enumerate(self.frames)
        }


def adjust_bundle(hierarchy: HierarchyResult, board: Board) -> BundleAdjustmentResult:
    """Adjust intrinsics, camera poses, board poses and, where it deviates from the drawing, the board's shape.

    Student weights on all corners come first, with the shape if the boards deviate from the drawing, so that a warped
    board is not mistaken for outliers. Then corners beyond 4.5 standard deviations are removed, and the others have
    full weight. If the cameras fit far worse together than each does alone (they are not synchronous), the lens
    estimate from a camera's own views enters as a prior, so that the inconsistency does not distort the lens.
    """
    board_mm, detections = corner_points_mm(board), hierarchy.detections
    with single_thread():
        frames, observations = collect_observations(hierarchy, detections, tuple(hierarchy.rig.cameras))
        geometry = initialise_geometry(hierarchy, observations, frames, board_mm)
        prior = make_prior(hierarchy, board_mm)
        if isinstance(board, BoardSet):
            corners, sigma = board.list_loose_corners(), compute_place_sigma(board)
            prior = replace(prior, loose_corners=corners, loose_sigma=sigma)
        bundle, geometry, sigma = _fit_shape(observations, prior, geometry, get_monocular_sigma(hierarchy))
        own_view_cameras = _find_misfitting(hierarchy, sigma)
        # the disagreement of asynchronous cameras concerns all of them equally, so all get the same noise
        spread = 1.0 if own_view_cameras else MAX_NOISE_RATIO
        if own_view_cameras:
            prior = _add_monocular_priors(prior, hierarchy, detections, own_view_cameras, board_mm)
            bundle, geometry, sigma = _fit_shape(observations, prior, geometry, sigma, spread)
        shape_sigma = _estimate_shape_sigma(bundle, geometry) if bundle.adjusts_shape else np.zeros(3)
        prior = replace(prior, points_sigma_mm=np.maximum(shape_sigma, _get_rigid_sigma(prior)))
        flat = np.where(prior.points_sigma_mm > 0, geometry.points_mm, board_mm)
        bundle, geometry, kept = _fit_final(
            observations, prior, replace(geometry, points_mm=flat), sigma, spread
        )
    rig = _make_rig(hierarchy.rig, geometry)
    sigma = np.array(
        [bundle.observations.sigma_px[observations.camera == c][0] for c in range(len(rig.cameras))]
    )
    shape_mm = _compute_shape(prior, geometry) if shape_sigma.any() else np.zeros_like(board_mm)
    return BundleAdjustmentResult(rig, bundle, geometry, frames, kept, sigma, shape_mm, own_view_cameras)


def _get_rigid_sigma(prior: BundlePrior) -> Array:
    """Return the standard deviation (3,) of the corners of boards that keep their shapes; 0 where none is loose."""
    return np.full(3, RIGID_SIGMA_MM if prior.loose_corners else 0.0)


def _compute_shape(prior: BundlePrior, geometry: Geometry) -> Array:
    """Return how far (P, 3) the corners are off the drawing, without what loose boards moved as a whole."""
    off = geometry.points_mm - prior.points_mm
    if not prior.loose_corners:
        return off
    modes = build_loose_modes(prior)
    return off - (np.linalg.lstsq(modes.T, off.ravel())[0] @ modes).reshape(off.shape)


def _fit_shape(
    observations: Observations,
    prior: BundlePrior,
    geometry: Geometry,
    sigma: Array,
    spread: float = MAX_NOISE_RATIO,
) -> tuple[Bundle, Geometry, Array]:
    """Adjust with Student's weights, with the board's shape only if one more step shows that it deviates."""
    plain = replace(prior, points_sigma_mm=_get_rigid_sigma(prior))
    start = replace(geometry, points_mm=prior.points_mm)
    bundle, geometry, sigma = _fit_robust(observations, plain, start, sigma, spread)
    shaped = Bundle(bundle.observations, prior, bundle.weights)
    step = shaped.linearise(geometry).solve_step(0.0)
    if not _estimate_shape_sigma(shaped, shaped.apply_step(geometry, step), SUSPECT).any():
        return bundle, geometry, sigma
    return _fit_robust(observations, prior, geometry, sigma, spread)


def _fit_robust(
    observations: Observations,
    prior: BundlePrior,
    geometry: Geometry,
    sigma: Array,
    spread: float = MAX_NOISE_RATIO,
) -> tuple[Bundle, Geometry, Array]:
    """Adjust with Student's weights on all corners; return bundle, geometry and each camera's noise."""
    bundle = Bundle(observations, prior)
    for _ in range(ROBUST_ROUNDS):
        squared = (bundle.compute_errors_px(geometry) ** 2).sum(axis=1) / sigma[observations.camera] ** 2
        bundle = Bundle(_set_sigma(observations, sigma), prior, compute_student_weights(squared))
        geometry = minimise(bundle, geometry, REWEIGHTED).state
        sigma = estimate_student_sigma(bundle, geometry, sigma, spread)
    return bundle, geometry, sigma


def _fit_final(
    observations: Observations, prior: BundlePrior, geometry: Geometry, sigma: Array, spread: float
) -> tuple[Bundle, Geometry, NDArray[np.bool_]]:
    """Adjust without outliers, all other corners at full weight; return bundle, geometry and accepted corners."""
    kept = np.ones(len(observations.pixels), bool)
    bundle = Bundle(_set_sigma(observations, sigma), prior)
    for _ in range(3):
        kept, sigma = select_corners(bundle, geometry, spread)
        bundle = Bundle(_set_sigma(observations, sigma), prior, kept.astype(np.float64))
        geometry = minimise(bundle, geometry, NEAR).state
    return bundle, geometry, kept


def _find_misfitting(hierarchy: HierarchyResult, sigma: Array) -> tuple[str, ...]:
    monocular_sigma = get_monocular_sigma(hierarchy)
    return tuple(
        name
        for i, name in enumerate(hierarchy.rig.cameras)
        if sigma[i] > MISFIT_FACTOR * monocular_sigma[i]
        and sigma[i] > MISFIT_PX
        and set(hierarchy.monocular[name].fixed) < set(list_parameters(hierarchy.rig.cameras[name].model))
    )


def _add_monocular_priors(
    prior: BundlePrior,
    hierarchy: HierarchyResult,
    detections: BoardDetections,
    names: Sequence[str],
    board_mm: Array,
) -> BundlePrior:
    """Return the prior with the lens estimates from each camera's own views."""
    means, informations = prior.intrinsics.copy(), prior.intrinsics_information.copy()
    for i, name in enumerate(hierarchy.rig.cameras):
        if name not in names:
            continue
        frames, observations = collect_observations(hierarchy, detections, (name,))
        poses = [hierarchy.monocular[name].cam_from_board[frame] for frame in frames]
        lens = prior.intrinsics[i : i + 1], prior.intrinsics_information[i : i + 1]
        lens_prior = BundlePrior(
            prior.models[i : i + 1], *lens, prior.intrinsics_free[i : i + 1], board_mm, np.zeros(3)
        )
        start = Geometry(
            stack_intrinsics(hierarchy.rig.cameras.values())[i : i + 1], np.eye(3)[None], np.zeros((1, 3)),
            np.stack([pose.rotation for pose in poses]), np.stack([pose.translation_mm for pose in poses]), board_mm,
        )  # fmt: skip
        bundle, geometry, _ = _fit_robust(
            observations, lens_prior, start, get_monocular_sigma(hierarchy)[i : i + 1]
        )
        free = np.flatnonzero(prior.intrinsics_free[i])
        means[i] = geometry.intrinsics[0]
        informations[i] = 0.0
        informations[i][np.ix_(free, free)] = np.linalg.inv(bundle.linearise(geometry).covariance())
    return replace(prior, intrinsics=means, intrinsics_information=informations)


def _set_sigma(observations: Observations, sigma: Array) -> Observations:
    return replace(observations, sigma_px=sigma[observations.camera])


def _estimate_shape_sigma(bundle: Bundle, geometry: Geometry, least: float = SIGNIFICANT) -> Array:
    """Return the standard deviation (3,) of the board's shape in x, y, z beyond noise; 0 if it is not significant.

    It is significant if its variance exceeds that of the noise ``least`` times.

    It is estimated from the corners that the images determine far better than the prior does.
    """
    deviation = _compute_shape(bundle.prior, geometry)
    variance = np.diag(bundle.linearise(geometry).covariance())[-deviation.size :].reshape(-1, 3)
    informed = variance < 0.1 * bundle.prior.points_sigma_mm**2
    weights = np.where(informed, variance**-2.0, 0.0)
    total = np.maximum(weights.sum(axis=0), 1e-300)
    excess = (weights * (deviation**2 - variance)).sum(axis=0) / total
    noise = (weights * variance).sum(axis=0) / total
    return np.where(excess > least * noise, np.sqrt(np.maximum(excess, 0)), 0.0)


def _make_rig(rig: Rig, geometry: Geometry) -> Rig:
    cameras = {
        name: unpack_intrinsics(camera, values)
        for (name, camera), values in zip(rig.cameras.items(), geometry.intrinsics, strict=True)
    }
    poses = {
        name: Pose(rotation, translation)
        for name, rotation, translation in zip(
            rig.cameras, geometry.cam_rotation, geometry.cam_translation_mm, strict=True
        )
    }
    poses[rig.core] = Pose.identity()
    return Rig(rig.core, cameras, poses)
