"""Report sections of the baseline sensors, and of structured light on a moving belt."""

from __future__ import annotations

import numpy as np

from beltscape.evaluate.paper.experiments import TRAVELS_MM, Paper
from beltscape.evaluate.paper.other_sensors import BASELINES, SPEED_MM_S
from beltscape.evaluate.paper.pages.dimensions import make_baseline_table
from beltscape.evaluate.paper.pages.formatting import ERROR_MM, METRICS, SCENES, UNITS, format_metrics
from beltscape.evaluate.paper.pages.pictures import make_error_panels, make_motion_chart
from beltscape.report.page import Item, Lines, Pictures, Section, Table


def make_baselines_section(paper: Paper) -> list[Section]:
    """Return the baselines' results on every scene; empty if none could be simulated."""
    if not paper.baselines:
        return []
    names = {baseline.name: baseline.name for baseline in BASELINES}
    rows: list[list[str]] = []
    figures: list[Pictures] = []
    for scene in paper.scenes:
        found = [paper.baselines[scene, name] for name in names if (scene, name) in paper.baselines]
        if not found:
            continue
        found = [paper.surfaces[scene, "multiview"], *found]
        titles = {**names, "multiview": "Beltscape"}
        rows += [[f"{SCENES[scene]}, {titles[one.by]}", *format_metrics(one)] for one in found]
        figures.append(
            Pictures(
                make_error_panels(found, titles, limit_mm=ERROR_MM),
                f"{SCENES[scene].capitalize()}: errors, full colour at {ERROR_MM:g} mm.",
                columns=3,
            )
        )
    items: list[Item] = [
        Lines(
            [
                "Beltscape: 5 images at one instant, belt at any speed; speckle, rig calibrated from its own images."
            ]
            + [f"{baseline.name}: {baseline.images}; {baseline.what}." for baseline in BASELINES]
        ),
        Table(["scene, sensor", *METRICS], rows, UNITS),
    ]
    if paper.dimensions and any(
        np.isfinite(row.measured_mm.get(n, np.nan)) for row in paper.dimensions for n in names
    ):
        items.append(make_baseline_table(paper, list(names)))
    intro = (
        "The comparison that the paper names as future work. All look at the same surfaces through the same "
        "lens and sensor and are compared with the same truth on the core's grid; unlike Beltscape's rig, which "
        "is calibrated from images, these are calibrated exactly."
    )
    return [Section("Structured light, line laser, LiDAR", intro, [*items, *figures])]


def make_moving_section(paper: Paper) -> list[Section]:
    """Return structured light over the belt's speed; empty if it could not be simulated."""
    if not paper.moving:
        return []
    ours = paper.surfaces["belt_loaded", "multiview"]
    rows = [
        [
            "at rest" if travel == 0 else f"{travel:g} mm", "" if travel == 0 else f"{SPEED_MM_S / travel:,.0f}",
            *format_metrics(one),
        ]
        for travel, one in zip(TRAVELS_MM, paper.moving, strict=True)
    ]  # fmt: skip
    intro = (
        "Twelve pictures take time. While the belt carries the rocks on, each picture meets them at another "
        "place, and the phases contradict each other. The truth is where the rocks are in the middle of the "
        "sequence. The paper's cameras take 79 pictures a second: 12.7 mm of belt at 1 m/s. Speckle needs one "
        "instant, so that the belt's speed does not matter (but for blur within the exposure)."
    )
    items: list[Item] = [
        make_motion_chart(TRAVELS_MM, paper.moving, ours),
        Table(["belt between pictures", "pictures / s at 1 m/s", *METRICS], rows),
    ]
    return [Section("Structured light on a moving belt", intro, items)]
