"""The score that counts: a rig found from half of the frames, held against the other half."""

from __future__ import annotations

from beltscape.calibrate.adjust import adjust
from beltscape.calibrate.chain import solve
from beltscape.calibrate.corners import Sightings
from beltscape.calibrate.score import Evidence, Score, examine, score
from beltscape.core.errors import CalibrationError
from beltscape.core.progress import Silent
from beltscape.kernels import Kernels
from beltscape.target.board import Board


def held_out_score(sightings: Sightings, board: Board, core: str, kernels: Kernels) -> Score | None:
    """Even frames judge the rig of the odd ones and the other way round; None where half is too little."""
    frames = [frame for frame in sightings.frames if _cameras_seeing(sightings, frame) > 1]
    halves = frames[::2], frames[1::2]
    try:
        return score(*(_judged(sightings, board, core, kernels, *fold) for fold in (halves, halves[::-1])))
    except CalibrationError:
        return None


def _judged(
    sightings: Sightings, board: Board, core: str, kernels: Kernels, train: list[str], test: list[str]
) -> Evidence:
    """The test frames under the rig, and the board's shape, that the training frames give."""
    known = sightings.restricted(sightings.cameras, train)
    found = adjust(solve(known, board, core, Silent()), known, board)
    unseen = sightings.restricted(sightings.cameras, test)
    return examine(found.rig, unseen, board, kernels, corners_mm=found.geometry.points_mm)


def _cameras_seeing(sightings: Sightings, frame: str) -> int:
    return sum(frame in views for views in sightings.views.values())
