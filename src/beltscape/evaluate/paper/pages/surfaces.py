"""Report sections of Figs. 13 to 16: binocular and multi-camera, with and without speckle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from beltscape.evaluate.paper.density import Density
from beltscape.evaluate.paper.experiments import Paper
from beltscape.evaluate.paper.pages.formatting import (
    ERROR_MM,
    METRICS,
    SCENES,
    UNITS,
    format_metrics,
    format_percent,
    format_ratio,
)
from beltscape.evaluate.paper.pages.pictures import make_depth_panels, make_error_panels
from beltscape.evaluate.paper.surfaces import METHODS, TITLES, ScoredDepth
from beltscape.report.drawing.pictures import Panel
from beltscape.report.page import Item, Pictures, Section, Table

FIGURES = {"belt_empty": 13, "belt_loaded": 14, "module": 15}
"""Scene → number of the paper's figure."""


def make_completeness_section(paper: Paper) -> list[Section]:
    """Return Figs. 13 to 15."""
    rows: list[list[str]] = []
    figures: list[Pictures] = []
    for scene in paper.scenes:
        found = [paper.surfaces[scene, method] for method in METHODS]
        rows += [
            [f"{SCENES[scene]}, {TITLES[one.by]}", *format_metrics(one), format_percent(one.score.false_fill)]
            for one in found
        ]
        caption = (
            f"Fig. {FIGURES[scene]}, {SCENES[scene]}: depth above, error below (full colour at {ERROR_MM:g} "
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
                    f"Fig. 16, {SCENES[scene]}: error without and with speckle, full colour at {ERROR_MM:g} mm.",
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


def _density_row(one: Density, published: float) -> list[str]:
    of_the_paper = (one.speckle.scene, one.speckle.by) == ("belt_loaded", "pairwise")
    return [
        f"{SCENES[one.speckle.scene]}, {TITLES[one.speckle.by]}",
        f"{one.speckle.points:,}",
        f"{one.dark.points:,}",
        format_ratio(one.ratio),
        format_ratio(one.right_ratio),
        f"{published:g} ×" if of_the_paper else "",
    ]
