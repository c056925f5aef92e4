"""The whole chain on the demo, and with three of its cameras, against the truth: limits of coverage and error."""

from __future__ import annotations

import contextlib
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.files.images import read_image
from tests.once import make_once
from tests.report.layout import browser, layout_faults, needs_browser, text_faults

SHIPPED = [pytest.param("shipped", marks=pytest.mark.thorough)]
shipped = pytest.mark.parametrize("demo", SHIPPED, indirect=True)
short_and_shipped = pytest.mark.parametrize("demo", ["short", *SHIPPED], indirect=True)
"""The short run has three cameras and one method."""


@pytest.fixture(scope="module")
def demo(request, tmp_path_factory) -> tuple[dict[str, Any], str, Path]:
    """The demo's document, its own report and its folder; made once, however the tests are spread over workers."""

    def run(folder: Path) -> None:
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert main(["demo", "--out", str(folder / "out"), "--json"]) == 0
        (folder / "demo.json").write_text(printed.getvalue())

    if request.param == "short":
        folder = request.getfixturevalue("demo_run")
    else:
        folder = make_once(tmp_path_factory, "demo", run)
    page = (folder / "out" / "report.html").read_text()
    return json.loads((folder / "demo.json").read_text()), page, folder / "out"


@pytest.fixture(scope="module")
def reports(demo) -> dict[str, str]:
    """The demo's own report and those of the commands that it runs."""
    _, page, folder = demo
    return {
        "demo": page,
        **{path.parent.name: path.read_text() for path in sorted(folder.glob("*/report.html"))},
    }


@short_and_shipped
def test_calibration_is_near_the_true_rig(demo):
    document, *_ = demo
    assert document["held_out"]["rms_px"] < 0.15
    assert document["rig_against_truth"]["depth_rms_mm"] < 0.15
    assert max(document["rig_against_truth"]["rotation_deg"].values()) < 0.08


@short_and_shipped
def test_depth_is_near_the_truth(demo):
    for method, scene, within_1mm, median_mm in (
        ("pairwise", "belt_empty", 0.995, 0.1),
        ("pairwise", "belt_loaded", 0.85, 0.12),
        ("pairwise", "module", 0.95, 0.15),
        ("multiview", "belt_empty", 0.995, 0.03),
        ("multiview", "belt_loaded", 0.885, 0.04),
        ("multiview", "module", 0.97, 0.045),
    ):
        scores = demo[0]["depth_against_truth"][scene]
        assert "multiview" in scores
        if method in scores:
            assert scores[method]["within_1mm"] > within_1mm, (method, scene)
            assert scores[method]["interior_median_mm"] < median_mm, (method, scene)
            assert 0.6 < scores[method]["sigma_ratio"] < 1.4, (method, scene)


@shipped
def test_more_cameras_give_more_coverage_than_two(demo):
    for scene in ("belt_loaded", "module"):
        scores = demo[0]["depth_against_truth"][scene]
        assert scores["pairwise"]["within_1mm"] > scores["binocular"]["within_1mm"] + 0.03
        assert scores["pairwise"]["coverage"] > scores["binocular"]["coverage"]


@short_and_shipped
def test_volume_is_near_the_truth(demo):
    volume = demo[0]["volume_against_truth"]["belt_loaded"]
    assert abs(volume["volume_mm3"] / volume["true_mm3"] - 1) < 0.03


@short_and_shipped
def test_report_works_offline(demo):
    _, page, _ = demo
    assert not re.findall(r"""(?:src|href)=["']?(?!data:)[a-z]*:?//""", page)
    assert page.count("<img") >= 6
    assert len(page) < 12_000_000


@short_and_shipped
def test_every_report_of_the_chain_is_complete(reports):
    assert {"demo", "calibration", "volume_belt_loaded"} <= set(reports)
    for name, page in reports.items():
        assert text_faults(page) == [], name


@short_and_shipped
def test_every_picture_of_the_chain_shows_something(demo):
    coloured = {"coverage": 0.02, "preview": 0.3, "regions": 0.005, "rectification": 0.02}
    *_, folder = demo
    paths = sorted(folder.glob("**/*.png"))
    assert set(coloured) < {path.stem for path in paths}
    for path in paths:
        picture = read_image(path).astype(int)
        if path.stem in coloured:
            assert (np.ptp(picture, axis=2) > 60).mean() > coloured[path.stem], path
        else:  # images of cameras and numbers of views
            assert (picture == np.bincount(picture.ravel()).argmax()).mean() < 0.99, path


@pytest.mark.thorough
@needs_browser
@short_and_shipped
def test_every_report_of_the_chain_fits_a_phone_and_paper(demo, reports):
    """The short run's own report only; tests/report lays the others out."""
    if len(demo[0]["depth_against_truth"]["module"]) == 1:
        reports = {"demo": reports["demo"]}
    with browser() as opened:
        for name, page in reports.items():
            assert layout_faults(opened, page) == [], name
