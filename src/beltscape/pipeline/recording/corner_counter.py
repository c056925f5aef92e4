"""Number of the board's corners in recorded images; how the board is printed is found from the images."""

from __future__ import annotations

from collections.abc import Mapping

from beltscape.calibration.detection.detect_capture import (
    SURE_CORNERS,
    SURE_RATIO,
    list_variants,
    make_two_sided_detector,
)
from beltscape.core.frames import Image
from beltscape.target.board import Board


class CornerCounter:
    """Counts the corners of a board in the images of each shot.

    Keys that board.toml leaves open (``legacy``, ``inverted``) are tried until the shots decide between them.
    """

    def __init__(self, board: Board) -> None:
        self._detectors = [make_two_sided_detector(board, variant) for variant in list_variants(board)]
        self._totals = [0] * len(self._detectors)

    def count(self, images: Mapping[str, Image]) -> dict[str, int]:
        """Return the number of corners by camera, from the front or from behind, under the best print variant."""
        counts: list[dict[str, int]] = []
        for detect in self._detectors:
            found = {name: detect(image) for name, image in images.items()}
            counts.append({name: len(corners) if corners else 0 for name, corners in found.items()})
        self._totals = [total + sum(own.values()) for total, own in zip(self._totals, counts, strict=True)]
        best = max(range(len(counts)), key=lambda i: self._totals[i])
        others = [total for i, total in enumerate(self._totals) if i != best]
        if self._totals[best] >= SURE_CORNERS and self._totals[best] > SURE_RATIO * max(others, default=0):
            self._detectors, self._totals = [self._detectors[best]], [self._totals[best]]
        return counts[best]
