"""Covariance of a calibrated rig, and its propagation to the standard deviation of triangulated depths.

A jackknife over the distinct positions of the board inflates it if the views scatter by more than their noise; frames
of a board at rest are one position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.solver.bundle import Bundle, ViewDesign
from beltscape.calibration.solver.lens import (
    PINHOLE,
    differentiate_by_pose,
    list_parameters,
    pack_intrinsics,
    project_with_jacobians,
)
from beltscape.calibration.solver.levenberg_marquardt import LinearisedBundle, single_thread
from beltscape.core.arrays import Array, Mask
from beltscape.core.geometry.lens import list_intrinsics
from beltscape.core.geometry.rig import Rig

SAME_POSITION = 0.02
"""Two frames show one position if the board's corners moved by less, RMS, than this share of the board's diagonal."""


def group_frames(adjustment: BundleAdjustmentResult) -> dict[int, int]:
    """Return frame index → number of its position, for the frames that the final adjustment used."""
    geometry = adjustment.geometry
    frames = np.unique(adjustment.bundle.observations.frame[adjustment.used])
    corners = geometry.points_mm @ geometry.board_rotation[frames].swapaxes(1, 2)
    corners = corners + geometry.board_translation_mm[frames][:, None]
    limit_mm = SAME_POSITION * float(np.linalg.norm(np.ptp(geometry.points_mm, axis=0)))
    group: NDArray[np.intp] = np.arange(len(frames))
    for i in range(1, len(frames)):
        moved_mm = np.sqrt(((corners[:i] - corners[i]) ** 2).sum(axis=2).mean(axis=1))
        joined = np.unique(group[np.append(np.flatnonzero(moved_mm < limit_mm), i)])
        group[np.isin(group, joined)] = joined[0]
    numbers = np.unique(group, return_inverse=True)[1]
    return {int(frame): int(number) for frame, number in zip(frames, numbers, strict=True)}


def count_positions(adjustment: BundleAdjustmentResult) -> int:
    """Return the number of positions of the board that the final adjustment used."""
    return len(set(group_frames(adjustment).values()))


CONFIDENCE = 0.99
"""Probability of a smaller scatter from noise alone above which the views are taken to disagree."""
MIN_POSITIONS = 3
"""Least number of board positions for a scatter."""


def estimate_inflation(without: Array, covariance: Array, jacobian: Array) -> float:
    """Return the ratio of the scatter between frames to the formal standard deviations; 1 if not significant.

    The formal covariance takes the corners' noise as independent. It is too small if all corners of a frame share
    errors: from a board that bends between views, a lens that the model does not describe, cameras that are not quite
    synchronous. Leaving out one position of the board at a time needs no such assumption (Efron & Stein 1981,
    doi:10.1214/aos/1176345462): the variance is (F − 1)/F·Σ(d_f − d̄)².

    Parameters
    ----------
    without
        (F, R) changes of the free parameters of the cameras without each position (`leave_out_positions`).
    covariance
        (R, R) formal covariance of these parameters.
    jacobian
        (N, R) derivatives of the N quantities of interest by them.
    """
    frames = len(without)
    if frames < MIN_POSITIONS:
        return 1.0
    scatter = float((compute_scatter(without @ jacobian.T) ** 2).sum())
    ratio = scatter / np.einsum("ni,ij,nj->", jacobian, covariance, jacobian)
    dof = frames - 1
    most = 2 * gammaincinv(dof / 2, CONFIDENCE) / dof  # quantile of χ², over its degrees of freedom
    return float(np.sqrt(ratio)) if ratio > most else 1.0


def compute_scatter(without: Array) -> Array:
    """Return the standard deviation (N,) of quantities by their values (F, N) without each position of the board."""
    frames = len(without)
    return np.sqrt((frames - 1) / frames * ((without - without.mean(axis=0)) ** 2).sum(axis=0))


def leave_out_positions(adjustment: BundleAdjustmentResult, count: int) -> Array:
    """Return the change (F, R) of the cameras' free parameters without a position of the board, to first order.

    Frames of one position share their errors; they are left out together if there are three positions or more.
    """
    bundle, positions = adjustment.bundle, _number_positions(adjustment)
    position = np.array([positions.get(int(frame), -1) for frame in bundle.observations.frame])
    changes: list[Array] = []
    with single_thread():
        for each in np.unique(position[adjustment.used]):
            weights = (adjustment.used & (position != each)).astype(np.float64)
            rest = Bundle(bundle.observations, bundle.prior, weights)
            changes.append(rest.linearise(adjustment.geometry).solve_step(0.0)[:count])
    return np.array(changes)


def _number_positions(adjustment: BundleAdjustmentResult) -> dict[int, int]:
    """Return frame index → number of its position; every frame is one where the board had too few."""
    positions = group_frames(adjustment)
    if len(set(positions.values())) < MIN_POSITIONS:
        return {frame: number for number, frame in enumerate(positions)}
    return positions


POSE_NAMES = ("turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_mm", "shift_y_mm", "shift_z_mm")


@dataclass(frozen=True, slots=True, eq=False)
class RigCovariance:
    """Covariance of a rig's parameters; a fixed parameter has variance 0."""

    parameters: tuple[str, ...]
    """``camera.parameter``: intrinsics of every camera, then the pose of every camera but the core.

    A pose's rotation is about the axes of the camera's own frame: ``exp(turn) @ rotation``, ``translation + shift``.
    """
    matrix: Array
    """(G, G)."""
    inflation: float
    """Factor included in the standard deviations because the views scatter by more than their noise; 1: none."""
    scatter: Array
    """(G,) standard deviation of each parameter by leaving out positions of the board; 0 for fixed ones."""
    positions: int
    """Number of positions of the board; with fewer than three the scatter is that between frames, and too small."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthSigma:
    """One standard deviation of a triangulated depth from calibration alone, over the core camera's view."""

    depth_mm: float
    x_mm: Array
    """(Nx,) in the core frame."""
    y_mm: Array
    """(Ny,)."""
    sigma_mm: Array
    """(Ny, Nx); NaN where fewer than two cameras see the point."""


def compute_rig_covariance(adjustment: BundleAdjustmentResult) -> RigCovariance:
    """Return the covariance of the cameras' parameters, all others marginalised, inflated if the views disagree."""
    cameras = list(adjustment.rig.cameras)
    names = [
        f"{name}.{parameter}"
        for name, camera in adjustment.rig.cameras.items()
        for parameter in list_intrinsics(camera.model)
    ]
    names += [
        f"{name}.{parameter}" for name in cameras if name != adjustment.rig.core for parameter in POSE_NAMES
    ]
    full = compute_formal_covariance(adjustment.rig, adjustment.bundle, adjustment.linearise())
    free = _list_free_parameters(adjustment.rig, adjustment.bundle)
    distance = float(np.median(adjustment.geometry.board_translation_mm[:, 2]))
    jacobian = compute_depth_jacobian(adjustment.rig, make_view_points(adjustment.rig, distance, 13))[:, free]
    jacobian = jacobian[np.isfinite(jacobian).all(axis=1)]
    without = leave_out_positions(adjustment, len(free))
    inflation = estimate_inflation(without, full[np.ix_(free, free)], jacobian)
    scatter = np.zeros(len(full))
    scatter[free] = compute_scatter(without)
    return RigCovariance(tuple(names), inflation**2 * full, inflation, scatter, count_positions(adjustment))


def compute_camera_covariance(adjustment: BundleAdjustmentResult) -> Array:
    """Return the covariance (W, W) of the lens of a single camera, from its corners' noise and by clusters of views.

    The model's is raised by the mean ratio of the variances of focal lengths and principal point by clusters of views
    to its own, and in each parameter to what the clusters say: these are few, so that their own matrix is uncertain.
    On photographs lenses from half the views then differ by 0.98 to 1.13 of their σ; by the model's by 1.3 to 5.
    """
    formal = compute_formal_covariance(adjustment.rig, adjustment.bundle, adjustment.linearise())
    by_views, variance = np.diag(compute_clustered_covariance(adjustment)), np.diag(formal)
    free = variance > 0
    pinhole = free & (np.arange(len(free)) < len(PINHOLE))
    ratio = float(np.mean(by_views[pinhole] / variance[pinhole])) if pinhole.any() else 1.0
    least = max(ratio, 1.0)
    growth = np.sqrt(np.where(free, np.maximum(by_views / np.where(free, variance, 1.0), least), 1.0))
    return np.asarray(formal * np.outer(growth, growth), np.float64)


def add_scale(rig: Rig, matrix: Array, scale_sigma: float) -> Array:
    """Return the covariance (G, G) of a rig's parameters with that of the size of its calibration board.

    No view determines the size, so that its certificate is all that is known: lengths scatter by ``scale_sigma``,
    their relative standard deviation, all alike, and with them the cameras' positions and every depth.
    """
    by_scale = differentiate_by_scale(rig)
    return np.asarray(matrix + scale_sigma**2 * np.outer(by_scale, by_scale), np.float64)


def differentiate_by_scale(rig: Rig) -> Array:
    """Return the derivatives (G,) of a rig's parameters by the relative size of its calibration board."""
    by_scale = np.zeros(count_parameters(rig))
    for index, name in enumerate(rig.cameras):
        if index:
            by_scale[list_parameter_columns(rig, index)[-3:]] = rig.cam_from_core[name].translation_mm
    return by_scale


def compute_formal_covariance(rig: Rig, bundle: Bundle, linear: LinearisedBundle) -> Array:
    """Return the covariance (G, G) of the cameras' parameters from the corners' noise; 0 for fixed ones."""
    return place_covariance(rig, bundle, linear.covariance())


def place_covariance(rig: Rig, bundle: Bundle, own: Array) -> Array:
    """Return (G, G) of the cameras' parameters from that of a bundle's free shared parameters; 0 for fixed ones."""
    free = _list_free_parameters(rig, bundle)
    own = own[: len(free), : len(free)]
    full = np.zeros((count_parameters(rig), count_parameters(rig)))
    full[np.ix_(free, free)] = (own + own.T) / 2
    return full


MIN_REMAINING = 1e-3
"""Least share of a view's own variance that counts as left by the adjustment: combinations of its corners that
determine its board's pose alone have no residual, and their correction would be endless."""


def compute_clustered_covariance(adjustment: BundleAdjustmentResult) -> Array:
    """Return the covariance (G, G) of the rig's parameters by clusters of views; 0 for fixed ones.

    Errors of the corners of one image are alike: blur, light, a detector's bias, a lens just outside its model. Then
    the residuals fall, for poses and lenses follow the errors, while the rig scatters more. A covariance by clusters
    (a sandwich; Bell & McCaffrey, Survey Methodology 28(2), 2002) takes each view's errors as they are: between the
    inverse normal matrices stands the sum over the views of the squared influence of their own residuals, corrected
    by (I − H)^−½ for what the view itself took from them. Views of a camera of one position of the board are one
    cluster; it assumes that clusters are independent.
    """
    bundle, positions = adjustment.bundle, _number_positions(adjustment)
    changes: dict[tuple[int, int], Array] = {}
    with single_thread():
        linear = bundle.linearise(adjustment.geometry)
        inverse, (boards, responses) = linear.covariance(), linear.invert_boards()
        for view in bundle.list_view_designs(adjustment.geometry):
            change = _compute_influence(view, inverse, boards[view.frame], responses[view.frame])
            key = view.camera, positions[view.frame]
            changes[key] = changes.get(key, np.zeros(len(change))) + change
    stacked = np.array(list(changes.values()))
    return place_covariance(adjustment.rig, bundle, stacked.T @ stacked)


def _compute_influence(view: ViewDesign, inverse: Array, board: Array, response: Array) -> Array:
    """Return the change (G,) of the shared parameters by the errors of a view, as far as its residuals show them."""
    eliminated = view.by_shared - view.by_board @ response
    gain = eliminated @ inverse
    hat = gain @ eliminated.T + view.by_board @ board @ view.by_board.T
    values, vectors = np.linalg.eigh(np.eye(len(hat)) - hat)
    roots = np.sqrt(np.maximum(values, MIN_REMAINING))
    return np.asarray(gain.T @ (vectors @ ((vectors.T @ view.residuals) / roots)), np.float64)


def compute_depth_sigma(rig: Rig, covariance: Array, depth_mm: float, *, columns: int = 31) -> DepthSigma:
    """Return σ of depths triangulated at ``depth_mm`` from the core, propagated from (G, G) to first order."""
    x, y = make_view_grid(rig, depth_mm, columns)
    jacobian = compute_depth_jacobian(rig, make_view_points(rig, depth_mm, columns))
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian))
    return DepthSigma(depth_mm, x, y, sigma.reshape(len(y), len(x)))


def make_view_grid(rig: Rig, depth_mm: float, columns: int) -> tuple[Array, Array]:
    """Return x (Nx,) and y (Ny,) of a grid over the core camera's view at a depth, mm."""
    camera = rig.core_camera
    width, height = camera.size_px
    rows = max(3, round(columns * height / width))
    first = -camera.center_px / camera.focal_px * depth_mm
    last = (np.array([width, height]) - 1 - camera.center_px) / camera.focal_px * depth_mm
    x, y = (np.linspace(float(first[i]), float(last[i]), n) for i, n in enumerate((columns, rows)))
    return x, y


def make_view_points(rig: Rig, depth_mm: float, columns: int) -> Array:
    """Return the points (Ny·Nx, 3) of `make_view_grid`, row by row, in the core frame, mm."""
    x, y = make_view_grid(rig, depth_mm, columns)
    return np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), depth_mm)], axis=-1).reshape(-1, 3)


def compute_depth_jacobian(rig: Rig, points_mm: Array) -> Array:
    """Return derivatives (N, G) of triangulated depths by the rig's parameters; NaN with fewer than two views.

    All cameras that see a point contribute: it moves by −(Σ JᵀJ)⁻¹ Σ Jᵀ ∂π/∂θ δθ if the parameters change by δθ.
    """
    count = count_parameters(rig)
    normal, mixed = np.zeros((len(points_mm), 3, 3)), np.zeros((len(points_mm), 3, count))
    visible_views = np.zeros(len(points_mm))
    for i, name in enumerate(rig.cameras):
        jacobian, by_rig, visible = differentiate_camera(rig, name, points_mm)
        jacobian = jacobian * visible[:, None, None]
        normal += np.einsum("nri,nrj->nij", jacobian, jacobian)
        columns = list_parameter_columns(rig, i)
        mixed[:, :, columns] += np.einsum("nri,nrj->nij", jacobian, by_rig[:, :, : len(columns)])
        visible_views += visible
    usable = visible_views >= 2
    jacobian = np.full((len(points_mm), count), np.nan)
    jacobian[usable] = -np.linalg.solve(normal[usable], mixed[usable])[:, 2]
    return jacobian


def compute_unit_depths(rig: Rig, points_mm: Array) -> tuple[Array, Mask]:
    """Return the depth (N,), mm, that one pixel of error in every image makes, NaN with fewer than two views.

    With it the visibility (C, N) of the points in each camera.
    """
    normal, sees = (
        np.zeros((len(points_mm), 3, 3)),
        np.zeros((len(rig.cameras), len(points_mm)), bool),
    )
    for i, name in enumerate(rig.cameras):
        by_point, _, sees[i] = differentiate_camera(rig, name, points_mm)
        by_point = by_point * sees[i][:, None, None]
        normal += np.einsum("nri,nrj->nij", by_point, by_point)
    unit, usable = np.full(len(points_mm), np.nan), sees.sum(axis=0) >= 2
    unit[usable] = np.sqrt(np.linalg.inv(normal[usable])[:, 2, 2])
    return unit, sees


def count_parameters(rig: Rig) -> int:
    """Return the number G of a rig's parameters: intrinsics of all cameras, poses of all but the core."""
    return sum(_list_widths(rig)) + 6 * (len(rig.cameras) - 1)


def list_parameter_columns(rig: Rig, index: int) -> NDArray[np.int64]:
    """Return the columns of a camera: its lens, then 6 of its pose (none for the core, index 0)."""
    widths = _list_widths(rig)
    lens = sum(widths[:index]) + np.arange(widths[index])
    pose = sum(widths) + 6 * (index - 1) + np.arange(6 if index else 0)
    return np.concatenate([lens, pose])


def _list_widths(rig: Rig) -> list[int]:
    return [len(list_parameters(camera.model)) for camera in rig.cameras.values()]


def _list_free_parameters(rig: Rig, bundle: Bundle) -> NDArray[np.int64]:
    """Return the columns of the parameters of the cameras that a bundle adjusts, in the bundle's order."""
    is_own: list[NDArray[np.bool_]] = [np.arange(bundle.width) < width for width in _list_widths(rig)]
    poses = np.ones(bundle.point_start - bundle.pose_start, bool)
    column = np.cumsum(np.concatenate([*is_own, poses])) - 1  # the bundle fills smaller models with zeros
    return column[bundle.free[bundle.free < bundle.point_start]]


def differentiate_camera(rig: Rig, name: str, points_mm: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Differentiate a camera's pixels of points (N, 3) in the core frame.

    Return derivatives by the point (N, 2, 3), by lens and pose (N, 2, W + 6), and the visibility of the points (N,).
    """
    camera, pose = rig.cameras[name], rig.cam_from_core[name]
    rotated = points_mm @ pose.rotation.T
    in_camera = rotated + pose.translation_mm
    ahead = in_camera[:, 2] > 0
    in_camera[~ahead] = (0, 0, 1)
    pixels, by_point, by_lens = project_with_jacobians(
        in_camera, np.tile(pack_intrinsics(camera), (len(points_mm), 1)), camera.model
    )
    visible = ahead & (np.hypot(*in_camera.T[:2]) <= camera.valid_radius * in_camera[:, 2])
    visible &= ((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1)).all(axis=1)
    by_rig = np.concatenate([by_lens, differentiate_by_pose(by_point, rotated)], axis=-1)
    return np.einsum("nij,jk->nik", by_point, pose.rotation), by_rig, visible
