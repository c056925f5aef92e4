"""Symmetric chessboards: their corners numbered from the same end in all cameras.

A chessboard whose sides are both even or both odd looks the same after a half turn; a square one may be numbered from
any of its four corners. One camera alone cannot resolve this, and its intrinsics do not depend on it: the pose
is only rotated about the board's centre. Several rigidly mounted cameras can: the relative pose of two of them is
constant over the frames only if both number the board from the same end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.network.synchronisation import CLEAR_IMPROVEMENT, MIN_FRAMES, SHIFTS
from beltscape.calibration.solver.lens import fit_view_pose
from beltscape.core.arrays import Array
from beltscape.core.geometry.pose import Pose
from beltscape.files.frame_names import natural_key
from beltscape.target.board import Board, BoardSet, Chessboard, corner_points_mm, outer_corners

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


def list_quarter_turns(board: Board) -> tuple[int, ...]:
    """Return the quarter turns under which a board looks the same, 0 first."""
    if not isinstance(board, Chessboard) or sum(board.grid) % 2:
        return (0,)
    columns, rows = board.grid
    return (0, 1, 2, 3) if columns == rows else (0, 2)


def make_board_turn(board: Board, turn: int) -> Pose:
    """Return ``board_from_turned``, the pose of a board after quarter turns about its centre."""
    center = corner_points_mm(board).mean(axis=0)
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn % 4]
    rotation = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], np.float64)
    return Pose.placing(rotation, center, center)


def turn_corners(corners: Corners, board: Board, turn: int) -> Corners:
    """Renumber the corners of an image for a board after quarter turns; ids ascend again."""
    if isinstance(board, BoardSet):
        return corners  # `list_quarter_turns` lists none
    columns, rows = board.grid
    former = np.rot90(np.arange(columns * rows).reshape(rows, columns), turn).ravel()
    ids = np.argsort(former)[corners.ids]
    order = np.argsort(ids)
    return Corners(ids[order].astype(np.int64), corners.pixels[order])


LOOSE_FIT = 0.02
"""Shifted frames are tried if the boards coincide to no better than this share of their diagonal."""


@dataclass(frozen=True, slots=True, eq=False)
class Numbering:
    """Detections in which all cameras number the board from the same end, frame by frame."""

    detections: BoardDetections
    monocular: Mapping[str, MonocularCalibration]
    """By camera, with the board's poses turned like the detections."""
    renumbered: tuple[tuple[str, str], ...] = ()
    """(camera, frame) of the views that were renumbered."""
    ambiguous: tuple[str, ...] = ()
    """One line for each case in which another numbering fits equally well, with the cameras and the fix."""


def unify_numbering(
    detections: BoardDetections, monocular: Mapping[str, MonocularCalibration], board: Board
) -> Numbering:
    """Renumber as few views as possible so that the relative poses of the cameras agree over all frames.

    Groups of cameras are joined, those first that agree in the most frames. A camera whose frames are shifted against
    the others' is renumbered to fit after the shift; one that fits no other is left unchanged. Both are reported by
    `synchronisation.find_frame_misfits`. Without anything to renumber, the arguments are returned unchanged.
    """
    turns = list_quarter_turns(board)
    if len(turns) == 1:
        return Numbering(detections, monocular)
    frames = sorted(detections.frames, key=natural_key)
    corners_mm = corner_points_mm(board)
    groups = [
        _make_single_group(name, detections, monocular[name], frames, corners_mm, board)
        for name in detections.cameras
        if name in monocular
    ]
    ambiguities: list[str] = []
    links: _Links = {}
    while (link := _find_strongest_link(groups, turns, links)) is not None:
        if not link.consensus.unambiguous:
            ambiguities.append(_describe_ambiguity(link, board))
        joined = _join_groups(link)
        groups = [joined if g is link.first else g for g in groups if g is not link.second]
    turned = {view: turn for group in groups for view, turn in _minimise_turns(group, turns).items()}
    return _renumber_views(detections, monocular, board, frames, turned, tuple(ambiguities))


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    camera: str
    frame: int
    """Its index among the frames."""
    turn: int
    """Quarter turns applied to its numbering."""
    outer_mm: Array
    """(4, 3) the board's outer corners in the group's axes, going round, numbered after the turn."""


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Cameras with known relative poses; the first camera's axes are the group's."""

    cameras: tuple[str, ...]
    instants: Mapping[int, tuple[_View, ...]]
    """By instant, which is the first camera's frame index."""


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    """Two groups that see the same board."""

    first: _Group
    second: _Group
    shift: int
    """The first group's instant k is the second's k + shift."""
    shared: tuple[int, ...]
    """Instants of the first group."""
    consensus: PoseConsensus

    @property
    def strength(self) -> tuple[bool, bool, int, float]:
        """Sort key; links with greater strength are joined first."""
        consensus = self.consensus
        return consensus.unambiguous, self.shift == 0, consensus.instants, -consensus.rms_mm


_Links = dict[tuple[tuple[str, ...], tuple[str, ...]], _Link | None]
"""By the cameras of both groups; None if they do not agree."""


def _make_single_group(
    name: str,
    detections: BoardDetections,
    camera: MonocularCalibration,
    frames: Sequence[str],
    corners_mm: Array,
    board: Board,
) -> _Group:
    """Return one camera with all its views, including those that its calibration rejected: they are scored later."""
    outer = corners_mm[outer_corners(board)]
    number = {frame: k for k, frame in enumerate(frames)}
    instants: dict[int, tuple[_View, ...]] = {}
    for frame, corners in detections.views[name].items():
        pose = camera.cam_from_board.get(frame) or _fit_board_pose(camera, corners, corners_mm)
        instants[number[frame]] = (_View(name, number[frame], 0, pose.apply(outer)),)
    return _Group((name,), instants)


def _fit_board_pose(camera: MonocularCalibration, corners: Corners, corners_mm: Array) -> Pose:
    return fit_view_pose(camera.camera, corners_mm[corners.ids], corners.pixels)


def _find_strongest_link(groups: Sequence[_Group], turns: tuple[int, ...], links: _Links) -> _Link | None:
    """Return the link of the two groups that agree best; None if none do. ``links`` caches the tested ones."""
    candidates: list[_Link] = []
    for first, second in combinations(groups, 2):
        key = first.cameras, second.cameras
        if key not in links:
            links[key] = _link_groups(first, second, turns)
        link = links[key]
        if link is not None:
            candidates.append(link)
    return max(candidates, key=lambda link: link.strength, default=None)


def _link_groups(first: _Group, second: _Group, turns: tuple[int, ...]) -> _Link | None:
    """Return the link of two groups in the same frames, or in shifted frames if these fit far better."""
    plain = _link_shifted(first, second, 0, turns)
    if plain is not None and plain.consensus.rms_mm < LOOSE_FIT * _diagonal_mm(first):
        return plain
    others = [
        link for shift in SHIFTS if shift and (link := _link_shifted(first, second, shift, turns)) is not None
    ]
    clear = [link for link in others if len(link.shared) >= MIN_FRAMES and link.consensus.unambiguous]
    best = min(clear, key=lambda link: link.consensus.rms_mm, default=plain)
    if plain is None or best is None:
        return best
    return best if best.consensus.rms_mm < CLEAR_IMPROVEMENT * plain.consensus.rms_mm else plain


def _link_shifted(first: _Group, second: _Group, shift: int, turns: tuple[int, ...]) -> _Link | None:
    shared = tuple(sorted(k for k in first.instants if k + shift in second.instants))
    if not shared:
        return None
    seen = [
        (k, one.outer_mm, other.outer_mm)
        for k in shared
        for one, other in product(first.instants[k], second.instants[k + shift])
    ]
    instants, ones, others = (np.array(column) for column in zip(*seen, strict=True))
    consensus = find_pose_consensus(ones, others, instants, turns)
    return None if consensus is None else _Link(first, second, shift, shared, consensus)


def _diagonal_mm(group: _Group) -> float:
    outer = group.instants[min(group.instants)][0].outer_mm
    return float(np.linalg.norm(outer[2] - outer[0]))


def _join_groups(link: _Link) -> _Group:
    """Return both groups in the first's axes, with the second's numbering turned to agree in shared frames."""
    first_from_second = link.consensus.second_from_first.inverse()
    instants = dict(link.first.instants)
    for k, views in link.second.instants.items():
        turn = link.consensus.quarter_turns.get(k - link.shift, 0)
        moved = tuple(
            replace(
                view,
                turn=(view.turn + turn) % 4,
                outer_mm=first_from_second.apply(np.roll(view.outer_mm, -turn, axis=0)),
            )
            for view in views
        )
        instants[k - link.shift] = instants.get(k - link.shift, ()) + moved
    return _Group(link.first.cameras + link.second.cameras, instants)


def _describe_ambiguity(link: _Link, board: Board) -> str:
    """Return the line about two groups that several numberings fit, with the fix."""
    names = " and ".join(", ".join(group.cameras) for group in (link.first, link.second))
    count = len(link.shared)
    return (
        f"cameras {names}: the {board.describe()}, may be numbered from more than one end, and their {count} common "
        f"view{'s' * (count != 1)} do not tell which; move and tilt the board between views, or use a board with one "
        "even and one odd side"
    )


def _minimise_turns(group: _Group, turns: tuple[int, ...]) -> dict[tuple[str, int], int]:
    """Return (camera, frame index) → quarter turns, as few as possible per instant, preferably not the first's."""
    turned: dict[tuple[str, int], int] = {}
    for views in group.instants.values():
        options = [[(view.turn + more) % 4 for view in views] for more in turns]
        best = min(options, key=lambda option: (sum(turn != 0 for turn in option), option))
        turned |= {(view.camera, view.frame): turn for view, turn in zip(views, best, strict=True) if turn}
    return turned


def _renumber_views(
    detections: BoardDetections,
    monocular: Mapping[str, MonocularCalibration],
    board: Board,
    frames: Sequence[str],
    turned: Mapping[tuple[str, int], int],
    ambiguities: tuple[str, ...],
) -> Numbering:
    """Return views and board poses after the quarter turns."""
    if not turned:
        return Numbering(detections, monocular, ambiguous=ambiguities)
    views = {name: dict(frame_views) for name, frame_views in detections.views.items()}
    poses = {name: dict(camera.cam_from_board) for name, camera in monocular.items()}
    renumbered = sorted((detections.cameras.index(name), k) for name, k in turned)
    named = tuple((detections.cameras[index], frames[k]) for index, k in renumbered)
    for (name, frame), (_, k) in zip(named, renumbered, strict=True):
        turn = turned[name, k]
        views[name][frame] = turn_corners(views[name][frame], board, turn)
        if frame in poses[name]:
            poses[name][frame] = poses[name][frame] @ make_board_turn(board, turn)
    return Numbering(
        replace(detections, views=views),
        {name: replace(camera, cam_from_board=poses[name]) for name, camera in monocular.items()},
        named,
        ambiguities,
    )
