"""Detection of the board in the images of several cameras; views from behind are distinguished from mirrored ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.detection.detect_capture import detect_board
from beltscape.calibration.detection.detector import PrintVariant
from beltscape.calibration.detection.domain import drop_beyond_domains
from beltscape.calibration.network.two_sided.back_views import Side, classify_back_views
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Reporter
from beltscape.files.capture import Capture
from beltscape.target.board import Board, BoardSet


def detect_rig_board(
    capture: Capture, board: Board, reporter: Reporter, *, known: Mapping[str, Camera] | None = None
) -> tuple[BoardDetections, PrintVariant]:
    """Detect the board in the images of a rig's cameras; the views of mirroring cameras are left out with a warning.

    Corners beyond the lens's domain of a ``known`` camera are left out.

    Raises
    ------
    InputError
        When no image shows the board, or all images are mirrored.
    """
    detections, variant = detect_board(capture, board, reporter)
    detections = drop_beyond_domains(detections, known or {})
    if isinstance(board, BoardSet):
        return detections, variant
    sides = classify_back_views(detections, board, known)
    seeing = [name for name, views in detections.views.items() if views]
    if sides and set(seeing) == set(sides):
        raise InputError(
            f"{capture.folder}: every camera finds the board in mirrored images only; switch mirroring off in the "
            "cameras, or, if all see a board of glass from behind, turn it round"
        )
    mirrored: dict[str, Side] = {name: side for name, side in sides.items() if side != "behind"}
    for name, side in mirrored.items():
        reporter.warn(f"{capture.folder / name}: {_describe(side)}")
    views = {name: own for name, own in detections.views.items() if name not in mirrored}
    views = {name: views.get(name, {}) for name in detections.views}
    return replace(detections, views=views), variant


def _describe(side: Side) -> str:
    if side == "mirrored":
        return "the images are mirrored; switch mirroring off in the camera"
    return (
        "the board is found in mirrored images only, and fewer than three views shared with another camera tell "
        "whether the camera mirrors or sees it from behind; going on without these views"
    )
