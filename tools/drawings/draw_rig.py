"""Draw docs/images/rig.svg: core, auxiliaries, projector, belt frame, and the box of ``--across`` and ``--along``.

    python tools/drawings/draw_rig.py

Lengths are those of the simulator's laboratory (`RigSpec`, `BeltSettings`, `ProjectorSpec`), to scale.
"""

from __future__ import annotations

from math import cos, hypot, radians, sin
from pathlib import Path

from sheet import AXIS, BELT, BOX, CAMERA, LIGHT, Sheet, document

from beltscape.simulate.scenario import ProjectorSpec, RigSpec
from beltscape.simulate.solids.belt import BeltSettings

OUT = Path(__file__).parents[2] / "docs/images/rig.svg"
SCALE = 0.46
"""px per mm."""
ACROSS_MM, ALONG_MM = (-250.0, 250.0), (-150.0, 150.0)


def axis_end_on(sheet: Sheet, point: tuple[float, float], name: str, *, towards: bool) -> None:
    """Draw an axis that points at the reader (a dot) or away (a cross)."""
    x, y = sheet.at(point)
    sheet.parts.append(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="#fff" stroke="{AXIS}" stroke-width="2"/>'
    )
    if towards:
        sheet.parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="{AXIS}"/>')
    else:
        sheet.parts.append(
            f'<path d="M{x - 4:.1f} {y - 4:.1f}l8 8m0-8l-8 8" stroke="{AXIS}" stroke-width="1.6"/>'
        )
    sheet.text((point[0] - 20, point[1] - 42), name, "a", "end")


def trough(belt: BeltSettings) -> list[tuple[float, float]]:
    """The empty belt's cross-section, with sharp folds."""
    half, wing = belt.flat_mm / 2, (belt.width_mm - belt.flat_mm) / 2
    x, z = half + wing * cos(radians(belt.wing_deg)), wing * sin(radians(belt.wing_deg))
    return [(-x, z), (-half, 0.0), (half, 0.0), (x, z)]


def camera(sheet: Sheet, place: tuple[float, float], aim: tuple[float, float]) -> None:
    """Draw a camera from the side: its housing behind the lens, its axis dashed to where it aims."""
    length = hypot(aim[0] - place[0], aim[1] - place[1])
    x, y = (aim[0] - place[0]) / length, (aim[1] - place[1]) / length
    corners = [(-60, -28), (-60, 28), (0, 16), (0, -16)]
    sheet.line(
        [(place[0] + a * x - b * y, place[1] + a * y + b * x) for a, b in corners], CAMERA, fill="#cfe0f4"
    )
    sheet.line([place, aim], CAMERA, 1.2, "6 4")


def section(sheet: Sheet, rig: RigSpec, belt: BeltSettings, projector: ProjectorSpec) -> None:
    """Draw the view along the belt: x to the right, z up."""
    aim, core = (0.0, rig.aim_mm), (0.0, rig.height_mm)
    half_view = rig.height_mm * 0.5 * rig.size_px[0] * rig.pitch_um * 1e-3 / rig.focal_mm
    sheet.line([core, (-half_view, 0), (half_view, 0)], "none", 0, fill="#eef4fb")
    heap = [(-210.0, 28.0), (-150, 62), (-80, 96), (-10, 112), (60, 104), (140, 66), (205, 26)]
    sheet.line([*heap, (150, 0), (-150, 0)], "#8a8a8a", 1, fill="#d9d9d9")
    sheet.line(trough(belt), BELT, 5)
    lamp = (projector.position_mm[0], projector.position_mm[2])
    for edge in (-0.5, 0.5):
        sheet.line([lamp, (edge * projector.covers_mm, 0.0)], LIGHT, 1, "2 4")
    for side in (-1, 1):
        camera(sheet, (side * rig.baseline_mm, rig.height_mm), aim)
    camera(sheet, core, (0.0, 0.0))
    corners = [(20, -6), (20, 34), (-20, 34), (-20, -6)]
    sheet.line([(lamp[0] + 30 + x, lamp[1] + y) for x, y in corners], LIGHT, fill="#f6e3b0")
    sheet.text((lamp[0] + 4, lamp[1] + 50), "projector", "l")
    sheet.text((-24, rig.height_mm + 72), "cam0 (core)", "c", "end")
    sheet.text((rig.baseline_mm + 70, rig.height_mm + 72), "cam1 (auxiliary)", "c", "middle")
    sheet.text((-rig.baseline_mm - 70, rig.height_mm + 72), "cam3 (auxiliary)", "c", "middle")
    frame(sheet, (0, 0), (130, 0), (0, 130), ("x", "z"), "y", towards=False)
    frame(
        sheet, core, (105, rig.height_mm), (0, rig.height_mm - 105), ("x core", "z core"), "y", towards=True
    )
    sheet.text(
        (0, -70), "belt frame: origin where the core's optical axis meets the empty belt", "", "middle"
    )
    sheet.text((0, rig.height_mm + 165), "Seen along the belt", "t", "middle")


def frame(
    sheet: Sheet, origin: tuple[float, float], one: tuple[float, float], two: tuple[float, float],
    names: tuple[str, str], end_on: str, *, towards: bool,
) -> None:  # fmt: skip
    """Draw a coordinate frame: two axes in the plane, one at right angles to it."""
    for end, name in zip((one, two), names, strict=True):
        sheet.arrow(origin, end, AXIS)
        sheet.text((end[0] + 10, end[1] + 8), name, "a")
    axis_end_on(sheet, origin, end_on, towards=towards)


def plan(sheet: Sheet, rig: RigSpec, belt: BeltSettings) -> None:
    """Draw the view from above: x to the right, y up."""
    edge, fold, half = trough(belt)[-1][0], belt.flat_mm / 2, 470.0
    sheet.line([(-edge, -half), (-edge, half), (edge, half), (edge, -half)], BELT, 2, fill="#f0f0f0")
    for x in (-fold, fold):
        sheet.line([(x, -half), (x, half)], BELT, 1, "10 6")
    (left, right), (first, last) = ACROSS_MM, ALONG_MM
    sheet.line([(left, first), (left, last), (right, last), (right, first)], BOX, 2, "7 4", fill="#dff0e6")
    sheet.text((left + 8, first + 12), f"--across {left:.0f} {right:.0f} --along {first:.0f} {last:.0f}", "b")
    for k in range(rig.auxiliaries):
        angle = radians(rig.first_deg + 360 * k / rig.auxiliaries)
        place = (rig.baseline_mm * cos(angle), rig.baseline_mm * sin(angle))
        square(sheet, place)
        sheet.text((place[0], place[1] + 36), f"cam{k + 1}", "c", "middle")
    square(sheet, (0.0, 0.0))
    sheet.text((28, -60), "cam0 (core)", "c")
    frame(sheet, (0, 0), (150, 0), (0, 150), ("x", "y"), "z", towards=True)
    sheet.arrow((-edge + 60, half - 200), (-edge + 60, half - 60), BELT)
    sheet.text((-edge + 78, half - 130), "travel, +y")
    sheet.text((0, half + 40), "Seen from above", "t", "middle")


def square(sheet: Sheet, place: tuple[float, float]) -> None:
    """Draw a camera from above."""
    corners = [(-22, -22), (-22, 22), (22, 22), (22, -22)]
    sheet.line([(place[0] + x, place[1] + y) for x, y in corners], CAMERA, fill="#cfe0f4")


def drawing() -> str:
    """Return the drawing as SVG."""
    rig, belt, projector = RigSpec(), BeltSettings(), ProjectorSpec()
    left, right = Sheet(235.0, 480.0, SCALE), Sheet(690.0, 290.0, SCALE)
    section(left, rig, belt, projector)
    plan(right, rig, belt)
    title = "A rig seen along the belt and from above: core, four auxiliaries, projector, belt frame"
    return document(title, (920, 540), [left, right])


if __name__ == "__main__":
    OUT.write_text(drawing())
    print(OUT)
