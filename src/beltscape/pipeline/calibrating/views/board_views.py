"""Captures of board views, and the detections of sets of boards as views of single ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.files.capture import Capture, list_camera, list_capture, list_images
from beltscape.target.board import Board, BoardSet


def read_board_views(folder: Path) -> Capture:
    """Read a capture, or a folder of one camera's images, which is named as the folder."""
    images, line = list_camera(folder) if folder.is_dir() else ({}, "")
    if images and not any(list_images(below) for below in folder.iterdir() if below.is_dir()):
        return Capture(folder, {folder.resolve().name: images}, {"": (line,)} if line else {})
    return list_capture(folder)


def has_board_views(folder: Path) -> bool:
    """Return whether a path is a folder of images, or of folders of images."""
    if not folder.is_dir():
        return False
    return bool(list_images(folder)) or any(
        list_images(below) for below in folder.iterdir() if below.is_dir()
    )


def split_boards(detections: BoardDetections, board: Board) -> BoardDetections:
    """Return the detections with a frame for each board of a set: ``frame/board``; of one board as they are."""
    if not isinstance(board, BoardSet):
        return detections
    views = {
        name: {
            f"{frame}/{face.name}": part
            for frame, corners in own.items()
            for face, part in zip(board.faces, _split_corners(corners, board), strict=True)
            if len(part)
        }
        for name, own in detections.views.items()
    }
    return replace(detections, views=views)


def _split_corners(corners: Corners, board: BoardSet) -> list[Corners]:
    face = np.searchsorted(board.offsets, corners.ids, side="right") - 1
    return [corners.select(face == number) for number in range(len(board.faces))]
