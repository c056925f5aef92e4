"""Selection of board views from running cameras: sharp, still, well-lit and new ones are taken by themselves.

Each frame set gets a verdict: why it is not taken, or that it is. The verdict is the key of a text on the page.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.calibration.detection.corners import Corners
from beltscape.core.arrays import Array
from beltscape.core.frames import Image, to_grey
from beltscape.target.board import Board, corner_points_mm

ViewVerdict = Literal["no_board", "one_camera", "moving", "blurred", "dark", "bright", "known", "taken"]
MIN_SEEN = 8
"""Corners from which a camera counts as seeing the board: as in the next-best view."""
STILL_SHARE = 0.0007
"""Largest mean motion of the corners between two frame sets, over the image's diagonal: half a pixel of 800. Chosen:
corners of a resting board scatter by a twentieth of it, a hand that means to hold still moves by a fifth."""
MAX_EDGE_PX, MAX_EDGE_RATIO = 6.0, 1.6
"""Widest black-to-white edge of the print, in pixels and over the narrowest one of that camera so far. Chosen: motion
by a pixel in the exposure widens an edge of 2.5 pixels by a third."""
MIN_CONTRAST, TOP = 0.12, 0.985
"""Least difference of black and white, and level from which white is saturated, as shares of the range."""
MIN_NOVELTY = 0.08
"""Least RMS distance of the board's outline from that of every view taken before, in some camera, over the image's
diagonal: about a square of a board that fills half the image. Chosen."""
_PATCH = 0.45
"""Half of the patch about a corner, over the distance of neighbouring corners: it reaches no other corner."""
_PATCHES = 24
"""Corners of an image whose edges are measured; their median does not change with more."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewAssessment:
    """Why a frame set is taken, or not."""

    verdict: ViewVerdict
    camera: str = ""
    """The camera that decides, if one does."""
    novelty: float = float("nan")
    """Distance of the outline from the nearest taken view, over the diagonal; NaN: not known."""


@dataclass(frozen=True, slots=True, eq=False)
class PrintAppearance:
    """How the board's print looks in an image."""

    edge_px: float
    """Median width of its edges, as the difference of black and white over the largest slope."""
    black: float
    white: float
    """Levels of black and white, as shares of the range."""


class ViewSelector:
    """Judges frame sets of a board one after the other, and remembers the views that were taken."""

    def __init__(self, board: Board, sizes_px: Mapping[str, tuple[int, int]] | None = None) -> None:
        self._points = corner_points_mm(board)[:, :2]
        self._sizes = dict(sizes_px or {})
        self._before: Mapping[str, Corners] = {}
        self._outlines: list[dict[str, Array]] = []
        self._narrowest_px: dict[str, float] = {}

    @property
    def taken(self) -> int:
        """Number of views taken so far."""
        return len(self._outlines)

    def remember(self, corners: Mapping[str, Corners], sizes_px: Mapping[str, tuple[int, int]]) -> None:
        """Add a view that was taken earlier."""
        self._sizes.update(sizes_px)
        self._outlines.append(self._outline_all(corners))

    def assess(self, images: Mapping[str, Image], corners: Mapping[str, Corners]) -> ViewAssessment:
        """Return the verdict on a frame set; one that is taken is remembered. ``corners``: by camera, if any."""
        self._sizes.update({name: (image.shape[1], image.shape[0]) for name, image in images.items()})
        seen = {name: own for name, own in corners.items() if len(own) >= MIN_SEEN}
        before, self._before = self._before, seen
        if len(seen) < 2:
            return ViewAssessment("one_camera" if seen else "no_board", next(iter(seen), ""))
        if camera := self._find_moving(seen, before):
            return ViewAssessment("moving", camera)
        for name, own in seen.items():
            verdict = self._assess_print(name, measure_print(images[name], own))
            if verdict is not None:
                return ViewAssessment(verdict, name)
        outlines = self._outline_all(seen)
        novelty = self._compute_novelty(outlines)
        if novelty < MIN_NOVELTY:
            return ViewAssessment("known", novelty=novelty)
        self._outlines.append(outlines)
        return ViewAssessment("taken", novelty=novelty)

    def _find_moving(self, seen: Mapping[str, Corners], before: Mapping[str, Corners]) -> str:
        """Return a camera in whose image the board moves, or that did not see it before; empty: it is still."""
        for name, own in seen.items():
            earlier = before.get(name)
            if earlier is None:
                return name
            _, now, then = np.intersect1d(own.ids, earlier.ids, return_indices=True)
            if len(now) < MIN_SEEN // 2:
                return name
            motion = np.linalg.norm(own.pixels[now] - earlier.pixels[then], axis=1).mean()
            if motion > STILL_SHARE * np.hypot(*self._sizes[name]):
                return name
        return ""

    def _assess_print(self, name: str, appearance: PrintAppearance) -> ViewVerdict | None:
        if appearance.white - appearance.black < MIN_CONTRAST:
            return "bright" if appearance.white > TOP else "dark"
        if appearance.white >= TOP:
            return "bright"
        narrowest = min(appearance.edge_px, self._narrowest_px.get(name, appearance.edge_px))
        self._narrowest_px[name] = narrowest
        limit = min(MAX_EDGE_PX, max(MAX_EDGE_RATIO * narrowest, 2.0))
        return "blurred" if appearance.edge_px > limit else None

    def _outline_all(self, corners: Mapping[str, Corners]) -> dict[str, Array]:
        found = {name: self._outline(own) for name, own in corners.items() if len(own) >= MIN_SEEN}
        return {name: outline for name, outline in found.items() if outline is not None}

    def _outline(self, corners: Corners) -> Array | None:
        """Return the places (4, 2) of the board's outermost corners in the image, as far as a homography tells."""
        import cv2

        matrix, _ = cv2.findHomography(self._points[corners.ids], corners.pixels)
        if matrix is None:
            return None
        low, high = self._points.min(axis=0), self._points.max(axis=0)
        ends = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
        return np.asarray(cv2.perspectiveTransform(ends[None], matrix)[0], np.float64)

    def _compute_novelty(self, outlines: Mapping[str, Array]) -> float:
        """Return the least over all taken views of the largest distance in any camera; ∞ without views."""
        distances = [
            max((self._compare(name, own, taken.get(name)) for name, own in outlines.items()), default=0.0)
            for taken in self._outlines
        ]
        return min(distances, default=float("inf"))

    def _compare(self, name: str, first: Array, second: Array | None) -> float:
        """Return the RMS distance of two outlines over the image's diagonal; 1 where one camera did not see it."""
        if second is None:
            return 1.0
        return float(np.sqrt(np.square(first - second).sum(axis=1).mean()) / np.hypot(*self._sizes[name]))


def measure_print(image: Image, corners: Corners) -> PrintAppearance:
    """Return how the print looks about the corners: width of its edges, levels of black and white."""
    grey = to_grey(image) / np.float32(np.iinfo(image.dtype).max)
    spacing = _find_spacing(corners.pixels)
    half = max(3, round(_PATCH * spacing))
    step = max(1, len(corners) // _PATCHES)
    widths: list[float] = []
    levels: list[tuple[float, float]] = []
    for u, v in np.rint(corners.pixels[::step]).astype(int):
        patch = grey[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1]
        if min(patch.shape) < 4:
            continue
        black, white = np.quantile(patch, [0.1, 0.9])
        levels.append((float(black), float(white)))
        widths.append(float((white - black) / max(_find_steepness(patch), 1e-6)))
    if not widths:
        return PrintAppearance(float("inf"), 0.0, 0.0)
    black, white = np.median(levels, axis=0)
    return PrintAppearance(float(np.median(widths)), float(black), float(white))


_DIRECTIONS = np.arange(12) * np.pi / 12
"""Directions in which the slope is looked for; its least differs by 1 % with more."""


def _find_steepness(patch: Array | np.ndarray) -> float:
    """Return the largest slope per pixel about a corner, which a blur in one direction lowers as well.

    A corner has two edges at right angles, with the slopes S and s. The least over all directions of the largest
    slope in a direction is S s / √(S² + s²), however the board is turned; of equal ones it is S / √2.
    """
    down, across = np.diff(patch, axis=0)[:, :-1], np.diff(patch, axis=1)[:-1]
    most = [np.abs(np.cos(a) * across + np.sin(a) * down).max() for a in _DIRECTIONS]
    return float(np.sqrt(2) * min(most))


def _find_spacing(pixels: Array) -> float:
    """Return the median distance of a corner from its nearest neighbour, px."""
    from scipy.spatial import KDTree

    distances, _ = KDTree(pixels).query(pixels, k=2)
    return float(np.median(np.asarray(distances)[:, 1]))
