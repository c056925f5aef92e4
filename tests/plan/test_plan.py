"""Whole plans: the paper's rig, baselines and warnings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.files.toml_text import validate
from beltscape.plan.baseline import choose_baseline, list_alternatives
from beltscape.plan.plan import make_plan
from beltscape.plan.settings import CameraSettings, LightSettings, PlannedBelt, PlanSettings, RigSettings
from tests.thorough import list_cases


@pytest.fixture(scope="module")
def paper():
    return make_plan(PlanSettings())


def test_papers_rig_sees_the_whole_belt_three_times(paper):
    assert paper.planes[1].at_least[2] == pytest.approx(1, abs=1e-6)
    assert paper.planes[1].lengths_mm[1] > 580  # the paper: 0.58 m along the belt, from lower down
    assert not paper.chosen.refused


def test_most_precise_acceptable_baseline_is_chosen(paper):
    free = [each for each in paper.alternatives if not each.refused]
    assert paper.chosen.sigma_mm == min(each.sigma_mm for each in free)
    sigmas = [each.sigma_mm for each in paper.alternatives]
    seen = [each.seen[2] for each in paper.alternatives]
    assert sigmas == sorted(sigmas, reverse=True)
    assert seen == sorted(seen, reverse=True)


def test_rougher_load_shortens_the_baseline(paper):
    rough = PlanSettings(belt=PlannedBelt(lump_cover=0.75))
    assert make_plan(rough).chosen.baseline_mm < paper.chosen.baseline_mm


def test_requested_baseline_is_used_with_a_warning():
    plan = make_plan(PlanSettings(rig=RigSettings(baseline_mm=600)))
    assert plan.planned.baseline_mm == 600
    assert any(line.startswith("the baseline of 600 mm is not ideal: wider than") for line in plan.warnings)


def test_baseline_beyond_the_horizon_is_refused():
    settings = PlanSettings(rig=RigSettings(baseline_mm=5000))
    with pytest.raises(InputError, match="baseline_mm = 5000: auxiliaries would see past the belt"):
        choose_baseline(settings, list_alternatives(settings, 900.0))


def test_best_seen_baseline_is_chosen_where_none_is_acceptable():
    plan = make_plan(PlanSettings(rig=RigSettings(max_baseline_mm=2)))
    assert plan.chosen.seen[2] == max(each.seen[2] for each in plan.alternatives)
    assert plan.chosen.refused


def test_an_angle_that_differs_from_the_lens_gives_a_warning_only_where_it_was_stated(paper):
    stated = make_plan(PlanSettings(camera=CameraSettings(angle_deg=57)))
    assert "stated angle of view is 57.0°" in stated.warnings[0]
    assert "718.3 mm" in stated.warnings[0]
    assert not any("angle of view" in warning for warning in paper.warnings)


@pytest.mark.parametrize(
    ("settings", "lines"),
    [
        (PlanSettings(belt=PlannedBelt(speed_m_s=19)), ["frames a second are needed, the camera gives 79.1"]),
        (
            PlanSettings(light=LightSettings(exposure_us=1000, projector_lm=10)),
            ["px of motion blur; expose at most 82 µs for 0.5 px", "too little light: SNR"],
        ),
        (PlanSettings(light=LightSettings(exposure_us=400_000)), ["does not fit", "white surfaces saturate"]),
        (
            PlanSettings(camera=CameraSettings(f_number=0.7), rig=RigSettings(height_mm=850)),
            [
                "out of focus by up to", "below the recommended height",
                "at the top the full width of 780 mm is not seen",
            ],
        ),
    ],
)  # fmt: skip
def test_shortage_gives_a_warning(settings, lines):
    warnings = make_plan(settings).warnings
    for line in lines:
        assert any(line in warning for warning in warnings), line


def test_more_cameras_are_more_precise():
    def sigma(auxiliaries):
        rig = RigSettings(auxiliaries=auxiliaries, baseline_mm=250)
        return make_plan(PlanSettings(rig=rig)).sigma_median_mm

    found = [sigma(n) for n in (1, 2, 4)]
    assert found == sorted(found, reverse=True)
    assert found[0] / found[2] > 2


@pytest.mark.parametrize("auxiliaries", list_cases([1, 2, 3, 8], [1, 8]))
def test_any_number_of_auxiliaries_has_an_acceptable_baseline(auxiliaries):
    plan = make_plan(PlanSettings(rig=RigSettings(auxiliaries=auxiliaries)))
    assert not plan.chosen.refused
    assert plan.chosen.seen[plan.required_views] >= plan.settings.rig.required_share
    assert len(plan.planned.rig.cameras) == auxiliaries + 1


UNUSUAL = {
    "no flat middle": PlanSettings(belt=PlannedBelt(flat_mm=0)),
    "standing": PlanSettings(belt=PlannedBelt(speed_m_s=0)),
    "flat": PlanSettings(belt=PlannedBelt(span_mm=800)),
    "high load": PlanSettings(belt=PlannedBelt(material_mm=(0, 2900))),
    "no light": PlanSettings(light=LightSettings(projector_lm=0)),
    "given light": PlanSettings(light=LightSettings(lit_area_mm=(800, 600))),
}


@pytest.mark.parametrize("plant", list_cases(UNUSUAL, ["standing", "no light"]))
def test_unusual_plants_are_planned_and_reported(plant):
    from beltscape.report.plan import render_plan_page

    plan = make_plan(UNUSUAL[plant])
    assert "Rig plan" in render_plan_page(plan)
    assert not any("inf" in warning.split() for warning in plan.warnings)


def test_poor_light_increases_matching_sigma_only(paper):
    assert paper.sigma_in_this_light_mm == pytest.approx(
        paper.sigma_median_mm * paper.light.matching_sigma_px / paper.settings.precision.matching_sigma_px,
        rel=1e-9,
    )
    assert np.isfinite(paper.sigma_in_this_light_mm)


@pytest.mark.parametrize(
    "values",
    [
        {"belt": {"span_mm": 900}},
        {"belt": {"flat_mm": 790}},
        {"belt": {"material_mm": [100, 50]}},
        {"camera": {"focal_mm": 0}},
        {"rig": {"auxiliaries": 9}},
        {"frames_per_point": True},
        {"lens": {}},
    ],
)
def test_settings_have_bounds(values):
    with pytest.raises(InputError, match=r"plan\.toml: "):
        validate(Path("plan.toml"), PlanSettings, values)
