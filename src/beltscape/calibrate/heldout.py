"""The score that counts: a rig found from half of the frames, held against the other half."""

from __future__ import annotations

from beltscape.calibrate.chain import solve
from beltscape.calibrate.corners import Sightings
from beltscape.calibrate.score import Score, examine, score
from beltscape.core.errors import CalibrationError
from beltscape.core.progress import Silent
from beltscape.kernels import Kernels
from beltscape.target.board import Board


def held_out_score(sightings: Sightings, board: Board, core: str, kernels: Kernels) -> Score | None:
    """Even frames judge the rig of the odd ones and the other way round; None where half is too little."""
    frames = [frame for frame in sightings.frames if _cameras_seeing(sightings, frame) > 1]
    halves = frames[::2], frames[1::2]
    try:
        return score(
            *(
                examine(
                    solve(sightings.restricted(sightings.cameras, train), board, core, Silent()).rig,
                    sightings.restricted(sightings.cameras, test),
                    board,
                    kernels,
                )
                for train, test in (halves, halves[::-1])
            )
        )
    except CalibrationError:
        return None


def _cameras_seeing(sightings: Sightings, frame: str) -> int:
    return sum(frame in views for views in sightings.views.values())
