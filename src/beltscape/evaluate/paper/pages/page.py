"""The report page: the paper's numbers, its method, Beltscape and the truth beside each other."""

from __future__ import annotations

from beltscape.evaluate.paper.dimensions import largest_error_mm
from beltscape.evaluate.paper.experiments import Paper
from beltscape.evaluate.paper.pages.dimensions import make_table2_section, make_table3_section
from beltscape.evaluate.paper.pages.formatting import SCENES, format_number
from beltscape.evaluate.paper.pages.other_sensors import make_baselines_section, make_moving_section
from beltscape.evaluate.paper.pages.surfaces import make_completeness_section, make_density_section
from beltscape.report.page import Lines, Section, Tile, Tiles, render


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
        tiles.append(Tile(f"{SCENES[scene]}, within 1 mm", f"{100 * ours.within_1mm:.1f}", "%", note))
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
