"""Bundle adjustment of intrinsics, camera poses, board poses and the board's shape from all corners together.

Its data are the observed corners, the adjusted geometry and the prior. Its statistics are robust: Student weights,
each camera's noise, and outlier rejection.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from beltscape.calibration.solver.lens import (
    differentiate_by_pose,
    group_by_model,
    project_points,
    project_with_jacobians,
    rotate_vectors,
)
from beltscape.calibration.solver.levenberg_marquardt import LinearisedBundle
from beltscape.calibration.solver.prior import BundlePrior, build_board_information
from beltscape.core.arrays import Array, Indices
from beltscape.core.geometry.pose import rotation_from_vector
from beltscape.core.statistics import MAD_TO_SIGMA


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """All corners, one row each, sorted by frame."""

    camera: Indices
    """(N,) index of the camera."""
    frame: Indices
    """(N,) index of the frame, ascending."""
    point: Indices
    """(N,) index of the board's corner."""
    pixels: Array
    """(N, 2) detected position."""
    sigma_px: Array
    """(N,) one standard deviation of each coordinate."""

    @classmethod
    def from_views(cls, views: Iterable[tuple[int, int, Indices, Array]]) -> Observations:
        """Concatenate views, each as camera, frame, ids (n,) and pixels (n, 2) of its corners; σ is 1 px."""
        rows = [
            (np.full(len(ids), camera), np.full(len(ids), frame), ids, px) for camera, frame, ids, px in views
        ]
        camera, frame, point, pixels = (np.concatenate(column) for column in zip(*rows, strict=True))
        return cls(camera, frame, point, pixels, np.ones(len(pixels)))


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The quantities that the bundle adjustment estimates."""

    intrinsics: Array
    """(C, W) fx, fy, cx, cy and the coefficients of each camera's lens model, zeros beyond them."""
    cam_rotation: Array
    """(C, 3, 3) cam_from_core; camera 0 is the core."""
    cam_translation_mm: Array
    """(C, 3)."""
    board_rotation: Array
    """(F, 3, 3) core_from_board."""
    board_translation_mm: Array
    """(F, 3)."""
    points_mm: Array
    """(P, 3) the board's corners in its own frame."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewDesign:
    """The corners of one view, divided by their standard deviation, with their derivatives."""

    camera: int
    frame: int
    by_shared: Array
    """(2n, G) by the free shared parameters."""
    by_board: Array
    """(2n, 6) by the board's pose."""
    residuals: Array
    """(2n,) projected minus detected."""


class Bundle:
    """The bundle adjustment as a problem for `levenberg_marquardt.minimise`."""

    def __init__(self, observations: Observations, prior: BundlePrior, weights: Array | None = None) -> None:
        """Set up the problem; ``weights`` (N,) in 0..1 reduce the influence of single corners, 1 by default."""
        self.observations = observations
        self.prior = prior
        self.weights = np.ones(len(observations.pixels)) if weights is None else weights
        self.cameras, self.points = len(prior.intrinsics), len(prior.points_mm)
        self.models = group_by_model(prior.models, observations.camera)
        self.width = int(prior.intrinsics.shape[1])
        self.rows = _DerivativeRows.for_width(self.width)
        # columns: intrinsics of all cameras, poses of all but the core, points; board poses are eliminated
        self.pose_start = self.width * self.cameras
        self.point_start = self.pose_start + 6 * (self.cameras - 1)
        self.adjusts_shape = bool((prior.points_sigma_mm > 0).any())
        self.columns = self.point_start + 3 * self.points * self.adjusts_shape
        free = np.concatenate(
            [prior.intrinsics_free.ravel(),
             np.repeat(~np.isin(np.arange(1, self.cameras), prior.fixed_poses), 6),
             np.tile(prior.points_sigma_mm > 0, self.points)]
        )[: self.columns]  # fmt: skip
        self.free = np.flatnonzero(free)
        self.information = self._build_prior_information()
        view = observations.frame * self.cameras + observations.camera
        starts = np.flatnonzero(np.diff(view, prepend=-1))
        self.views = [slice(a, b) for a, b in zip(starts, [*starts[1:], len(view)], strict=True)]
        self.view_camera, self.view_frame = observations.camera[starts], observations.frame[starts]

    def compute_errors_px(self, state: Geometry) -> Array:
        """Return the reprojection errors (N, 2), projected minus detected."""
        _, in_camera = self._transform_points(state)
        return (
            project_points(in_camera, _gather(state.intrinsics, self.observations.camera), self.models)
            - self.observations.pixels
        )

    def compute_cost(self, state: Geometry) -> float:
        """Return half the weighted sum of squares of corners and priors."""
        standardised = self.compute_errors_px(state) / self.observations.sigma_px[:, None]
        return 0.5 * float((self.weights[:, None] * standardised**2).sum()) + self._compute_prior_cost(state)

    def linearise(self, state: Geometry) -> LinearisedBundle:
        """Return the normal equations at a state; their solution eliminates the board poses (Schur complement)."""
        rows, by_corner = self._differentiate(state)
        grams = self._form_gram_matrices(rows)
        hessian = self.information.copy()
        gradient = self.information @ self._compute_prior_residual(state)
        count = len(state.board_rotation)
        blocks, block_gradient = np.zeros((count, 6, 6)), np.zeros((count, 6))
        coupling = np.zeros((count, self.columns, 6))
        board = self.rows.board
        np.add.at(blocks, self.view_frame, grams[:, board, board])
        np.add.at(block_gradient, self.view_frame, grams[:, board, -1])
        for camera in range(self.cameras):
            views = self.view_camera == camera
            own_columns, used = self._camera_columns(camera)
            total = grams[views].sum(axis=0)
            hessian[np.ix_(own_columns, own_columns)] += total[used, used]
            gradient[own_columns] += total[used, -1]
            where = self.view_frame[views][:, None], own_columns[None]
            np.add.at(coupling, where, grams[views][:, used, board])
        if self.adjusts_shape:
            self._add_point_blocks(rows, by_corner, hessian, gradient, coupling)
        free = self.free
        cost = 0.5 * float(grams[:, -1, -1].sum()) + self._compute_prior_cost(state)
        coupling = coupling[:, free].swapaxes(0, 1).reshape(len(free), 6 * count)
        return LinearisedBundle(
            cost, hessian[np.ix_(free, free)], gradient[free], blocks, coupling, block_gradient.ravel()
        )

    def list_view_designs(self, state: Geometry) -> Iterator[ViewDesign]:
        """Yield the weighted corners of every view with their derivatives."""
        rows, by_corner = self._differentiate(state)
        for corners, camera, frame in zip(self.views, self.view_camera, self.view_frame, strict=True):
            index = np.arange(corners.start, corners.stop)[self.weights[corners] > 0]
            if not index.size:
                continue
            by_shared = np.zeros((self.columns, 2, len(index)))
            columns, used = self._camera_columns(int(camera))
            by_shared[columns] = rows[used][:, :, index]
            if self.adjusts_shape:
                point = self.point_start + 3 * self.observations.point[index]
                for axis in range(3):
                    by_shared[point + axis, :, np.arange(len(index))] = by_corner[axis][:, index].T
            yield ViewDesign(
                int(camera),
                int(frame),
                by_shared[self.free].reshape(len(self.free), -1).T,
                rows[self.rows.board][:, :, index].reshape(6, -1).T,
                rows[-1][:, index].ravel(),
            )

    def _differentiate(self, state: Geometry) -> tuple[Array, Array]:
        """Return derivatives divided by each corner's standard deviation.

        (W + 13, 2, N) by lens (W), camera pose (6), board pose (6), then the residual; (3, 2, N) by the board corner.
        """
        o = self.observations
        on_board, in_camera = self._transform_points(state)
        pixels, by_point, by_lens = project_with_jacobians(
            in_camera, _gather(state.intrinsics, o.camera), self.models
        )
        scale = np.sqrt(self.weights) / o.sigma_px
        by_point = by_point * scale[:, None, None]
        to_core = _rotate_derivatives(by_point, _gather(state.cam_rotation, o.camera))
        rows = np.empty((self.rows.count, 2, len(o.camera)))
        rows[self.rows.lens] = by_lens.T * scale
        rows[self.rows.camera] = differentiate_by_pose(
            by_point, in_camera - _gather(state.cam_translation_mm, o.camera)
        ).T
        rows[self.rows.board] = differentiate_by_pose(to_core, on_board).T
        rows[-1] = (pixels - o.pixels).T * scale
        if not self.adjusts_shape:
            return rows, np.empty((3, 2, 0))
        return rows, _rotate_derivatives(to_core, _gather(state.board_rotation, o.frame)).T

    def _form_gram_matrices(self, rows: Array) -> Array:
        """Return the products (V, W + 13, W + 13) of all rows, summed over each view."""
        grams = np.empty((len(self.views), len(rows), len(rows)))
        for view, corners in enumerate(self.views):
            block = rows[:, :, corners].reshape(len(rows), -1)
            np.matmul(block, block.T, out=grams[view])
        return grams

    def _add_point_blocks(
        self, rows: Array, by_corner: Array, hessian: Array, gradient: Array, coupling: Array
    ) -> None:
        """Add the blocks of the board's corners: with themselves, with the cameras and with the board poses."""
        products = np.einsum("krn,jrn->nkj", np.concatenate([rows, by_corner]), by_corner)
        points = slice(self.point_start, None)
        by_camera = self._sum_by_point(
            products[:, : self.rows.camera.stop], self.observations.camera, self.cameras
        )
        for camera in range(self.cameras):
            own_columns, used = self._camera_columns(camera)
            block = by_camera[camera, :, used].transpose(1, 0, 2).reshape(len(own_columns), -1)
            hessian[own_columns, points] += block
            hessian[points, own_columns] += block.T
        by_frame = self._sum_by_point(products[:, self.rows.board], self.observations.frame, len(coupling))
        coupling[:, points] += by_frame.transpose(0, 1, 3, 2).reshape(len(coupling), -1, 6)
        alone = self._sum_by_point(
            products[:, self.rows.board.stop :], np.zeros_like(self.observations.frame), 1
        )[0]
        gradient[points] += alone[:, 0].ravel()
        columns = self.point_start + np.arange(3 * self.points).reshape(-1, 3)
        hessian[columns[:, :, None], columns[:, None]] += alone[:, 1:]

    def _sum_by_point(self, products: Array, group: Indices, count: int) -> Array:
        """Return (count, P, k, 3) sums of (N, k, 3) over the detections of each board corner in each group."""
        cells = group * self.points + self.observations.point
        shape = (count * self.points, len(cells))
        rows = csc_array((np.ones(len(cells)), cells, np.arange(len(cells) + 1)), shape=shape)
        return (rows @ products.reshape(len(cells), -1)).reshape(count, self.points, -1, 3)

    def _camera_columns(self, camera: int) -> tuple[Indices, slice]:
        """Return the columns of a camera's lens and pose (none for the core), and their rows in `_differentiate`."""
        lens = np.arange(self.width * camera, self.width * (camera + 1))
        if camera == 0:
            return lens, self.rows.lens
        pose = self.pose_start + 6 * (camera - 1) + np.arange(6)
        return np.concatenate([lens, pose]), slice(0, self.rows.camera.stop)

    def apply_step(self, state: Geometry, step: Array) -> Geometry:
        """Return the geometry after a step, which holds the free shared parameters, then six per frame."""
        shared = np.zeros(self.columns)
        shared[self.free] = step[: len(self.free)]
        boards = step[len(self.free) :].reshape(-1, 6)
        cams = shared[self.pose_start : self.point_start].reshape(-1, 6)
        cams = np.concatenate([np.zeros((1, 6)), cams])
        return Geometry(
            state.intrinsics + shared[: self.pose_start].reshape(-1, self.width),
            _apply_rotations(state.cam_rotation, cams[:, :3]),
            state.cam_translation_mm + cams[:, 3:],
            _apply_rotations(state.board_rotation, boards[:, :3]),
            state.board_translation_mm + boards[:, 3:],
            state.points_mm + shared[self.point_start :].reshape(-1, 3)
            if self.adjusts_shape
            else state.points_mm,
        )

    def _transform_points(self, state: Geometry) -> tuple[Array, Array]:
        """Return the corners (N, 3) rotated into the core's axes, and (N, 3) in the camera's frame."""
        o = self.observations
        on_board = rotate_vectors(_gather(state.board_rotation, o.frame), _gather(state.points_mm, o.point))
        in_core = on_board + _gather(state.board_translation_mm, o.frame)
        in_camera = rotate_vectors(_gather(state.cam_rotation, o.camera), in_core)
        return on_board, in_camera + _gather(state.cam_translation_mm, o.camera)

    def _compute_prior_cost(self, state: Geometry) -> float:
        residual = self._compute_prior_residual(state)
        return 0.5 * float(residual @ self.information @ residual)

    def _compute_prior_residual(self, state: Geometry) -> Array:
        """Return the difference (columns,) of the shared parameters from their prior means."""
        intrinsics = (state.intrinsics - self.prior.intrinsics).ravel()
        points = (state.points_mm - self.prior.points_mm).ravel()
        return np.concatenate([intrinsics, np.zeros(self.point_start - self.pose_start), points])[
            : self.columns
        ]

    def _build_prior_information(self) -> Array:
        """Return the information (columns, columns) of lenses, board corners and gauge."""
        information = np.zeros((self.columns, self.columns))
        for camera, block in enumerate(self.prior.intrinsics_information):
            columns = slice(self.width * camera, self.width * (camera + 1))
            information[columns, columns] = block
        if self.adjusts_shape:
            information[self.point_start :, self.point_start :] = build_board_information(self.prior)
        return information


@dataclass(frozen=True, slots=True)
class _DerivativeRows:
    """Rows of a corner's derivatives by the lens and pose of its camera and by the pose of its board."""

    lens: slice
    camera: slice
    board: slice
    count: int
    """With the row of the residual, the last one."""

    @classmethod
    def for_width(cls, width: int) -> _DerivativeRows:
        """Return the rows with ``width`` intrinsics."""
        return cls(slice(0, width), slice(width, width + 6), slice(width + 6, width + 12), width + 13)


def _apply_rotations(rotations: Array, vectors: Array) -> Array:
    return np.stack([rotation_from_vector(v) @ r for v, r in zip(vectors, rotations, strict=True)])


def _gather(values: Array, index: Indices) -> Array:
    """Return ``values[index]`` with the observations last in memory."""
    return np.take(values.T, index, axis=-1).T


def _rotate_derivatives(derivatives: Array, rotations: Array) -> Array:
    """Return derivatives (N, 2, 3) by the points before rotations (N, 3, 3), given those by the rotated points."""
    (a, b, c), r = derivatives.T, rotations.T  # r[j, i]: row i, column j
    return (r[:, 0, None] * a + r[:, 1, None] * b + r[:, 2, None] * c).T


STUDENT_DOF = 5.0
"""Degrees of freedom of Student's t, which weights corners while the board's shape is estimated."""
MAX_DEVIATION = 4.5
"""Corners with larger errors, in standard deviations, are left out of the final adjustment."""
MIN_SHARE = 0.5
"""A view with a smaller share of accepted corners is left out as a whole."""


def estimate_robust_sigma(values: Array) -> float:
    """Return the standard deviation of values about zero from their median absolute value; NaN without any."""
    return float(MAD_TO_SIGMA * np.median(np.abs(values))) if values.size else float("nan")


def compute_student_weights(squared: Array) -> Array:
    """Return Student weights (N,) of corners with squared standardised errors (N,)."""
    return (STUDENT_DOF + 2) / (STUDENT_DOF + squared)


def estimate_student_sigma(bundle: Bundle, geometry: Geometry, sigma: Array, spread: float) -> Array:
    """Return the scale (C,) of Student's t for each camera's errors, by one step of expectation-maximisation."""
    camera = bundle.observations.camera
    squared = (bundle.compute_errors_px(geometry) ** 2).sum(axis=1)
    weights = compute_student_weights(squared / sigma[camera] ** 2)
    total = np.bincount(camera, weights * squared, minlength=len(sigma))
    count = 2 * np.bincount(camera, minlength=len(sigma)).clip(1)
    return _limit_spread(np.sqrt(total / count), count, spread)


def select_corners(bundle: Bundle, geometry: Geometry, spread: float) -> tuple[NDArray[np.bool_], Array]:
    """Return the accepted corners and each camera's noise from them, corrected for the degrees of freedom."""
    errors, camera = bundle.compute_errors_px(geometry), bundle.observations.camera
    cameras = len(geometry.intrinsics)
    robust = np.array([estimate_robust_sigma(errors[camera == c]) for c in range(cameras)])
    robust = _limit_spread(robust, np.bincount(camera, minlength=cameras), spread)
    kept = _mask_whole_views(
        np.linalg.norm(errors, axis=1) < MAX_DEVIATION * robust[camera], bundle.observations
    )
    fitted = len(bundle.free) + 6 * len(geometry.board_rotation)
    share = 1 - fitted / max(2 * int(kept.sum()), fitted + 1)
    sigma = np.array([np.sqrt((errors[kept & (camera == c)] ** 2).mean() / share) for c in range(cameras)])
    return kept, _limit_spread(sigma, np.bincount(camera[kept], minlength=cameras), spread)


def _limit_spread(sigma: Array, count: NDArray[np.intp], spread: float) -> Array:
    """Return each camera's noise, limited to within a factor ``spread`` of the rig's.

    Without the limit one camera's noise shrinks to 0: the larger its weight, the better boards and shape fit it.
    """
    pooled = float(np.sqrt((count * sigma**2).sum() / count.sum()))
    return np.clip(sigma, pooled / spread, pooled * spread)


def _mask_whole_views(kept: NDArray[np.bool_], observations: Observations) -> NDArray[np.bool_]:
    """Remove the remaining corners of views that lost most of theirs: the board moved, the rest agree by chance."""
    view = observations.frame * (observations.camera.max() + 1) + observations.camera
    share = np.bincount(view, kept) / np.bincount(view).clip(1)
    return kept & (share[view] >= MIN_SHARE)
