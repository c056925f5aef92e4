"""3-D scenes of a calibration's report: the rig with its boards, and the recommended next view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.uncertainty.next_best_view import NextBestView
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.report.drawing.scene import Scene, make_rig_scene
from beltscape.report.page import InteractiveScene
from beltscape.target.board import Board, outline_corners


def make_next_view_scene(
    adjustment: BundleAdjustmentResult, board: Board, following: NextBestView
) -> InteractiveScene:
    """Return the rig with the recommended pose of the board."""
    outline = following.core_from_board.apply(_outline_board(adjustment, board))
    middle = float(np.median(np.linalg.norm(adjustment.geometry.board_translation_mm, axis=1)))
    return InteractiveScene(
        make_rig_scene(adjustment.rig, length_mm=0.3 * middle, boards_mm={"next": outline}),
        "The recommended pose of the board.",
    )


def _outline_board(adjustment: BundleAdjustmentResult, board: Board) -> NDArray[np.float64]:
    """Return the closed outline (n, 3) of the board's corners in its own frame."""
    return adjustment.geometry.points_mm[outline_corners(board)]


def make_board_scene(adjustment: BundleAdjustmentResult, board: Board) -> Scene:
    """Return the rig with the outline of the board in every frame."""
    geometry, outline = adjustment.geometry, _outline_board(adjustment, board)
    boards = {
        frame: outline @ rotation.T + translation
        for frame, rotation, translation in zip(
            adjustment.frames, geometry.board_rotation, geometry.board_translation_mm, strict=True
        )
    }
    middle = float(np.median(np.linalg.norm(geometry.board_translation_mm, axis=1)))
    return make_rig_scene(adjustment.rig, length_mm=0.3 * middle, boards_mm=boards)
