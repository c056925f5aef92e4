"""The report page: the paper's numbers, its method, Beltscape and the truth beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beltscape.evaluate.paper.dimensions import PLAIN, DimensionRow, largest_error_mm
from beltscape.evaluate.paper.experiments import TRAVELS_MM, Paper
from beltscape.evaluate.paper.other_sensors import BASELINES, SMOOTHED_PX, SPEED_MM_S, TOF
from beltscape.evaluate.paper.pictures import (
    ERROR_MM,
    METRICS,
    SCENE_NAMES,
    UNITS,
    format_metrics,
    format_number,
    format_percent,
    format_ratio,
    format_signed,
    make_depth_panels,
    make_dimension_chart,
    make_error_panels,
    make_motion_chart,
)
from beltscape.evaluate.paper.surfaces import METHODS, TITLES, DensityComparison, ScoredDepth
from beltscape.report.drawing.pictures import Panel
from beltscape.report.page import Item, Lines, Pictures, Section, Table, Tile, Tiles, render

TOF_ERROR_MM = 10.0
"""Limit of the colour scale of the time-of-flight camera's errors, ten times that of the others."""


def make_table2_section(paper: Paper) -> list[Section]:
    """Return Table 2 as published, by the paper's method and by Beltscape; empty without the module."""
    if not paper.dimensions:
        return []
    columns = [
        "dimension", "true mm", "the paper", "error", "its method", "error", "Beltscape", "error", "σ", "plain too",
    ]  # fmt: skip
    rows = [_table2_row(row) for row in paper.dimensions]
    intro = (
        "“The paper” is its real module, made to ±0.2 mm and measured by hand in CloudCompare. The others are "
        "measured without hints, as `measure features` does: the paper's method from its points alone, "
        "Beltscape with the image that it matched by, and in the last column with an image without speckle, "
        "too. “–”: not found. The last row is the mean of the three steps."
    )
    items: list[Item] = [
        Table(columns, rows),
        make_dimension_chart(
            paper.dimensions, {"pairwise": TITLES["pairwise"] + ", here", "multiview": "Beltscape"}
        ),
    ]
    return [Section("Table 2: dimensions of the calibration module", intro, items)]


def _table2_row(row: DimensionRow) -> list[str]:
    d = row.dimension
    plain = row.error_mm(PLAIN) if PLAIN in row.measured_mm else np.nan
    return [
        d.name, f"{d.actual_mm:g}", f"{d.table2_mm:.3f}", format_signed(d.table2_mm - d.actual_mm),
        format_number(row.measured_mm["pairwise"], 3), format_signed(row.error_mm("pairwise")),
        format_number(row.measured_mm["multiview"], 3), format_signed(row.error_mm("multiview")),
        format_number(row.sigma_mm["multiview"], 3), format_signed(plain),
    ]  # fmt: skip


def make_table3_section(paper: Paper) -> list[Section]:
    """Return Table 3 and Fig. 17; empty without a time-of-flight camera."""
    if paper.tof is None:
        return []
    tof = paper.tof
    items: list[Item] = []
    rows = [_table3_row(row) for row in paper.dimensions]
    columns = [
        "dimension",
        "true mm",
        "paper's camera",
        "error",
        "simulated camera",
        "error",
        "Beltscape error",
    ]
    if rows:
        items.append(Table(columns, rows))
    items += [
        Pictures(
            [
                *make_depth_panels([tof], {TOF: TOF}),
                *make_error_panels([tof], {TOF: TOF}, limit_mm=TOF_ERROR_MM),
            ],
            "Fig. 17: what the camera gives, the truth on its grid, and its error: edges fly, the belt is noisy.",
            columns=3,
        ),
        Table(["surface", *METRICS], [[f"module, {TOF}", *format_metrics(tof)]]),
    ]
    intro = (
        "A camera of the geometry that the paper names (640 × 480, 43° × 33°) with an ordinary camera's "
        "wiggling, multipath, flying pixels and noise: the paper does not state its own. Dimensions are "
        f"measured after a median over {SMOOTHED_PX} × {SMOOTHED_PX} pixels."
    )
    return [Section("Table 3 and Fig. 17: time of flight", intro, items)]


def _table3_row(row: DimensionRow) -> list[str]:
    d = row.dimension
    theirs = np.nan if d.table3_mm is None else d.table3_mm
    return [
        d.name, f"{d.actual_mm:g}", format_number(theirs, 3), format_signed(theirs - d.actual_mm),
        format_number(row.measured_mm[TOF], 3), format_signed(row.error_mm(TOF)),
        format_signed(row.error_mm("multiview")),
    ]  # fmt: skip


def make_baseline_table(paper: Paper, names: Sequence[str]) -> Table:
    """Return the errors of the module's dimensions by Beltscape and the given sensors."""
    columns = ["dimension", "Beltscape", *(name.replace("structured light, ", "") for name in names)]
    rows = [
        [row.dimension.name,
         *(format_signed(row.error_mm(by)) if by in row.measured_mm else "–" for by in ("multiview", *names))]
        for row in paper.dimensions
    ]  # fmt: skip
    text = "Errors of the module's dimensions, mm. For edges structured light has an evenly lit image, too."
    return Table(columns, rows, text)


FIGURES = {"belt_empty": 13, "belt_loaded": 14, "module": 15}
"""Scene → number of the paper's figure."""


def make_completeness_section(paper: Paper) -> list[Section]:
    """Return Figs. 13 to 15."""
    rows: list[list[str]] = []
    figures: list[Pictures] = []
    for scene in paper.scenes:
        found = [paper.surfaces[scene, method] for method in METHODS]
        rows += [
            [
                f"{SCENE_NAMES[scene]}, {TITLES[one.by]}",
                *format_metrics(one),
                format_percent(one.score.false_fill),
            ]
            for one in found
        ]
        caption = (
            f"Fig. {FIGURES[scene]}, {SCENE_NAMES[scene]}: depth above, error below (full colour at {ERROR_MM:g} "
            "mm). The same colours are the same millimetres."
        )
        figures.append(Pictures(make_depth_panels(found, TITLES), columns=len(found) + 1))
        figures.append(
            Pictures(make_error_panels(found, TITLES, limit_mm=ERROR_MM), caption, columns=len(found) + 1)
        )
    intro = (
        "The surface that each scene is about, within 240 mm of the rig along the belt. Shares within 1 and "
        "0.25 mm are of all its true pixels, measured or not; false fill: of the pixels that no other camera "
        "sees, those that yet carry a depth (“–”: all are seen)."
    )
    return [
        Section(
            "Figs. 13 to 15: binocular against multi-camera",
            intro,
            [Table(["scene, method", *METRICS, "false fill"], rows, UNITS), *figures],
        )
    ]


def make_density_section(paper: Paper) -> list[Section]:
    """Return Fig. 16; empty without a scene captured with and without speckle."""
    if not paper.density:
        return []
    rows = [_density_row(one, paper.numbers.density.ratio) for one in paper.density]
    items: list[Item] = [
        Table(
            [
                "scene, method",
                "points with speckle",
                "without",
                "ratio",
                "ratio of points right to 1 mm",
                "the paper",
            ],
            rows,
        )
    ]
    for scene in ("belt_loaded", "belt_empty"):
        pair = [one for one in paper.density if one.speckle.scene == scene and one.speckle.by != "binocular"]
        shown = [(one, on) for one in pair for on in (one.dark, one.speckle)]
        if shown:
            titles = [
                f"{TITLES[one.speckle.by]}, {'no ' if on is one.dark else ''}speckle" for one, on in shown
            ]
            items.append(
                Pictures(
                    _errors([on for _, on in shown], titles),
                    f"Fig. 16, {SCENE_NAMES[scene]}: error without and with speckle, full colour at {ERROR_MM:g} mm.",
                    columns=len(shown),
                )
            )
    intro = (
        "Points on the material, on the belt, on the module, with the projector on and off. The paper's rocks "
        "were 9.5 times as dense with speckle; how much is left without depends on the rocks' own texture, "
        "which here is grainy. Points alone say little: the ratio of points that are right says more."
    )
    return [Section("Fig. 16: with and without speckle", intro, items)]


def _errors(found: Sequence[ScoredDepth], titles: Sequence[str]) -> list[Panel]:
    named = [replace(one, by=title) for one, title in zip(found, titles, strict=True)]
    return make_error_panels(named, {t: t for t in titles}, limit_mm=ERROR_MM)


def _density_row(one: DensityComparison, published: float) -> list[str]:
    of_the_paper = (one.speckle.scene, one.speckle.by) == ("belt_loaded", "pairwise")
    return [
        f"{SCENE_NAMES[one.speckle.scene]}, {TITLES[one.speckle.by]}",
        f"{one.speckle.points:,}",
        f"{one.dark.points:,}",
        format_ratio(one.ratio),
        format_ratio(one.right_ratio),
        f"{published:g} ×" if of_the_paper else "",
    ]


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
        rows += [[f"{SCENE_NAMES[scene]}, {titles[one.by]}", *format_metrics(one)] for one in found]
        figures.append(
            Pictures(
                make_error_panels(found, titles, limit_mm=ERROR_MM),
                f"{SCENE_NAMES[scene].capitalize()}: errors, full colour at {ERROR_MM:g} mm.",
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


def render_paper_page(paper: Paper) -> str:
    """Return report.html."""
    sections = [
        Section("At a glance", "", [_tiles(paper)]),
        *make_table2_section(paper),
        *make_table3_section(paper),
        *make_completeness_section(paper),
        *make_density_section(paper),
        *make_baselines_section(paper),
        *make_moving_section(paper),
        _conditions(paper),
    ]
    return render(
        "The paper's experiments, against the truth", _summarise(paper), sections, warnings=paper.warnings
    )


def _summarise(paper: Paper) -> str:
    text = (
        f"Section 3 of {paper.numbers.source}, in a rendered laboratory whose truth is exactly known. “The "
        "paper” is what it published from its real rig; “the paper's method” is its pairwise matching and "
        "averaging, run here; “Beltscape” is multi-view matching."
    )
    loaded = [
        paper.surfaces["belt_loaded", m] for m in ("pairwise", "multiview") if "belt_loaded" in paper.scenes
    ]
    if len(loaded) == 2:
        theirs, ours = (one.score.depth.within_1mm for one in loaded)
        wrong = [one.score.depth.gross for one in loaded]
        text += (
            f" Of the rocks' surface {ours:.1%} is right to 1 mm by Beltscape and {wrong[1]:.1%} of what it "
            f"measures is off by more than 5 mm; by the paper's method {theirs:.1%} and {wrong[0]:.1%}."
        )
    return text


def _tiles(paper: Paper) -> Tiles:
    tiles: list[Tile] = []
    if paper.dimensions:
        published = max(abs(r.dimension.table2_mm - r.dimension.actual_mm) for r in paper.dimensions)
        own = largest_error_mm(paper.dimensions, "multiview")
        tiles.append(
            Tile("largest error of Table 2", format_number(own, 3), "mm", f"the paper: {published:.2f} mm")
        )
    for scene in paper.scenes:
        ours, theirs = (paper.surfaces[scene, m].score.depth for m in ("multiview", "pairwise"))
        note = f"the paper's method {theirs.within_1mm:.1%}"
        tiles.append(Tile(f"{SCENE_NAMES[scene]}, within 1 mm", f"{100 * ours.within_1mm:.1f}", "%", note))
    rig = paper.rig_score
    tiles.append(
        Tile("rig, depth error", f"{rig.depth_rms_mm:.3f}", "mm RMS", "calibrated from the board's images")
    )
    return Tiles(tiles)


def _conditions(paper: Paper) -> Section:
    width, height = paper.rig.core_camera.size_px
    seconds = ", ".join(f"{stage} {value:.0f} s" for stage, value in paper.seconds.items())
    lines = [
        f"Images of {width} × {height} px, five cameras, rig calibrated here: "
        f"{paper.rig_score.depth_rms_mm:.4f} mm RMS, "
        f"{paper.rig_score.depth_max_mm:.4f} mm at most, in depth over the working volume.",
        f"Time: {seconds}.",
        "Structured light by Zuo et al., Optics and Lasers in Engineering 109, 2018, "
        "doi:10.1016/j.optlaseng.2018.04.019, and 85, 2016, doi:10.1016/j.optlaseng.2016.04.022; its "
        "projector's light is taken to be linear.",
        "Line laser: speckle noise by Dorsch, Häusler & Herrmann, Applied Optics 33(7), 1994, "
        "doi:10.1364/AO.33.001306; the ambient light is taken to be filtered out.",
        "LiDAR: field of view and angular step as SICK's LMS4000 (operating instructions 8023198); range "
        "noise, spot and profile rate are assumed, and so is that coal is bright enough.",
        "Not simulated: light from surface to surface (but for time of flight), gloss, dust, a plant's lights.",
    ]
    return Section("Conditions", "", [Lines(lines)])
