"""The report of the paper's experiments: complete, self-contained, with the published numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.depth_scores import RigScore
from beltscape.evaluate.frame_scores import score_frame
from beltscape.evaluate.paper.dimensions import read_paper_numbers, tabulate_dimensions
from beltscape.evaluate.paper.experiments import TRAVELS_MM, Paper, make_paper_document
from beltscape.evaluate.paper.laboratory import Laboratory, LaboratoryScene
from beltscape.evaluate.paper.other_sensors import BASELINES, TOF
from beltscape.evaluate.paper.page import render_paper_page
from beltscape.evaluate.paper.surfaces import (
    METHODS,
    ScoredDepth,
    compute_density_gains,
    make_empty_depth_map,
)
from beltscape.evaluate.truth import Truth
from beltscape.files.json_text import to_json

SIZE = (48, 36)
WORLD_UP = Pose(np.diag([1.0, -1, -1]), np.array([0.0, 0.0, 700.0]))
LABEL = {"belt_empty": 1, "belt_loaded": 2, "module": 11}


def rig() -> Rig:
    cameras = {
        name: Camera(name, SIZE, np.full(2, 60.0), np.array([23.5, 17.5]), np.zeros(5))
        for name in ("cam0", "cam1")
    }
    return Rig("cam0", cameras, {"cam0": Pose.identity(), "cam1": Pose.of([0, 0, 0], [-200, 0, 0])})


def truth(kind: str) -> Truth:
    depth, label = np.full(SIZE[::-1], 700.0), np.ones(SIZE[::-1], np.uint8)
    label[8:28, 8:40], depth[8:28, 8:40] = LABEL[kind], 690.0
    return Truth(rig(), WORLD_UP, depth, label, np.zeros(label.shape, bool))


def found(scene: str, by: str, noise_mm: float, share: float = 1.0) -> ScoredDepth:
    true, rng = truth(scene.removesuffix("_nospeckle")), np.random.default_rng(7)
    z = (true.depth_mm + rng.normal(0, noise_mm, true.depth_mm.shape)).astype(np.float32)
    z[rng.uniform(size=z.shape) > share] = np.nan
    ones = np.where(np.isfinite(z), 1, 0)
    depth = DepthMap(
        z, np.full(z.shape, noise_mm, np.float32), ones.astype(np.uint8), ones.astype(np.float32)
    )
    return ScoredDepth(scene, by, Path("somewhere"), depth, true, score_frame(depth, rig(), true))


def paper(*, alone: bool = False) -> Paper:
    """Everything; or, ``alone``, only the loaded belt with speckle, of which binocular sees nothing."""
    scenes = ["belt_loaded"] if alone else [s + e for s in LABEL for e in ("", "_nospeckle")]
    surfaces = {(s, m): found(s, m, 0.1, 0.2 if "no" in s else 0.9) for s in scenes for m in METHODS}
    if alone:
        true, empty = truth("belt_loaded"), make_empty_depth_map(rig())
        surfaces["belt_loaded", "binocular"] = ScoredDepth(
            "belt_loaded", "binocular", None, empty, true, score_frame(empty, rig(), true)
        )
    lab = Laboratory(
        Path("calibration"),
        Path("board.toml"),
        Path("module.toml"),
        {
            s: LaboratoryScene(
                s, s.removesuffix("_nospeckle"), Path(s), truth(s.removesuffix("_nospeckle")), None
            )
            for s in scenes
        },
    )
    names = [baseline.name for baseline in BASELINES]
    measured = {by: {"cube100 edge": (100.25, 0.1)} for by in (*METHODS, TOF, *names)}
    numbers = read_paper_numbers()
    return Paper(
        numbers=numbers,
        laboratory=lab,
        rig=rig(),
        rig_score=RigScore(0.01, 0.04, {"cam1": 0.001}, {"cam1": 0.01}),
        surfaces=surfaces,
        density=compute_density_gains(surfaces),
        dimensions=() if alone else tabulate_dimensions(numbers.dimension, measured),
        tof=None if alone else found("module", TOF, 4.0),
        baselines={}
        if alone
        else {(s, n): found(s, n, 0.2) for s in ("belt_loaded", "module") for n in names},
        moving=() if alone else tuple(found("belt_loaded", f"{t:g} mm", 0.1 + t) for t in TRAVELS_MM),
        seconds={"calibration": 1.0},
        warnings=(),
    )


def test_the_whole_report():
    page = render_paper_page(paper())
    for text in (
        "Table 2", "Table 3", "Figs. 13 to 15", "Fig. 16", "Fig. 17", "line laser", "moving belt",
        "100.612", "108.115", "100.250", "+0.250", "9.5 ×", "Hou, Kang &amp; Qiao",
    ):  # fmt: skip
        assert text in page, text
    assert _no_nan(page)
    assert 'src="http' not in page
    assert 'href="http' not in page


def _no_nan(page: str) -> bool:
    """Whether no cell of a table says nan; pictures may by chance."""
    cells = [part.split("</td>")[0] for part in page.split("<td>")[1:]]
    return not any("nan" in cell.lower() for cell in cells)


def test_what_is_left_out_leaves_no_hole():
    page = render_paper_page(paper(alone=True))
    assert "Figs. 13 to 15" in page
    for text in ("Table 2", "Table 3", "Fig. 16:", "line laser:", "moving belt"):
        assert text not in page
    assert _no_nan(page)


def test_the_document_is_json_with_all_numbers():
    document = json.loads(to_json(make_paper_document(paper())))
    assert len(document["dimensions"]) == 12
    assert document["dimensions"][0]["measured_mm"]["multiview"] == 100.25
    assert document["dimensions"][1]["measured_mm"]["multiview"] is None
    assert {(d["scene"], d["by"]) for d in document["depth"]} >= {
        ("module", TOF),
        ("belt_loaded", "line laser"),
    }
    loaded = next(d for d in document["density"] if (d["scene"], d["method"]) == ("belt_loaded", "pairwise"))
    assert loaded["paper_ratio"] == 9.5
    assert loaded["ratio"] == pytest.approx(4.5, rel=0.2)
    assert len(document["structured_light_on_a_moving_belt"]) == len(TRAVELS_MM)
