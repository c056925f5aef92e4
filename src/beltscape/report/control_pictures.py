"""Control pictures of a rectification, of the region segmentation, and of a simulated frame.

Epipolar lines before and after, as in the paper's Fig. 6; markers, their labels and the regions' boundaries; the
image of every camera, and the true depth of the core.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.report.drawing.legend import NEAR_TO_FAR, PAPER, Rgb, Scale, draw_text, measure_text
from beltscape.report.drawing.pictures import Panel, arrange_panels, quantile_range, to_rgb
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.markers.grid import SIDE, MarkerGrid, compute_region_outline
from beltscape.stereo.pairwise.rectification import RectifiedImages, count_upright_turns

LINES = 9
"""Number of epipolar lines of a pair."""
_TEXT_PX = 32
"""Height of a warning's text."""
_LINE_PX = 48
"""Distance of a warning's lines."""
_WARNING = (176, 0, 32)
"""Colour of warnings: a dark red, legible on white."""
_COLORS = [(255, 99, 71), (255, 193, 37), (124, 252, 0), (0, 229, 238), (100, 149, 237), (238, 130, 238)]
"""Colours of the lines in turn; neighbours differ in hue."""


def draw_rectification(
    rig: Rig,
    frame_set: FrameSet,
    pairs: list[RectifiedImages],
    consistency: RigConsistency,
    faults: Sequence[str] = (),
) -> Rgb:
    """Draw one row per pair: core and auxiliary with epipolar lines, before (curves) and after (straight rows).

    Corresponding points lie on lines of one colour. Pairs with a vertical baseline are shown upright, so that
    their rows are vertical. Camera faults are written above.
    """
    page = arrange_panels(make_rectification_panels(rig, frame_set, pairs, consistency), 4)
    return np.concatenate([_draw_warnings(faults, page.shape[1]), page]) if faults else page


def _draw_warnings(lines: Sequence[str], width_px: int) -> Rgb:
    """Return the lines as a strip of the given width, wrapped between words."""
    shown: list[str] = []
    for line in lines:
        shown.append("Warning:")
        for word in line.split():
            if measure_text(f"{shown[-1]} {word}", _TEXT_PX) > width_px - 2 * _TEXT_PX:
                shown.append(word)
            else:
                shown[-1] += f" {word}"
    strip = np.full((_LINE_PX * (len(shown) + 1), width_px, 3), PAPER, np.uint8)
    for i, text in enumerate(shown, 1):
        draw_text(strip, text, (_TEXT_PX, _LINE_PX * i), _TEXT_PX, _WARNING)
    return strip


def make_rectification_panels(
    rig: Rig, frame_set: FrameSet, pairs: list[RectifiedImages], consistency: RigConsistency
) -> list[Panel]:
    """Return the four pictures of each pair: core and auxiliary before, core and auxiliary after."""
    panels: list[Panel] = []
    found = {each.camera: each.rows for each in consistency.cameras}
    for images in pairs:
        name, pair = images.pair.auxiliary, images.pair
        before_core, before_aux = _draw_before(rig, frame_set, images)
        after_core, after_aux = _draw_after(images)
        rows = found[name]
        off = f"rows met within {rows.rms_px:.2f} px" if np.isfinite(rows.rms_px) else "rows not measured"
        panels += [
            Panel(before_core, f"before: {pair.core}"),
            Panel(before_aux, f"before: {name}"),
            Panel(after_core, f"after: {pair.core}"),
            Panel(after_aux, f"after: {name}", note=f"{off} ({rows.explained} points)"),
        ]
    return panels


def _draw_after(images: RectifiedImages) -> tuple[Rgb, Rgb]:
    turns = count_upright_turns(images.pair)
    width, height = images.pair.size_px
    shown: list[Rgb] = []
    for image in (images.core, images.auxiliary):
        rgb = to_rgb(image)
        for i, v in enumerate(_line_rows(height)):
            cv2.line(rgb, (0, v), (width - 1, v), _COLORS[i % len(_COLORS)], 2, cv2.LINE_AA)
        shown.append(np.ascontiguousarray(np.rot90(rgb, turns)))
    return shown[0], shown[1]


def _draw_before(rig: Rig, frame_set: FrameSet, images: RectifiedImages) -> tuple[Rgb, Rgb]:
    """Draw the same lines in the original images, at the source of each rectified row."""
    shown: list[Rgb] = []
    for name, source in (
        (images.pair.core, images.pair.core_map),
        (images.pair.auxiliary, images.pair.aux_map),
    ):
        rgb = to_rgb(frame_set.images[name])
        for i, v in enumerate(_line_rows(images.pair.size_px[1])):
            _draw_inside(rgb, source[v], rig.cameras[name].size_px, _COLORS[i % len(_COLORS)])
        shown.append(rgb)
    return shown[0], shown[1]


def _line_rows(height: int) -> list[int]:
    return [int(v) for v in np.linspace(0, height - 1, LINES + 2)[1:-1]]


def _draw_inside(
    rgb: Rgb, points: NDArray[np.float32], size_px: tuple[int, int], color: tuple[int, int, int]
) -> None:
    inside = ((points > -0.5) & (points < np.array(size_px) - 0.5)).all(axis=1)
    cv2.polylines(rgb, [np.rint(points[inside]).astype(np.int32)], False, color, 2, cv2.LINE_AA)


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


def draw_simulated_frame(frame_set: FrameSet, depth_mm: NDArray[np.float64], columns: int = 3) -> Rgb:
    """Return (H, W, 3) RGB: the cameras' images, brightened, and the core's true depth (H, W)."""
    scale = Scale(*quantile_range(depth_mm), NEAR_TO_FAR)
    panels = [Panel(to_rgb(image), name) for name, image in frame_set.images.items()]
    panels.append(Panel(scale.to_rgb(depth_mm), "true depth, mm", scale))
    return arrange_panels(panels, columns)
