"""Detection of plain chessboards, to about a pixel, by several detectors in turn."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners

Grid = tuple[int, int]
Grey = NDArray[np.uint8]

_SECTORS = {"sectors": cv2.CALIB_CB_EXHAUSTIVE, "sectors, equalised": cv2.CALIB_CB_NORMALIZE_IMAGE}
_SQUARES = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK


@dataclass(frozen=True, slots=True)
class Attempt:
    """One detector on the image, reduced to at most a share of its size and to a number of pixels."""

    detector: str
    """OpenCV's by squares (`findChessboardCorners`), or by sectors (`findChessboardCornersSB`), thorough or in
    equalised light."""
    share: float
    side_px: int

    def find(self, light: Grey, grid: Grid) -> NDArray[np.float32] | None:
        """Return the corners (n, 2) in the full image; None unless the whole grid is found."""
        scale = self.compute_scale(light)
        if scale < 1:
            light = cv2.resize(light, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if self.detector == "squares":
            found, pixels = cv2.findChessboardCorners(light, grid, flags=_SQUARES)
        else:
            found, pixels = cv2.findChessboardCornersSB(light, grid, flags=_SECTORS[self.detector])
        return ((pixels.reshape(-1, 2) + 0.5) / scale - 0.5).astype(np.float32) if found else None

    def compute_scale(self, light: Grey) -> float:
        """Return the factor on the image's size."""
        return min(self.share, self.side_px / max(light.shape))


ATTEMPTS = (
    Attempt("squares", share=1.0, side_px=1000),
    Attempt("sectors", share=0.5, side_px=1000),
    Attempt("sectors, equalised", share=1.0, side_px=2000),
    Attempt("sectors", share=1.0, side_px=2000),
    Attempt("squares", share=1.0, side_px=2000),
)
"""Detectors in turn, by what each finds at what cost: docs/explanation/calibration.md has the table. Equalised light
hides some large boards and shows others. The detector by squares takes seconds at full size in clutter, so it comes
last."""


def find_chessboard(light: Grey, grid: Grid) -> Corners | None:
    """Detect the inner corners of a plain chessboard in a grey image (H, W) to about a pixel; None without it."""
    pixels = _detect_grid(light, grid)
    if pixels is None:
        return None
    spacing = np.linalg.norm(np.diff(pixels.reshape(grid[1], grid[0], 2), axis=1), axis=-1).min()
    half = int(np.clip(spacing / 3, 2, 11))  # the window must not reach the next corner
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    pixels = cv2.cornerSubPix(light, pixels, (half, half), (-1, -1), criteria)
    ordered = _order_from_dark_end(light, _orient_rows(pixels.astype(np.float64), grid), grid)
    return Corners(np.arange(len(ordered), dtype=np.int64), ordered)


def _detect_grid(light: Grey, grid: Grid) -> NDArray[np.float32] | None:
    """Return the corners (n, 2) of the first attempt that finds the whole grid."""
    tried: set[tuple[str, float]] = set()
    for attempt in ATTEMPTS:
        step = attempt.detector, attempt.compute_scale(light)
        pixels = None if step in tried else attempt.find(light, grid)
        if pixels is not None:
            return pixels
        tried.add(step)
    return None


def _orient_rows(pixels: NDArray[np.float64], grid: tuple[int, int]) -> NDArray[np.float64]:
    """Return the corners ordered for the board's front: from columns to rows is clockwise in the image."""
    corners = pixels.reshape(grid[1], grid[0], 2)
    across, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    mirrored = across[0] * down[1] - across[1] * down[0] < 0
    return (corners[:, ::-1] if mirrored else corners).reshape(-1, 2)


def _order_from_dark_end(
    image: NDArray[np.uint8], pixels: NDArray[np.float64], grid: tuple[int, int]
) -> NDArray[np.float64]:
    """Return the corners ordered from the end whose first inner square is dark, which is the same in every camera.

    A board whose sides are both even or both odd looks the same upside down; its order is unchanged.
    """
    columns, rows = grid
    if (columns + rows) % 2 == 0:
        return pixels
    corners = pixels.reshape(rows, columns, 2)
    squares = (corners[:-1, :-1] + corners[1:, 1:] + corners[:-1, 1:] + corners[1:, :-1]) / 4
    u, v = np.rint(squares).astype(int).clip(0, np.array(image.shape[::-1]) - 1).transpose(2, 0, 1)
    values = image[v, u].astype(np.float64)
    parity = np.indices(values.shape).sum(axis=0) % 2
    return pixels if values[parity == 0].mean() < values[parity == 1].mean() else pixels[::-1].copy()
