"""Pose consensus: the relative pose of two groups of cameras, whichever end of the board each numbers from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import Pose

Array = NDArray[np.float64]

TOLERANCE = 0.1
"""Two boards coincide if their outer corners are no farther apart, RMS, than this share of the diagonal.

The corners of a board that is numbered from the wrong end are a whole diagonal away.
"""
LOG_LIKELIHOOD_MARGIN = 8.0
"""A numbering is preferred to another if it is more likely by e to this power, ..."""
RESIDUAL_RATIO = 1.5
"""... and its residuals are smaller by this factor, because residuals are not only noise."""
MAX_PROPOSALS = 30
"""Number of views, evenly spread, that each propose a relative pose."""
ROUNDS = 2
"""Refinements of each proposed pose on the views that agree with it."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseConsensus:
    """The relative pose of two groups that most views agree on."""

    second_from_first: Pose
    quarter_turns: dict[int, int]
    """Instant → quarter turns to apply to the second group's numbering."""
    instants: int
    """Number of instants that agree."""
    rms_mm: float
    """RMS distance of the outer corners over the views that agree."""
    unambiguous: bool
    """Whether every other numbering fits clearly worse."""


def find_pose_consensus(
    first: Array, second: Array, instants: NDArray[np.int64], turns: tuple[int, ...]
) -> PoseConsensus | None:
    """Find the pose that brings most boards of the first group onto those of the second.

    ``first`` and ``second`` are (n, 4, 3) float64 mm: the board's outer corners, going round, as one camera of each
    group sees them, in the group's axes, at ``instants`` (n,), which may repeat; ``turns`` are quarter turns under
    which the board looks the same, 0 first. The relative pose is the same at all instants only if the numberings
    agree. Each view and turn proposes a pose, which is refined on the views that agree with it. Of numberings that
    fit equally well, the one with the fewest turns is selected. Return None unless more than half of the views agree.
    """
    turned = np.stack([np.roll(second, -turn, axis=1) for turn in turns], axis=1)
    tolerance = TOLERANCE * float(np.median(np.linalg.norm(first[:, 0] - first[:, 2], axis=-1)))
    rotations, shifts = _propose_poses(first, turned)
    choice, distance = _select_turns(rotations, shifts, first, turned)
    for _ in range(ROUNDS):
        weights = np.repeat(distance < tolerance, 4, axis=1).astype(np.float64)
        chosen = turned[np.arange(len(first)), choice].reshape(len(choice), -1, 3)
        rotations, shifts = _fit_rigid_motions(
            np.broadcast_to(first.reshape(-1, 3), chosen.shape), chosen, weights
        )
        choice, distance = _select_turns(rotations, shifts, first, turned)
    best = int(np.argmin((np.minimum(distance, tolerance) ** 2).sum(axis=1)))
    inlier = distance[best] < tolerance
    if 2 * int(inlier.sum()) <= len(first):
        return None
    rms = np.sqrt((distance[:, inlier] ** 2).mean(axis=1))
    count = len(np.unique(instants[inlier]))
    equivalent = _find_equivalent_poses(rms, best, count, tolerance)
    numberings = {choice[i, inlier].tobytes() for i in equivalent}
    best = min(equivalent, key=lambda i: (np.count_nonzero(choice[i, inlier]), rms[i]))
    votes = np.where(inlier, 1.0, 1e-6)  # views that disagree only count if there are no others
    return PoseConsensus(
        Pose(rotations[best], shifts[best]),
        {
            int(k): turns[int(np.bincount(choice[best, instants == k], votes[instants == k]).argmax())]
            for k in np.unique(instants)
        },
        count,
        float(rms[best]),
        len(numberings) == 1,
    )


def _propose_poses(first: Array, turned: Array) -> tuple[Array, Array]:
    """Return rotations (h, 3, 3) and shifts (h, 3) of the poses that follow from one view and one turn each."""
    proposals = np.unique(np.linspace(0, len(first) - 1, min(len(first), MAX_PROPOSALS)).astype(int))
    goals = turned[proposals].reshape(-1, 4, 3)
    return _fit_rigid_motions(
        np.repeat(first[proposals], turned.shape[1], axis=0), goals, np.ones((len(goals), 4))
    )


def _find_equivalent_poses(rms_mm: Array, best: int, instants: int, tolerance_mm: float) -> list[int]:
    """Return the poses, the best included, whose residuals (h,) over the same views are not clearly worse."""
    freedom = 6 * (instants - 1)  # six for each board, less six for the relative pose
    limit = max(RESIDUAL_RATIO, float(np.exp(LOG_LIKELIHOOD_MARGIN / freedom))) if freedom else np.inf
    floor = 1e-6 * tolerance_mm  # without noise all residuals are rounding errors
    return [int(i) for i in np.flatnonzero(rms_mm <= limit * max(rms_mm[best], floor))] or [best]


def _select_turns(
    rotations: Array, shifts: Array, first: Array, turned: Array
) -> tuple[NDArray[np.int64], Array]:
    """Return by pose (h) and view (n) the turn that brings the boards closest, and their RMS distance, mm."""
    transformed = np.einsum("hij,nkj->hnki", rotations, first) + shifts[:, None, None, :]
    squared_distances = np.stack(
        [((transformed - turned[:, s]) ** 2).sum(axis=-1).mean(axis=-1) for s in range(turned.shape[1])],
        axis=-1,
    )
    choice = squared_distances.argmin(axis=-1)
    return choice, np.sqrt(np.take_along_axis(squared_distances, choice[..., None], axis=-1)[..., 0])


def _fit_rigid_motions(points: Array, onto: Array, weights: Array) -> tuple[Array, Array]:
    """Fit rotations (h, 3, 3) and shifts (h, 3) that map points (h, m, 3) onto others, by weighted least squares.

    References
    ----------
    Kabsch, Acta Cryst. A32, 1976, doi:10.1107/S0567739476001873.
    """
    share = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    middle, goal = np.einsum("hm,hmi->hi", share, points), np.einsum("hm,hmi->hi", share, onto)
    spread = np.einsum("hm,hmi,hmj->hij", share, onto - goal[:, None], points - middle[:, None])
    u, _, vt = np.linalg.svd(spread)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]  # a rotation, not a mirror
    rotations = u @ vt
    return rotations, goal - np.einsum("hij,hj->hi", rotations, middle)
