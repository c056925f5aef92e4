"""Normal equations in which every frame has a pose of its own: it is eliminated (Schur complement)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]


class LinearisedBundle:
    """Normal equations of a bundle: dense over the shared parameters, a 6×6 block per board pose."""

    def __init__(
        self, cost: float, hessian: Array, gradient: Array, own: Array, coupling: Array, own_gradient: Array
    ) -> None:
        """``hessian`` (G, G), ``own`` (F, 6, 6), ``coupling`` (G, 6F), gradients (G,) and (6F,)."""
        self.cost = cost
        self._hessian, self._gradient = hessian, gradient
        self._own, self._coupling, self._own_gradient = own, coupling, own_gradient

    def solve_step(self, damping: float) -> Array:
        """Solve through the Schur complement on the shared parameters."""
        reduced, right, inverse = self._reduce(damping)
        shared = -cho_solve(cho_factor(reduced), right)
        boards = self._own_gradient + self._coupling.T @ shared
        return np.concatenate([shared, -(inverse @ boards.reshape(-1, 6, 1)).ravel()])

    def _reduce(self, damping: float) -> tuple[Array, Array, Array]:
        """Schur complement (G, G), its right side (G,), inverses of the board blocks (F, 6, 6)."""
        diagonal = np.einsum("fii->fi", self._own)
        unseen = diagonal == 0  # of a frame none of whose corners count, the pose stays as it is
        scaled = self._own + (damping * diagonal + unseen)[:, :, None] * np.eye(6)
        inverse = np.asarray(np.linalg.inv(scaled), np.float64)
        each = self._coupling.reshape(len(self._gradient), -1, 6).swapaxes(0, 1)
        eliminated = np.matmul(each, inverse).swapaxes(0, 1).reshape(self._coupling.shape)
        reduced = self._hessian - eliminated @ self._coupling.T
        reduced[np.diag_indices_from(reduced)] += damping * np.diag(self._hessian)
        return reduced, self._gradient - eliminated @ self._own_gradient, inverse

    def predict_decrease(self, step: Array) -> float:
        """F(X) − L(X + δ)."""
        count = len(self._gradient)
        shared, boards = step[:count], step[count:]
        each = boards.reshape(-1, 6, 1)
        change = self._gradient @ shared + 0.5 * shared @ self._hessian @ shared
        change += self._own_gradient @ boards + 0.5 * float((each * (self._own @ each)).sum())
        return -float(change + shared @ self._coupling @ boards)

    def covariance(self) -> Array:
        """Of the free shared parameters: the inverse of the undamped Schur complement."""
        reduced, _, _ = self._reduce(0.0)
        return cho_solve(cho_factor(reduced), np.eye(len(reduced)))
