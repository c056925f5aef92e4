"""The control picture of the region segmentation: markers, their labels and the regions' boundaries."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet, Image
from beltscape.report.drawing.legend import Rgb
from beltscape.report.drawing.pictures import Panel, arrange_panels, to_rgb
from beltscape.stereo.markers.grid import SIDE, MarkerGrid
from beltscape.stereo.markers.regions import compute_region_outline

_DETECTED, _PREDICTED = (80, 255, 120), (255, 160, 60)
"""Colours of detected and predicted markers: green and orange, bright on grey images."""
_BOUNDARY = (90, 190, 255)
"""Colour of the regions' boundaries, distinct from both."""
_DRAWN_WIDTH_PX = 900
"""Width of a drawn camera: two fit a screen."""
_FARTHEST_PX = 30_000.0
"""Bound of drawn coordinates, since OpenCV draws with 16 bits before the binary point."""


def draw_regions(frame_set: FrameSet, grids: Mapping[str, MarkerGrid], columns: int = 3) -> Rgb:
    """Return every camera of a frame with its regions, (H, W, 3) RGB, in rows of ``columns``."""
    panels: list[Panel] = []
    for name, image in frame_set.images.items():
        grid = grids.get(name)
        text = "no markers" if grid is None else f"{grid.count} of {SIDE * SIDE} markers"
        panels.append(
            Panel(to_rgb(image) if grid is None else draw_camera_regions(image, grid), f"{name}: {text}")
        )
    return arrange_panels(panels, columns)


def draw_camera_regions(image: Image, grid: MarkerGrid) -> Rgb:
    """Return an image with its regions, (H', W', 3) RGB; detected markers in green, predicted ones in orange."""
    factor = _DRAWN_WIDTH_PX / image.shape[1]
    size = (_DRAWN_WIDTH_PX, round(image.shape[0] * factor))
    interpolation = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    rgb = np.ascontiguousarray(cv2.resize(to_rgb(image), size, interpolation=interpolation), np.uint8)
    for row in range(SIDE):
        for column in range(SIDE):
            outline = _to_drawing(compute_region_outline(grid.center_px, row, column), factor)
            cv2.polylines(rgb, [outline], True, _BOUNDARY, 2, cv2.LINE_AA)
    typical = float(np.nanmedian(grid.radius_px))
    for row in range(SIDE):
        for column in range(SIDE):
            u, v = (int(n) for n in _to_drawing(grid.center_px[row, column], factor))
            if grid.detected[row, column]:
                cv2.circle(
                    rgb, (u, v), round(factor * (grid.radius_px[row, column] + 3)), _DETECTED, 2, cv2.LINE_AA
                )
            else:
                cv2.drawMarker(rgb, (u, v), _PREDICTED, cv2.MARKER_TILTED_CROSS, round(factor * typical), 2)
            color = _DETECTED if grid.detected[row, column] else _PREDICTED
            _write(rgb, str(SIDE * row + column), (u + round(1.2 * factor * typical) + 8, v), color)
    return rgb


def _to_drawing(points_px: NDArray[np.float64], factor: float) -> NDArray[np.int32]:
    scaled = (points_px + 0.5) * factor - 0.5
    return np.rint(np.clip(scaled, -_FARTHEST_PX, _FARTHEST_PX)).astype(np.int32)


def _write(rgb: Rgb, text: str, where: tuple[int, int], color: tuple[int, int, int]) -> None:
    """Draw text with a dark rim, legible on speckle, inside the image."""
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.7, 2)
    at = (min(where[0], rgb.shape[1] - width - 4), max(20, min(where[1] + 8, rgb.shape[0] - 6)))
    for ink, thickness in (((0, 0, 0), 5), (color, 2)):
        cv2.putText(rgb, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.7, ink, thickness, cv2.LINE_AA)
