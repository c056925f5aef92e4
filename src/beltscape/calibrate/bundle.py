"""Bundle adjustment: intrinsics, camera poses, board poses and the board's own shape, from all corners together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from beltscape.calibrate.jacobian import by_pose, project
from beltscape.core.pose import rotation_from_vector

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

INTRINSICS = 9
GAUGE = 1e8
"""Information with which the board's seven free modes (pose and scale) are held at their nominal place."""


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
    """(N, 2) where it was found."""
    sigma_px: Array
    """(N,) one standard deviation of each coordinate."""


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """What is adjusted."""

    intrinsics: Array
    """(C, 9) fx, fy, cx, cy, k1, k2, p1, p2, k3."""
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
class Prior:
    """What is known beforehand, and what is not adjusted at all."""

    intrinsics: Array
    """(C, 9)."""
    intrinsics_information: Array
    """(C, 9, 9) inverse covariance about them; 0 says nothing."""
    intrinsics_free: NDArray[np.bool_]
    """(C, 9) what is adjusted; the rest is held where it is."""
    points_mm: Array
    """(P, 3) the nominal board."""
    points_sigma_mm: Array
    """(3,) how far a corner may lie from its nominal place in x, y, z; 0 holds the board as drawn."""


class Bundle:
    """The adjustment as a problem for `levenberg.minimise`."""

    def __init__(self, observations: Observations, prior: Prior, weights: Array | None = None) -> None:
        """``weights`` (N,) in 0..1 take the trust from single corners."""
        self.observations = observations
        self.prior = prior
        self.weights = np.ones(len(observations.pixels)) if weights is None else weights
        self.cameras, self.points = len(prior.intrinsics), len(prior.points_mm)
        # columns: intrinsics of all cameras, poses of all but the core, points; board poses are eliminated
        self.pose_start = INTRINSICS * self.cameras
        self.point_start = self.pose_start + 6 * (self.cameras - 1)
        self.columns = self.point_start + 3 * self.points
        free = np.concatenate(
            [prior.intrinsics_free.ravel(), np.ones(6 * (self.cameras - 1), bool),
             np.tile(prior.points_sigma_mm > 0, self.points)]
        )  # fmt: skip
        self.free = np.flatnonzero(free)
        self.gauge = _gauge_modes(prior.points_mm)
        self.information = self._prior_information()
        starts = np.flatnonzero(np.diff(observations.frame, prepend=-1))
        self.frames = [
            slice(a, b) for a, b in zip(starts, [*starts[1:], len(observations.frame)], strict=True)
        ]

    def errors_px(self, state: Geometry) -> Array:
        """(N, 2) projected minus found."""
        return self._project(state)[0] - self.observations.pixels

    def cost(self, state: Geometry) -> float:
        """Half the weighted sum of squares of corners and priors."""
        standardised = self.errors_px(state) / self.observations.sigma_px[:, None]
        value = 0.5 * float((self.weights[:, None] * standardised**2).sum())
        residual = self._from_prior(state)
        return value + 0.5 * float(residual @ self.information @ residual)

    def linearise(self, state: Geometry) -> BundleLinear:
        """Normal equations with the board poses eliminated (Schur complement)."""
        o = self.observations
        pixels, board_side, by_intrinsics, by_point, on_board = self._project(state)
        scale = (np.sqrt(self.weights) / o.sigma_px)[:, None, None]
        residual = (pixels - o.pixels) * scale[:, 0]
        by_camera = by_pose(by_point, self._rotated(state, board_side)) * scale
        to_core = np.einsum("nij,njk->nik", by_point, state.cam_rotation[o.camera])
        by_board = by_pose(to_core, on_board) * scale
        by_corner = np.einsum("nij,njk->nik", to_core, state.board_rotation[o.frame]) * scale
        shared = self._sparse(by_intrinsics * scale, by_camera, by_corner)
        error = residual.reshape(-1)
        hessian = self.information + (shared.T @ shared).toarray()
        gradient = self.information @ self._from_prior(state) + shared.T @ error
        count = len(state.board_rotation)
        boards = self._board_columns(by_board, count)
        coupling = (shared.T @ boards).toarray()[self.free]
        own = np.zeros((count, 6, 6))
        np.add.at(own, o.frame, np.einsum("nri,nrj->nij", by_board, by_board))
        free = self.free
        return BundleLinear(
            self.cost(state), hessian[np.ix_(free, free)], gradient[free], own, coupling, boards.T @ error
        )

    def moved(self, state: Geometry, step: Array) -> Geometry:
        """The geometry after a step: free shared parameters first, then six per frame."""
        shared = np.zeros(self.columns)
        shared[self.free] = step[: len(self.free)]
        boards = step[len(self.free) :].reshape(-1, 6)
        cams = shared[self.pose_start : self.point_start].reshape(-1, 6)
        cams = np.concatenate([np.zeros((1, 6)), cams])
        return Geometry(
            state.intrinsics + shared[: self.pose_start].reshape(-1, INTRINSICS),
            _turned(state.cam_rotation, cams[:, :3]),
            state.cam_translation_mm + cams[:, 3:],
            _turned(state.board_rotation, boards[:, :3]),
            state.board_translation_mm + boards[:, 3:],
            state.points_mm + shared[self.point_start :].reshape(-1, 3),
        )

    def _project(self, state: Geometry) -> tuple[Array, Array, Array, Array, Array]:
        """Pixels; the point in the core frame; derivatives by intrinsics and by the point; the point turned."""
        o = self.observations
        on_board = np.einsum("nij,nj->ni", state.board_rotation[o.frame], state.points_mm[o.point])
        in_core = on_board + state.board_translation_mm[o.frame]
        in_camera = self._rotated(state, in_core) + state.cam_translation_mm[o.camera]
        pixels, by_point, by_intrinsics = project(in_camera, state.intrinsics[o.camera])
        return pixels, in_core, by_intrinsics, by_point, on_board

    def _rotated(self, state: Geometry, in_core: Array) -> Array:
        return np.einsum("nij,nj->ni", state.cam_rotation[self.observations.camera], in_core)

    def _sparse(self, by_intrinsics: Array, by_camera: Array, by_corner: Array) -> csr_array:
        """(2N, columns) derivatives by the shared parameters: at most 18 numbers a row."""
        o = self.observations
        other = o.camera > 0  # the core's pose is the frame everything is in
        columns = np.concatenate(
            [
                INTRINSICS * o.camera[:, None] + np.arange(INTRINSICS),
                self.pose_start + 6 * np.maximum(o.camera[:, None] - 1, 0) + np.arange(6),
                self.point_start + 3 * o.point[:, None] + np.arange(3),
            ],
            axis=1,
        )
        values = np.concatenate([by_intrinsics, by_camera * other[:, None, None], by_corner], axis=2)
        rows = np.arange(0, values.size + 1, values.shape[2])
        shape = (2 * len(o.camera), self.columns)
        return csr_array((values.ravel(), np.repeat(columns, 2, axis=0).ravel(), rows), shape=shape)

    def _board_columns(self, by_board: Array, count: int) -> csr_array:
        """(2N, 6F) derivatives by the board poses."""
        columns = np.repeat(6 * self.observations.frame[:, None] + np.arange(6), 2, axis=0)
        rows = np.arange(0, by_board.size + 1, 6)
        return csr_array((by_board.ravel(), columns.ravel(), rows), shape=(len(rows) - 1, 6 * count))

    def _from_prior(self, state: Geometry) -> Array:
        """(columns,) distance of the shared parameters from what is known beforehand."""
        intrinsics = (state.intrinsics - self.prior.intrinsics).ravel()
        points = (state.points_mm - self.prior.points_mm).ravel()
        return np.concatenate([intrinsics, np.zeros(self.point_start - self.pose_start), points])

    def _prior_information(self) -> Array:
        """(columns, columns) of the lens, of the board's corners, and of the gauge."""
        information = np.zeros((self.columns, self.columns))
        for camera, own in enumerate(self.prior.intrinsics_information):
            columns = slice(INTRINSICS * camera, INTRINSICS * (camera + 1))
            information[columns, columns] = own
        points = slice(self.point_start, None)
        with np.errstate(divide="ignore"):
            each = np.where(self.prior.points_sigma_mm > 0, self.prior.points_sigma_mm**-2.0, 0.0)
        information[points, points] = np.diag(np.tile(each, self.points)) + GAUGE * self.gauge.T @ self.gauge
        return information


class BundleLinear:
    """Normal equations of a bundle: dense over the shared parameters, a 6×6 block per board pose."""

    def __init__(
        self, cost: float, hessian: Array, gradient: Array, own: Array, coupling: Array, own_gradient: Array
    ) -> None:
        """``hessian`` (G, G), ``own`` (F, 6, 6), ``coupling`` (G, 6F), gradients (G,) and (6F,)."""
        self.cost = cost
        self._hessian, self._gradient = hessian, gradient
        self._own, self._coupling, self._own_gradient = own, coupling, own_gradient

    def step(self, damping: float) -> Array:
        """Solve through the Schur complement on the shared parameters."""
        reduced, right, inverse = self._reduced(damping)
        shared = -cho_solve(cho_factor(reduced), right)
        boards = self._own_gradient + self._coupling.T @ shared
        return np.concatenate([shared, -np.einsum("fij,fj->fi", inverse, boards.reshape(-1, 6)).ravel()])

    def _reduced(self, damping: float) -> tuple[Array, Array, Array]:
        """Schur complement (G, G), its right side (G,), inverses of the board blocks (F, 6, 6)."""
        scaled = self._own + damping * self._own * np.eye(6)
        inverse = np.asarray(np.linalg.inv(scaled), np.float64)
        count = len(self._gradient)
        eliminated = np.einsum("gfi,fij->gfj", self._coupling.reshape(count, -1, 6), inverse).reshape(
            count, -1
        )
        reduced = self._hessian + damping * np.diag(np.diag(self._hessian)) - eliminated @ self._coupling.T
        return reduced, self._gradient - eliminated @ self._own_gradient, inverse

    def predicted_drop(self, step: Array) -> float:
        """F(X) − L(X + δ)."""
        count = len(self._gradient)
        shared, boards = step[:count], step[count:]
        each = boards.reshape(-1, 6)
        change = self._gradient @ shared + 0.5 * shared @ self._hessian @ shared
        change += self._own_gradient @ boards + 0.5 * np.einsum("fi,fij,fj->", each, self._own, each)
        return -float(change + shared @ self._coupling @ boards)

    def covariance(self) -> Array:
        """Of the free shared parameters: the inverse of the undamped Schur complement."""
        reduced, _, _ = self._reduced(0.0)
        return cho_solve(cho_factor(reduced), np.eye(len(reduced)))


def _turned(rotations: Array, vectors: Array) -> Array:
    return np.stack([rotation_from_vector(v) @ r for v, r in zip(vectors, rotations, strict=True)])


def _gauge_modes(points_mm: Array) -> Array:
    """(7, 3P) orthonormal motions of the whole board that no image can tell: shift, turn, scale."""
    centered = points_mm - points_mm.mean(axis=0)
    shifts = [np.tile(axis, (len(points_mm), 1)) for axis in np.eye(3)]
    turns = [np.cross(axis, centered) for axis in np.eye(3)]
    modes = np.stack([mode.ravel() for mode in (*shifts, *turns, centered)])
    return np.linalg.qr(modes.T)[0].T
