"""Draw the figures of the pages on matching and measuring into docs/images, from the settings and the geometry.

python tools/drawings/draw_figures.py
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from sheet import AXIS, BELT, BOX, CAMERA, LIGHT, Point, Sheet, document

from beltscape.simulate.scenario import RigSpec
from beltscape.stereo.multiview.optimisation import list_propagation_offsets
from beltscape.stereo.settings import MultiviewSettings

OUT = Path(__file__).parents[2] / "docs/images"
PALE = {CAMERA: "#e6effa", LIGHT: "#fbf0d4", BOX: "#e2f2e8", BELT: "#efefef"}
GREY = "#8a8a8a"


def draw_pyramid() -> str:
    """Return the coarse-to-fine pyramid of the paper's sensor: its grids, and the steps on each of them."""
    settings, width = MultiviewSettings(), RigSpec().size_px[0]
    sheet, grids = Sheet(0, 470, 1.0), settings.grids(width)
    sheet.text((150, 440), "Grids, px wide", "t", "middle")
    sheet.text((600, 440), "Steps on each grid", "t", "middle")
    tops = [375 - 120 * i for i in range(grids)]
    for i, top in enumerate(tops):
        factor = 2 ** (grids - 1 - i)
        _grid(sheet, (145, top - 38), 112 / factor, cells=6 * 2**i, label=f"{width // factor}")
        _steps(
            sheet, top, ("plane sweep on", "small images") if i == 0 else ("surface of the", "coarser grid")
        )
    for upper, lower in pairwise(tops):
        turn = (upper + lower) / 2 - 38
        sheet.line([(705, upper - 60), (705, turn), (345, turn)], CAMERA, 1.6)
        sheet.arrow((345, turn), (345, lower - 16), CAMERA, 1.6, 8)
        sheet.text((525, turn + 4), "each pixel's plane covers 2×2 pixels of the next grid", "s c", "middle")
    last = tops[-1] - 38
    sheet.arrow((755, last), (782, last), BELT, 1.6, 8)
    sheet.box((785, last - 45), (912, last + 45), BELT, PALE[BELT], (
        "selection of", "candidates, twicing,", "features,", "σ and confidence",
    ))  # fmt: skip
    return document(
        "Coarse-to-fine pyramid: grids, and noise, propagation and least squares on each", (920, 470), [sheet]
    )


def _grid(sheet: Sheet, centre: Point, half: float, cells: int, label: str) -> None:
    """Draw a grid as a tilted sheet with its width below."""
    lean, height = 0.35, 0.28 * half

    def at(u: float, v: float) -> Point:
        return centre[0] + half * u * 0.8 + lean * half * v, centre[1] + height * v

    sheet.line([at(-1, -1), at(-1, 1), at(1, 1), at(1, -1)], CAMERA, 1.2, fill=PALE[CAMERA])
    for k in range(1, cells):
        t = 2 * k / cells - 1
        sheet.line([at(t, -1), at(t, 1)], CAMERA, 0.4)
        sheet.line([at(-1, t), at(1, t)], CAMERA, 0.4)
    sheet.text((centre[0], centre[1] - height - 16), label, "c", "middle")


def _steps(sheet: Sheet, top: float, start: tuple[str, str]) -> None:
    """Draw the steps on one grid, from the start to the last round."""
    middle, low, high = top - 38, top - 60, top - 16
    boxes = (
        (290, 400, start, CAMERA), (420, 510, ("noise from", "the residuals"), LIGHT),
        (530, 630, ("propagation", "near steps"), BOX), (655, 755, ("least squares", "in windows"), BOX),
    )  # fmt: skip
    for left, right, words, color in boxes:
        sheet.box((left, low), (right, high), color, PALE[color], words)
    for (_, left, *_), (right, *_) in pairwise(boxes):
        sheet.arrow((left, middle), (right, middle), BELT, 1.4, 7)
    sheet.line([(690, high), (690, high + 12), (580, high + 12)], BOX, 1.4)
    sheet.arrow((580, high + 12), (580, high), BOX, 1.4, 7)
    sheet.text((635, high + 16), "rounds", "s b", "middle")


def draw_candidates() -> str:
    """Return the candidate set of a pixel beside a depth step, in the image and as a profile."""
    plan, profile = Sheet(175, 220, 11.0), Sheet(600, 355, 13.0)
    distances = tuple(int(d) for d in MultiviewSettings().distances_px)
    plan.text((0, 14.6), "In the image", "t", "middle")
    size = max(distances) + 2.0
    plan.line([(-size, -size), (-size, size), (EDGE_PX, size), (EDGE_PX, -size)], "none", 0, fill=PALE[LIGHT])
    plan.line([(EDGE_PX, -size), (EDGE_PX, size), (size, size), (size, -size)], "none", 0, fill=PALE[BELT])
    for du, dv in list_propagation_offsets(distances).tolist():
        color = LIGHT if du < EDGE_PX else GREY
        plan.line([(du, -dv), (0, 0)], color, 0.8, "2 3")
        plan.dot((du, -dv), color)
    plan.dot((0, 0), AXIS, 5)
    plan.text((0.6, 0.7), "p", "a")
    plan.text((-size + 0.4, size - 1.4), "stone", "l")
    plan.text((size - 0.4, size - 1.4), "belt", "", "end")
    plan.text((0, -size - 1.6), "neighbours " + " and ".join(map(str, distances)) + " px away", "s", "middle")
    profile.text((0, 25.2), "Along a row of the image", "t", "middle")
    _profile(profile, distances)
    return document("Candidate surfaces of a pixel beside a depth step", (920, 420), [plan, profile])


EDGE_PX, TRUE_PX = -1.5, 1.5
"""Where the present surface has its step, and where the true one is: p at 0 lies on the wrong side."""


def stone(u: float) -> float:
    """Return the stone's inverse depth (drawing units)."""
    return 15.0 + 0.22 * u


def belt(u: float) -> float:
    """Return the belt's inverse depth (drawing units)."""
    return 4.5 + 0.05 * u


def _profile(sheet: Sheet, distances: tuple[int, ...]) -> None:
    """Draw both surfaces, the present one, and the candidates at p."""
    reach = max(distances) + 3.0
    sheet.arrow((-reach, 0), (reach + 1, 0), BELT, 1.2, 8)
    sheet.text((reach + 1, -1.2), "image column u, px", "s", "end")
    sheet.arrow((-reach, 0), (-reach, 22), BELT, 1.2, 8)
    sheet.text((-reach + 0.5, 21.6), "inverse depth s, px", "s")
    sheet.line([(-reach, stone(-reach)), (EDGE_PX, stone(EDGE_PX))], LIGHT, 4)
    sheet.line([(EDGE_PX, belt(EDGE_PX)), (reach, belt(reach))], GREY, 4)
    sheet.line(
        [(EDGE_PX, stone(EDGE_PX)), (TRUE_PX, stone(TRUE_PX)), (TRUE_PX, belt(TRUE_PX))], LIGHT, 1.2, "5 4"
    )
    sheet.text((TRUE_PX + 0.4, 10), "true step", "s l")
    sheet.line([(0, -0.5), (0, 20)], AXIS, 0.8, "3 3")
    sheet.text((0, -1.4), "p", "a", "middle")
    for distance in distances:
        for u, surface, color in ((-distance, stone, LIGHT), (distance, belt, GREY)):
            lift = 0.9 if distance == max(distances) else 0.0
            start = surface(u)
            sheet.dot((u, start), color)
            sheet.arrow((u, start + lift), (-0.15 if u < 0 else 0.15, surface(0) + lift), color, 1.2, 7)
    sheet.dot((0, belt(0)), AXIS, 5)
    sheet.dot((0, stone(0)), AXIS, 5, "#fff")
    sheet.text((0.7, stone(0) + 2.6), "candidates from the stone:", "s l")
    sheet.text((0.7, stone(0) + 1.4), "s(q) + slope(q) · (p − q)", "s l")
    sheet.text((0.7, belt(0) - 1.7), "own surface of p, and", "s")
    sheet.text((0.7, belt(0) - 2.9), "candidates from the belt", "s")


def draw_hole() -> str:
    """Return a section through a hole in the height map: its rims and the range that they leave open."""
    sheet, x = Sheet(-275, 345, 2.9), np.arange(125.0, 385.0, 0.25)
    height = np.maximum(_rock(x, 235.0, 52.0, 92.0), _rock(x, 376.0, 34.0, 42.0))
    seen = _visible(x, height, CORE)
    ground = [(float(x[-1]), 0.0), (float(x[0]), 0.0)]
    sheet.line([*_points(x, height), *ground], "none", 0, fill="#ececec")
    ((start, end),) = _runs(~seen)
    upper, lower = _points(x, height)[start - 1], _points(x, height)[end]
    sheet.line([upper, (lower[0], upper[1]), lower, (upper[0], lower[1])], BOX, 0.8, "2 3", fill="#dff0e6")
    for first, last in _runs(seen):
        sheet.line(_points(x, height)[first:last], BELT, 3.5)
    sheet.line(_points(x, height)[start - 1 : end + 1], GREY, 1.5, "4 4")
    _ray(sheet, upper, lower)
    _labels(sheet, upper, lower)
    return document("A hole in the height map with its rims", (920, 415), [sheet])


CORE: Point = (0.0, float(RigSpec().height_mm))
"""Centre of the core camera, mm across and above the belt."""


def _points(x: np.ndarray, height: np.ndarray) -> list[Point]:
    """Return a profile (N,), (N,) as points."""
    return list(zip(x.tolist(), height.tolist(), strict=True))


def _rock(x: np.ndarray, centre: float, half: float, height: float) -> np.ndarray:
    """Return the heights (N,) of a rounded block."""
    return height * np.sqrt(np.clip(1 - np.abs((x - centre) / half) ** 4, 0, None))


def _visible(x: np.ndarray, height: np.ndarray, camera: Point) -> np.ndarray:
    """Return which points of the profile (N,) the camera sees, to its right: none before them subtends less."""
    tangent = (x - camera[0]) / (camera[1] - height)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(tangent)[:-1]])
    return tangent >= before


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Return (start, end) of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _ray(sheet: Sheet, upper: Point, lower: Point) -> None:
    """Draw the core's ray over the upper rim down to the lower rim."""
    slope, high = (upper[0] - CORE[0]) / (CORE[1] - upper[1]), 112.0
    start = (upper[0] - slope * (high - upper[1]), high)
    sheet.arrow(start, lower, CAMERA, 1.4, 9, "7 4")
    sheet.text((start[0] + 4, high - 3), "ray of the core camera", "s c")


def _labels(sheet: Sheet, upper: Point, lower: Point) -> None:
    """Name the rims, the gap and the open range."""
    for rim in (upper, lower):
        sheet.dot(rim, AXIS, 5)
    sheet.text((upper[0] - 5, upper[1] - 2), "upper rim", "r", "end")
    sheet.text((lower[0] + 3, lower[1] - 7), "lower rim", "r")
    middle = (upper[0] + lower[0]) / 2
    for rim in (upper, lower):
        sheet.arrow((middle, -6), (rim[0], -6), AXIS, 1.2, 8)
    sheet.text((middle, -12), "gap", "s r", "middle")
    sheet.text((lower[0] + 5, upper[1] - 3), "open range: the surface in the gap", "s b")
    sheet.text((lower[0] + 5, upper[1] - 8.5), "lies between both rims", "s b")
    sheet.text((235, 30), "rock", "", "middle")
    sheet.text((366, 14), "rock", "", "middle")
    sheet.line([(130, -18), (142, -18)], BELT, 3.5)
    sheet.text((145, -19.5), "measured", "s")
    sheet.line([(175, -18), (187, -18)], GREY, 1.5, "4 4")
    sheet.text((190, -19.5), "hidden from the core camera", "s")


def draw_continuation() -> str:
    """Return a section of the fused belt: planes through the ends of a hole, and what they predict in its cells."""
    sheet = Sheet(10, 405, 9.0)
    for ends in (((0, 41), (30, 34)), ((52, 10), (98, 13))):
        sheet.line(ends, BELT, 3.5)
    sheet.line([(30, 34), (38, 32.2), (40, 9.2), (52, 10)], GREY, 1.5, "4 4")
    sheet.line([(30, 34), (53, 28.6)], CAMERA, 1.4, "7 4")
    sheet.line([(52, 10), (29, 8.5)], LIGHT, 1.4, "7 4")
    for x in range(32, 52, 4):
        upper, lower = 34 - 7 / 30 * (x - 30), 10 - 3 / 46 * (52 - x)
        sheet.dot((x, upper), CAMERA, 5, CAMERA if x < 40 else "#fff")
        sheet.dot((x, lower), LIGHT, 5, LIGHT if x > 38 else "#fff")
    for x, height in ((30, 34), (52, 10)):
        sheet.line([(x, 1), (x, height)], AXIS, 0.8, "3 3")
        sheet.dot((x, height), AXIS, 5)
        sheet.arrow((41, 1), (x, 1), AXIS, 1.2, 8)
    sheet.text((41, -1.5), "cells that no frame measured", "s r", "middle")
    sheet.text((4, 42), "measured in some frame", "s")
    sheet.text((54, 29), "what the upper plane predicts:", "s c")
    sheet.text((54, 27.3), "filled dots are taken", "s c")
    sheet.text((28, 7), "what the lower plane predicts", "s l", "end")
    sheet.line([(39.5, 20), (53, 21)], GREY, 0.8)
    sheet.text((54, 20.7), "the true surface", "s")
    return document("Continuation of measured planes into the cells of a hole", (920, 460), [sheet])


FIGURES: dict[str, Callable[[], str]] = {
    "pyramid.svg": draw_pyramid, "candidates.svg": draw_candidates, "hole.svg": draw_hole,
    "continuation.svg": draw_continuation,
}  # fmt: skip


if __name__ == "__main__":
    for name, draw in FIGURES.items():
        (OUT / name).write_text(draw())
        print(OUT / name)
