"""Normal equations with one pose per frame, solved by eliminating these poses (Schur complement)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]


class LinearisedBundle:
    """Normal equations of a bundle adjustment: dense in the shared parameters, one 6×6 block per board pose."""

    def __init__(
        self,
        cost: float,
        hessian: Array,
        gradient: Array,
        blocks: Array,
        coupling: Array,
        block_gradient: Array,
    ) -> None:
        """Store ``hessian`` (G, G), ``blocks`` (F, 6, 6), ``coupling`` (G, 6F), gradients (G,) and (6F,)."""
        self.cost = cost
        self._hessian, self._gradient = hessian, gradient
        self._blocks, self._coupling, self._block_gradient = blocks, coupling, block_gradient

    def solve_step(self, damping: float) -> Array:
        """Return the damped step, solved by the Schur complement on the shared parameters."""
        reduced, right, inverse = self._reduce(damping)
        shared = -cho_solve(cho_factor(reduced), right)
        boards = self._block_gradient + self._coupling.T @ shared
        return np.concatenate([shared, -(inverse @ boards.reshape(-1, 6, 1)).ravel()])

    def _reduce(self, damping: float) -> tuple[Array, Array, Array]:
        """Return the Schur complement (G, G), its right side (G,) and the inverse board blocks (F, 6, 6)."""
        diagonal = np.einsum("fii->fi", self._blocks)
        unobserved = diagonal == 0  # the pose of a frame without weighted corners stays unchanged
        scaled = self._blocks + (damping * diagonal + unobserved)[:, :, None] * np.eye(6)
        inverse = np.asarray(np.linalg.inv(scaled), np.float64)
        by_board = self._coupling.reshape(len(self._gradient), len(self._blocks), 6).swapaxes(0, 1)
        eliminated = np.matmul(by_board, inverse).swapaxes(0, 1).reshape(self._coupling.shape)
        reduced = self._hessian - eliminated @ self._coupling.T
        reduced[np.diag_indices_from(reduced)] += damping * np.diag(self._hessian)
        return reduced, self._gradient - eliminated @ self._block_gradient, inverse

    def predict_decrease(self, step: Array) -> float:
        """Return F(X) − L(X + δ)."""
        count = len(self._gradient)
        shared, boards = step[:count], step[count:]
        by_board = boards.reshape(-1, 6, 1)
        change = self._gradient @ shared + 0.5 * shared @ self._hessian @ shared
        change += self._block_gradient @ boards + 0.5 * float((by_board * (self._blocks @ by_board)).sum())
        return -float(change + shared @ self._coupling @ boards)

    def covariance(self, damping: float = 0.0) -> Array:
        """Return the covariance of the free shared parameters, the inverse of the Schur complement."""
        reduced, _, _ = self._reduce(damping)
        return cho_solve(cho_factor(reduced), np.eye(len(reduced)))
