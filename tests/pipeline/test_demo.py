"""The whole chain on the demo against its truth: limits of coverage and error."""

from __future__ import annotations

import re

import pytest

from tests.report.layout import browser, layout_faults, needs_browser, text_faults


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    from beltscape.core.progress import Silent
    from beltscape.evaluate.demo import make_demo_document, run_demo
    from beltscape.evaluate.demo_page import render_demo_page

    result = run_demo(tmp_path_factory.mktemp("demo"), Silent())
    return make_demo_document(result), render_demo_page(result)


@pytest.fixture(scope="module")
def reports(demo, tmp_path_factory) -> dict[str, str]:
    """The demo's own report and those of the commands that it runs."""
    out = next(tmp_path_factory.getbasetemp().glob("demo*"))
    others = {path.parent.name: path.read_text() for path in sorted(out.glob("*/report.html"))}
    return {"demo": demo[1], **others}


def test_calibration_is_near_the_true_rig(demo):
    document, _ = demo
    assert document["held_out"]["rms_px"] < 0.15
    assert document["rig_against_truth"]["depth_rms_mm"] < 0.15
    assert max(document["rig_against_truth"]["rotation_deg"].values()) < 0.08


@pytest.mark.parametrize(
    ("method", "scene", "within_1mm", "median_mm"),
    [
        ("pairwise", "belt_empty", 0.995, 0.1),
        ("pairwise", "belt_loaded", 0.85, 0.12),
        ("pairwise", "module", 0.95, 0.15),
        ("multiview", "belt_empty", 0.995, 0.03),
        ("multiview", "belt_loaded", 0.89, 0.04),
        ("multiview", "module", 0.97, 0.045),
    ],
)
def test_depth_is_near_the_truth(demo, method, scene, within_1mm, median_mm):
    score = demo[0]["depth_against_truth"][scene][method]
    assert score["within_1mm"] > within_1mm
    assert score["interior_median_mm"] < median_mm
    assert 0.6 < score["sigma_ratio"] < 1.4


def test_more_cameras_give_more_coverage_than_two(demo):
    for scene in ("belt_loaded", "module"):
        scores = demo[0]["depth_against_truth"][scene]
        assert scores["pairwise"]["within_1mm"] > scores["binocular"]["within_1mm"] + 0.03
        assert scores["pairwise"]["coverage"] > scores["binocular"]["coverage"]


def test_volume_is_near_the_truth(demo):
    volume = demo[0]["volume_against_truth"]["belt_loaded"]
    assert abs(volume["volume_mm3"] / volume["true_mm3"] - 1) < 0.03


def test_report_works_offline(demo):
    _, page = demo
    assert not re.findall(r"""(?:src|href)=["']?(?!data:)[a-z]*:?//""", page)
    assert page.count("<img") >= 6
    assert len(page) < 12_000_000


def test_every_report_of_the_chain_is_complete(reports):
    assert {"demo", "calibration", "volume_belt_loaded"} <= set(reports)
    for name, page in reports.items():
        assert text_faults(page) == [], name


@needs_browser
def test_every_report_of_the_chain_fits_a_phone_and_paper(reports):
    with browser() as opened:
        for name, page in reports.items():
            assert layout_faults(opened, page) == [], name
