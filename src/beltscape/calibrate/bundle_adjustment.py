"""The final rig: bundle adjustment of everything the hierarchy found, robust, with the board's own shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.detection.corners import BoardDetections
from beltscape.calibrate.hierarchy import HierarchyResult
from beltscape.calibrate.intrinsics.zhang import PARAMETERS
from beltscape.calibrate.network.resection import fit_board_pose
from beltscape.calibrate.solver.bundle import INTRINSICS, Bundle
from beltscape.calibrate.solver.bundle_data import BundlePrior, Geometry, Observations
from beltscape.calibrate.solver.deterministic import single_thread
from beltscape.calibrate.solver.lens import compute_lens_prior, pack_intrinsics
from beltscape.calibrate.solver.levenberg_marquardt import Damping, minimise
from beltscape.calibrate.solver.schur import LinearisedBundle
from beltscape.core.camera import Camera
from beltscape.core.pose import Pose
from beltscape.core.rig import Rig
from beltscape.target.board import Board, corner_points_mm

Array = NDArray[np.float64]

STUDENT_DOF = 5.0
"""Student's t with so many degrees of freedom weighs corners while the board's shape is found."""
MAX_DEVIATION = 4.5
"""Corners farther off than so many standard deviations are left out of the final adjustment."""
MIN_SHARE = 0.5
"""A view keeps at least this share of its corners, or none."""
ROBUST_ROUNDS = 4
MAX_NOISE_RATIO = 1.5
"""A camera is no more than this factor noisier, or quieter, than the rig."""
MISFIT_FACTOR, MISFIT_PX = 1.6, 0.15
"""A camera whose corners scatter by this factor, and this much, more in the rig than alone is not synchronous."""
SHAPE_SIGMA_SHARE = 0.002
"""How far, over the board's diagonal, corners may lie off their nominal place before the data have spoken."""


@dataclass(frozen=True, slots=True, eq=False)
class BundleAdjustmentResult:
    """A rig from the joint adjustment."""

    rig: Rig
    bundle: Bundle
    geometry: Geometry
    frames: tuple[str, ...]
    """Frames in the order of the geometry's board poses."""
    kept: NDArray[np.bool_]
    """(N,) corners that were used."""
    sigma_px: Array
    """(C,) one standard deviation of a corner's coordinate, by camera."""
    shape_mm: Array
    """(P, 3) the board's corners minus their nominal places; 0 where the board was found to be as drawn."""
    own_view_cameras: tuple[str, ...]
    """Cameras whose intrinsics rest on their own views, because the views do not fit together."""

    def linearise(self) -> LinearisedBundle:
        """The normal equations at the end, which hold the covariance."""
        return self.bundle.linearise(self.geometry)


def adjust_bundle(hierarchy: HierarchyResult, board: Board) -> BundleAdjustmentResult:
    """Adjust intrinsics, camera poses, board poses and, where it differs from the drawing, the board's shape.

    The shape is found first, with Student weights on all corners, so that a warped board is not mistaken for
    outliers; then corners beyond 4.5 standard deviations go, and the rest counts in full. Where the cameras fit far
    worse together than each does alone (they are not synchronous), what a camera's own views say of its lens
    enters as a weighted prior, so that the misfit does not bend the lens.
    """
    board_mm, detections = corner_points_mm(board), hierarchy.detections
    with single_thread():
        frames, observations = _collect_observations(hierarchy, detections, tuple(hierarchy.rig.cameras))
        geometry = _initialise_geometry(hierarchy, detections, frames, board_mm)
        prior = _make_prior(hierarchy, board_mm)
        bundle, geometry, sigma = _fit_robust(observations, prior, geometry, _get_monocular_sigma(hierarchy))
        own_view_cameras = _find_misfitting(hierarchy, sigma)
        # what asynchronous cameras disagree by belongs to all of them: none is quieter than another
        spread = 1.0 if own_view_cameras else MAX_NOISE_RATIO
        if own_view_cameras:
            prior = _add_monocular_priors(prior, hierarchy, detections, own_view_cameras, board_mm)
            bundle, geometry, sigma = _fit_robust(observations, prior, geometry, sigma, spread)
        prior = replace(prior, points_sigma_mm=_estimate_shape_sigma(bundle, geometry))
        flat = np.where(prior.points_sigma_mm > 0, geometry.points_mm, board_mm)
        bundle, geometry, kept = _fit_final(
            observations, prior, replace(geometry, points_mm=flat), sigma, spread
        )
    rig = _make_rig(hierarchy.rig, geometry)
    sigma = np.array(
        [bundle.observations.sigma_px[observations.camera == c][0] for c in range(len(rig.cameras))]
    )
    return BundleAdjustmentResult(
        rig, bundle, geometry, frames, kept, sigma, geometry.points_mm - board_mm, own_view_cameras
    )


def _fit_robust(
    observations: Observations,
    prior: BundlePrior,
    geometry: Geometry,
    sigma: Array,
    spread: float = MAX_NOISE_RATIO,
) -> tuple[Bundle, Geometry, Array]:
    """Everything with Student's weights: nothing is thrown away yet."""
    bundle = Bundle(observations, prior)
    for _ in range(ROBUST_ROUNDS):
        squared = (bundle.compute_errors_px(geometry) ** 2).sum(axis=1) / sigma[observations.camera] ** 2
        weights = (STUDENT_DOF + 2) / (STUDENT_DOF + squared)
        bundle = Bundle(_set_sigma(observations, sigma), prior, weights)
        geometry = minimise(bundle, geometry, Damping(tolerance=1e-6)).state
        sigma = _estimate_student_sigma(bundle, geometry, sigma, spread)
    return bundle, geometry, sigma


def _fit_final(
    observations: Observations, prior: BundlePrior, geometry: Geometry, sigma: Array, spread: float
) -> tuple[Bundle, Geometry, NDArray[np.bool_]]:
    """Without outliers, the rest in full."""
    kept = np.ones(len(observations.pixels), bool)
    bundle = Bundle(_set_sigma(observations, sigma), prior)
    for _ in range(3):
        kept, sigma = _select_corners(bundle, geometry, spread)
        bundle = Bundle(_set_sigma(observations, sigma), prior, kept.astype(np.float64))
        geometry = minimise(bundle, geometry).state
    return bundle, geometry, kept


def _find_misfitting(hierarchy: HierarchyResult, sigma: Array) -> tuple[str, ...]:
    own = _get_monocular_sigma(hierarchy)
    return tuple(
        name
        for i, name in enumerate(hierarchy.rig.cameras)
        if sigma[i] > MISFIT_FACTOR * own[i]
        and sigma[i] > MISFIT_PX
        and len(hierarchy.monocular[name].held) < INTRINSICS
    )


def _add_monocular_priors(
    prior: BundlePrior,
    hierarchy: HierarchyResult,
    detections: BoardDetections,
    names: Sequence[str],
    board_mm: Array,
) -> BundlePrior:
    """The prior with what each camera's own views, taken alone, say of its lens."""
    means, informations = prior.intrinsics.copy(), prior.intrinsics_information.copy()
    for i, name in enumerate(hierarchy.rig.cameras):
        if name not in names:
            continue
        frames, seen = _collect_observations(hierarchy, detections, (name,))
        poses = [hierarchy.monocular[name].cam_from_board[frame] for frame in frames]
        lens = prior.intrinsics[i : i + 1], prior.intrinsics_information[i : i + 1]
        own = BundlePrior(*lens, prior.intrinsics_free[i : i + 1], board_mm, np.zeros(3))
        start = Geometry(
            pack_intrinsics(hierarchy.rig.cameras[name])[None], np.eye(3)[None], np.zeros((1, 3)),
            np.stack([pose.rotation for pose in poses]), np.stack([pose.translation_mm for pose in poses]), board_mm,
        )  # fmt: skip
        bundle, geometry, _ = _fit_robust(seen, own, start, _get_monocular_sigma(hierarchy)[i : i + 1])
        free = np.flatnonzero(prior.intrinsics_free[i])
        means[i] = geometry.intrinsics[0]
        informations[i] = 0.0
        informations[i][np.ix_(free, free)] = np.linalg.inv(bundle.linearise(geometry).covariance())
    return replace(prior, intrinsics=means, intrinsics_information=informations)


def _collect_observations(
    hierarchy: HierarchyResult, detections: BoardDetections, names: tuple[str, ...]
) -> tuple[tuple[str, ...], Observations]:
    """Corners of some cameras, numbered in that order, frame by frame."""
    frames: list[str] = []
    rows: list[tuple[Array, ...]] = []
    for frame in detections.frames:
        seen = [
            name for name in names if frame in detections.views[name] and _is_used(hierarchy, name, frame)
        ]
        for name in seen:
            corners = detections.views[name][frame]
            count = len(corners)
            index = np.full(count, names.index(name)), np.full(count, len(frames))
            rows.append((*index, corners.ids, corners.pixels))
        if seen:
            frames.append(frame)
    camera, frame_index, point, pixels = (np.concatenate(column) for column in zip(*rows, strict=True))
    return tuple(frames), Observations(camera, frame_index, point, pixels, np.ones(len(pixels)))


def _is_used(hierarchy: HierarchyResult, name: str, frame: str) -> bool:
    return frame not in hierarchy.monocular[name].rejected


def _initialise_geometry(
    hierarchy: HierarchyResult, detections: BoardDetections, frames: Sequence[str], board_mm: Array
) -> Geometry:
    rig = hierarchy.rig
    boards = []
    for frame in frames:
        views = {
            name: detections.views[name][frame]
            for name in rig.cameras
            if frame in detections.views[name] and _is_used(hierarchy, name, frame)
        }
        boards.append(fit_board_pose(rig, views, board_mm))
    return Geometry(
        intrinsics=np.stack([pack_intrinsics(camera) for camera in rig.cameras.values()]),
        cam_rotation=np.stack([rig.cam_from_core[name].rotation for name in rig.cameras]),
        cam_translation_mm=np.stack([rig.cam_from_core[name].translation_mm for name in rig.cameras]),
        board_rotation=np.stack([pose.rotation for pose in boards]),
        board_translation_mm=np.stack([pose.translation_mm for pose in boards]),
        points_mm=board_mm,
    )


def _get_monocular_sigma(hierarchy: HierarchyResult) -> Array:
    return np.array([hierarchy.monocular[name].rms_px / np.sqrt(2) for name in hierarchy.rig.cameras])


def _make_prior(hierarchy: HierarchyResult, board_mm: Array) -> BundlePrior:
    cameras = hierarchy.rig.cameras
    priors = [compute_lens_prior(camera) for camera in cameras.values()]
    free = np.ones((len(cameras), INTRINSICS), bool)
    for i, name in enumerate(cameras):
        free[i] = [parameter not in hierarchy.monocular[name].held for parameter in PARAMETERS]
    diagonal = float(np.linalg.norm(np.ptp(board_mm, axis=0)))
    return BundlePrior(
        np.stack([mean for mean, _ in priors]), np.stack([information for _, information in priors]), free,
        board_mm, np.full(3, SHAPE_SIGMA_SHARE * diagonal),
    )  # fmt: skip


def _set_sigma(observations: Observations, sigma: Array) -> Observations:
    return replace(observations, sigma_px=sigma[observations.camera])


def _estimate_student_sigma(bundle: Bundle, geometry: Geometry, sigma: Array, spread: float) -> Array:
    """(C,) the scale that fits Student's t to each camera's errors: one step of expectation-maximisation."""
    camera = bundle.observations.camera
    squared = (bundle.compute_errors_px(geometry) ** 2).sum(axis=1)
    weights = (STUDENT_DOF + 2) / (STUDENT_DOF + squared / sigma[camera] ** 2)
    total = np.bincount(camera, weights * squared, minlength=len(sigma))
    count = 2 * np.bincount(camera, minlength=len(sigma)).clip(1)
    return _limit_spread(np.sqrt(total / count), count, spread)


def _limit_spread(sigma: Array, count: Array, spread: float) -> Array:
    """Each camera's noise, held within a factor ``spread`` of the rig's.

    Left alone, one camera's noise shrinks for ever: the more it is trusted, the better boards and shape fit it.
    """
    pooled = float(np.sqrt((count * sigma**2).sum() / count.sum()))
    return np.clip(sigma, pooled / spread, pooled * spread)


def _estimate_shape_sigma(bundle: Bundle, geometry: Geometry) -> Array:
    """(3,) how far the corners really lie from the drawing in x, y, z, beyond what noise explains; 0: they do not.

    Asked of the corners that the images determine far better than the prior does.
    """
    deviation = geometry.points_mm - bundle.prior.points_mm
    variance = np.diag(bundle.linearise(geometry).covariance())[-deviation.size :].reshape(-1, 3)
    informed = variance < 0.1 * bundle.prior.points_sigma_mm**2
    weights = np.where(informed, variance**-2.0, 0.0)
    total = np.maximum(weights.sum(axis=0), 1e-300)
    excess = (weights * (deviation**2 - variance)).sum(axis=0) / total
    noise = (weights * variance).sum(axis=0) / total
    return np.where(excess > 2 * noise, np.sqrt(np.maximum(excess, 0)), 0.0)


def _select_corners(bundle: Bundle, geometry: Geometry, spread: float) -> tuple[NDArray[np.bool_], Array]:
    """Corners to keep, and each camera's noise from those kept, corrected for what was fitted to them."""
    errors, camera = bundle.compute_errors_px(geometry), bundle.observations.camera
    cameras = len(geometry.intrinsics)
    robust = np.array([1.4826 * np.median(np.abs(errors[camera == c])) for c in range(cameras)])
    robust = _limit_spread(robust, np.bincount(camera, minlength=cameras), spread)
    kept = _mask_whole_views(
        np.linalg.norm(errors, axis=1) < MAX_DEVIATION * robust[camera], bundle.observations
    )
    fitted = len(bundle.free) + 6 * len(geometry.board_rotation)
    share = 1 - fitted / max(2 * int(kept.sum()), fitted + 1)
    sigma = np.array([np.sqrt((errors[kept & (camera == c)] ** 2).mean() / share) for c in range(cameras)])
    return kept, _limit_spread(sigma, np.bincount(camera[kept], minlength=cameras), spread)


def _mask_whole_views(kept: NDArray[np.bool_], observations: Observations) -> NDArray[np.bool_]:
    """Without what is left of views that lost most of their corners: the board was elsewhere, the rest is chance."""
    view = observations.frame * (observations.camera.max() + 1) + observations.camera
    share = np.bincount(view, kept) / np.bincount(view).clip(1)
    return kept & (share[view] >= MIN_SHARE)


def _make_rig(rig: Rig, geometry: Geometry) -> Rig:
    cameras = {
        name: Camera(name, camera.size_px, values[:2].copy(), values[2:4].copy(), values[4:].copy())
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
