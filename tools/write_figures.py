"""Write the manual's tables that come from benchmarks/RESULTS.md and from the catalogue of alarms.

They stand between ``figures: NAME`` and ``end``:

python tools/write_figures.py
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path

from beltscape.core.alarm_catalogue import (
    CHECKS,
    DEFINITIONS,
    GROUPS,
    KINDS,
    STATES,
    UNMEASURED,
    list_suppressed,
)
from beltscape.core.alarms import PRIORITIES
from beltscape.plan.plan import Plan, make_plan, plan_to_document
from beltscape.plan.settings import PlanSettings

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks/RESULTS.md"
PAGES = (
    "README.md", "docs/explanation/matching.md", "docs/reference/figures_matching.md",
    "docs/explanation/measuring.md", "docs/explanation/running.md", "docs/explanation/calibration.md",
    "docs/howto/choose.md", "docs/howto/alarms.md", "docs/reference/plants.md",
)  # fmt: skip
_MARKED = re.compile(r"(<!-- figures: (\w+) -->\n).*?(?= *<!-- end -->)", re.S)
_SCENES = {"belt_empty": "empty belt", "module": "module", "belt_loaded": "loaded belt"}
_METHODS = ("multiview fast", "multiview standard", "pairwise")
_SHARES = ("< 1 mm", "< 0.25 mm", "median mm", "gross", "measured", "over fifths")
_HEADS = ("< 1 mm", "< 0.25 mm", "median mm", "gross", "measured", "σ ratio")

_PARTS = (
    "belt",
    "cameras",
    "lens",
    "place",
    "light",
    "σ of depth",
    "computer, two views of every millimetre",
)


def _describe_rig(
    belt: tuple[float, float, float, float, float], size_px: tuple[int, int], focal_mm: float
) -> PlanSettings:
    """Return a plan's settings: belt width, span, flat, load in mm and speed in m/s; image size and focal length."""
    width, span, flat, load, speed = belt
    return PlanSettings.model_validate(
        {
            "frames_per_point": 2,
            "belt": {
                "width_mm": width,
                "span_mm": span,
                "flat_mm": flat,
                "material_mm": (0, load),
                "speed_m_s": speed,
            },
            "camera": {"size_px": size_px, "focal_mm": focal_mm, "f_number": 1.4},
            "light": {"projector_lm": 100_000},
        }
    )


RIGS = {
    "small": _describe_rig((650, 620, 240, 120, 2), (1440, 1080), 6),
    "medium": _describe_rig((1000, 920, 370, 200, 3), (2448, 2048), 8),
    "large": _describe_rig((1400, 1270, 500, 300, 5), (2448, 2048), 8),
}
"""Three classes of belts; spans and flats are those of three-roll troughs of 25 to 30°."""


def section(results: str, heading: str) -> list[list[str]]:
    """Return the cells of every table row below a heading, up to the next one."""
    text = results.split(f"{heading}", 1)[1]
    text = re.split(r"^#", text, maxsplit=1, flags=re.M)[0]
    return [
        [cell.strip() for cell in line.strip().strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("|")
    ]


def state(results: str, heading: str) -> str:
    """Return the sentence that says when a section was measured."""
    found = re.search(r"\*Measured at commit (\w+\+?) on ([\d-]+)", results.split(f"\n## {heading}\n", 1)[1])
    if found is None:
        raise ValueError(f"{RESULTS}: {heading} does not say when it was measured")
    return f"*Measured at commit {found[1]} on {found[2]} (`benchmarks/RESULTS.md`).*\n"


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def presets(results: str) -> str:
    """Return the table of whole frames of 1224×1024 by scene and method."""
    rows = []
    for scene, name in _SCENES.items():
        found = _whole_frames(results, scene)
        for method in _METHODS:
            own = method.removeprefix("multiview "), *(found[method][key] for key in (*_SHARES, "× HH"))
            rows.append([name if method == _METHODS[0] else "", *own])
    return table(["scene", "", *_HEADS, "× HH"], rows) + "\n" + state(results, "Whole frames")


def standard(results: str) -> str:
    """Return the table of whole frames of 1224×1024 with the preset standard."""
    found = {name: _whole_frames(results, scene)["multiview standard"] for scene, name in _SCENES.items()}
    rows = [[name, *(line[key] for key in _SHARES)] for name, line in found.items()]
    return table(["scene", *_HEADS], rows) + "\n" + state(results, "Whole frames")


def _whole_frames(results: str, scene: str) -> dict[str, dict[str, str]]:
    """Return the cells of a scene of 1224×1024 by method and column."""
    head, _, *cells = section(results, f"\n### {scene}, 1224×1024")
    return {line[0]: dict(zip(head, line, strict=True)) for line in cells}


def volumes(results: str) -> str:
    """Volumes of the rendered set, preset standard, against the truth."""
    text = results.split("\n| volume |", 1)[1]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()[2:10]]
    rows = []
    for scene, size, method, _, sigma, true, error, coverage in cells:
        if method == "multiview standard":
            relative = f"{100 * float(sigma) / float(true):.2f} %"
            rows.append(
                [
                    f"rendered set, {_SCENES[scene]}",
                    size,
                    error.replace("%", " %"),
                    relative,
                    coverage.replace("%", " %"),
                ]
            )
    return table(["", "images", "error", "σ", "measured"], rows) + "\n" + state(results, "Whole frames")


def speed(results: str) -> str:
    """Frame sets a second of the running system."""
    _, _, *cells = section(results, "\n## Running system")
    sizes = {"612 px": "612×512", "1224 px": "1224×1024"}
    rows = [[sizes[size], preset, sets, cpu, f"{memory} GiB"] for size, preset, sets, cpu, _, memory in cells]
    return (
        table(["images", "preset", "frame sets/s", "CPU s a set", "memory"], rows)
        + "\n"
        + state(results, "Running system")
    )


def calibration(results: str) -> str:
    """The rig of the rendered set against the truth."""
    _, _, *cells = section(results, "\n## Calibration")
    named = {
        "pairs through the core": "pairs through the core (the paper's chain)",
        "after global optimisation (Eqs. 17-20)": "after global optimisation",
        "after joint adjustment": "bundle adjustment",
    }
    rows = [[named[line[0]], *line[1:4]] for line in cells if line[0] in named]
    head = ["", "depth RMS / max, mm", "worst rotation, °", "worst centre, mm"]
    return table(head, rows) + "\n" + state(results, "Calibration")


def accuracy(results: str) -> str:
    """Return the README's lines on the accuracy of depth."""
    empty, loaded = (
        _whole_frames(results, scene)["multiview standard"] for scene in ("belt_empty", "belt_loaded")
    )
    lines = (
        "On rendered images 1224 px wide half the depths are right",
        f"to {empty['median mm']} mm on the empty belt and to {loaded['median mm']} mm on rocks, away from edges;",
        f"{loaded['gross']} of what is measured among the rocks is off by more than 5 mm.",
    )
    return "".join(f"{line}\n" for line in lines)


def parts(results: str) -> str:
    """Return the README's table of what makes up a rig, planned for three belts, and what two cores hold."""
    rate = _rate(results)
    rows = [_part_cells(make_plan(settings), rate) for settings in RIGS.values()]
    heads = ["", *RIGS]
    return table(heads, [list(row) for row in zip(_PARTS, *rows, strict=True)])


def _part_cells(plan: Plan, rate: float) -> list[str]:
    document = plan_to_document(plan)
    belt, camera, motion = plan.settings.belt, plan.settings.camera, document["motion"]
    above_mm, lumens = document["mounting"]["above_belt_mm"], document["light"]["needed_lumens"]
    baseline_mm, tilt_deg = document["rig"]["baseline_mm"], document["rig"]["tilt_deg"]
    held_m_s = rate * motion["frame_length_mm"] / 1000 / plan.settings.frames_per_point
    pixels = f"{camera.size_px[0]}×{camera.size_px[1]} px of {camera.pitch_um:g} µm"
    return [
        f"{belt.width_mm:.0f} mm, {belt.material_mm[1]:.0f} mm of load, {belt.speed_m_s:g} m/s",
        f"5 × {pixels}, {motion['data_mb_s']:.0f} MB/s in all",
        f"{camera.focal_mm:g} mm, f/{camera.f_number:g}",
        f"core {above_mm:.0f} mm above the belt, others {baseline_mm:.0f} mm beside it, tilted by {tilt_deg:.0f}°",
        f"{math.ceil(lumens / 1000)},000 lm for {motion['exposure_us']:.0f} µs",
        f"{document['depth_sigma']['in_this_light_mm']:.3f} mm",
        f"{motion['fps']:.1f} frame sets/s; two cores hold {rate:g}, enough for {held_m_s:.1f} m/s",
    ]


def _rate(results: str) -> float:
    """Return the frame sets per second of the running system with the preset fast at 612 px."""
    _, _, *cells = section(results, "\n## Running system")
    return float(next(line[2] for line in cells if line[:2] == ["612 px", "fast"]))


def rigs(results: str) -> str:
    """Return the table of accuracy by the number of cameras."""
    return _choices(results, "Number of cameras", "cameras")


def widths(results: str) -> str:
    """Return the table of accuracy and cost by image width and preset."""
    return _choices(results, "Image width and preset", "width px", "preset")


def _choices(results: str, heading: str, *keys: str) -> str:
    head, _, *cells = section(results, f"\n### {heading}\n")
    columns = (*keys, "< 1 mm", "gross", "measured", "median mm", "σ ratio", "volume", "σ of volume")
    rows = [[dict(zip(head, line, strict=True))[key] for key in columns] for line in cells]
    return table(list(columns), rows) + "\n" + state(results, "Choices")


def plants(results: str) -> str:
    """Return the table of scenes that differ from one plant in one respect each."""
    head, _, *cells = section(results, "\n## Other plants\n")
    columns = "scene", "preset", *head[2:]
    rows = [[dict(zip(head, line, strict=True))[key] for key in columns] for line in cells]
    return table(list(columns), rows) + "\n" + state(results, "Other plants")


def _list_names(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def priorities(_results: str) -> str:
    """Return the table of alarms by their default priority; most checks are medium."""
    rows = [
        [one, _list_names(name for name in (*KINDS, *CHECKS) if DEFINITIONS[name].rationale.priority == one)]
        for one in reversed(PRIORITIES)
        if one != "medium"
    ]
    return table(["priority", "alarms"], [*rows, ["medium", "all others"]])


def groups(_results: str) -> str:
    """Return the table of the groups of alarms, causes before their effects."""
    return table(["group", "alarms"], [[group, _list_names(names)] for group, names in GROUPS.items()])


def suppression(_results: str) -> str:
    """Return the table of what each state of the plant hides."""
    rows: list[list[str]] = []
    for one in STATES:
        hidden = list_suppressed(one)
        others = [name for name in (*KINDS, *CHECKS) if name not in hidden]
        is_most = len(others) < len(hidden)
        rows.append([f"`{one}`", f"all but {_list_names(others)}" if is_most else _list_names(hidden)])
    rows.append(["`unmeasured`", _list_names(UNMEASURED)])
    return table(["while", "are hidden"], rows)


FIGURES = {
    "presets": presets, "standard": standard, "volumes": volumes, "speed": speed, "calibration": calibration,
    "accuracy": accuracy, "parts": parts, "rigs": rigs, "widths": widths,
    "plants": plants, "priorities": priorities, "groups": groups, "suppression": suppression,
}  # fmt: skip


def filled(text: str, results: str) -> str:
    """Return a page with its tables written anew."""
    return _MARKED.sub(lambda found: found[1] + FIGURES[found[2]](results), text)


if __name__ == "__main__":
    results = RESULTS.read_text()
    for page in PAGES:
        (ROOT / page).write_text(filled((ROOT / page).read_text(), results))
