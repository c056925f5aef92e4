"""The score that counts: a rig found from half of the frames, held against the other half."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from beltscape.calibrate.adjust import Adjusted, adjust
from beltscape.calibrate.chain import solve
from beltscape.calibrate.corners import Sightings
from beltscape.calibrate.score import Score, examine, score
from beltscape.calibrate.uncertainty import depth_moves, rig_covariance, view_points
from beltscape.core.camera import Camera
from beltscape.core.errors import CalibrationError
from beltscape.core.progress import Silent
from beltscape.kernels import Kernels
from beltscape.target.board import Board


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """What two halves of the views say of each other."""

    score: Score
    """Each half judged by the rig of the other."""
    split_ratio: float
    """RMS difference of depths under the two rigs over what the covariances promise; 1 where they are right."""


def held_out_score(
    sightings: Sightings,
    board: Board,
    core: str,
    kernels: Kernels,
    *,
    known: Mapping[str, Camera] | None = None,
) -> HeldOut | None:
    """Even frames judge the rig of the odd ones and the other way round; None where half is too little."""
    frames = [frame for frame in sightings.frames if _cameras_seeing(sightings, frame) > 1]
    halves = frames[::2], frames[1::2]
    try:
        rigs = [
            _rig_of(sightings.restricted(sightings.cameras, train), board, core, known) for train in halves
        ]
        evidence = [
            examine(
                found.rig,
                sightings.restricted(sightings.cameras, test),
                board,
                kernels,
                corners_mm=found.geometry.points_mm,
            )
            for found, test in zip(rigs, halves[::-1], strict=True)
        ]
    except CalibrationError:
        return None
    return HeldOut(score(*evidence), _split_ratio(*rigs, kernels))


def _rig_of(sightings: Sightings, board: Board, core: str, known: Mapping[str, Camera] | None) -> Adjusted:
    return adjust(solve(sightings, board, core, Silent(), known=known), board)


def _split_ratio(first: Adjusted, second: Adjusted, kernels: Kernels) -> float:
    """See `HeldOut.split_ratio`; NaN where the two rigs have no common view."""
    names = list(first.rig.cameras)
    if names != list(second.rig.cameras):
        return float("nan")
    distance = float(np.median(first.geometry.board_translation_mm[:, 2]))
    points = view_points(first.rig, distance, 13)
    pixels = np.stack([first.rig.project_into(second.rig, name, points) for name in names])
    measured = kernels.triangulate(np.stack([second.rig.projection(name) for name in names]), pixels)
    expected = sum(
        np.einsum("ni,ij,nj->n", moves, rig_covariance(each).matrix, moves)
        for each, moves in ((each, depth_moves(each.rig, points)) for each in (first, second))
    )
    ratios = (measured[:, 2] - distance) ** 2 / expected
    return float(np.sqrt(np.nanmean(ratios))) if np.isfinite(ratios).any() else float("nan")


def _cameras_seeing(sightings: Sightings, frame: str) -> int:
    return sum(frame in views for views in sightings.views.values())
