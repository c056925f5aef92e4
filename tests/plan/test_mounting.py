"""The mounting height: the paper's Eq. 26, and the recommended height."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.plan.plan import compute_mounting, mounting_height_mm
from beltscape.plan.settings import CameraSettings, PlannedBelt, PlanSettings, RigSettings


def test_eq_26_gives_the_papers_height():
    assert mounting_height_mm(780, np.deg2rad(57)) == pytest.approx(718.3, abs=0.05)
    assert compute_mounting(PlanSettings()).eq26_mm == 390 / np.tan(np.deg2rad(28.5))


@given(st.floats(1, 1e4), st.floats(0.02, 3.0))
def test_eq_26_height_covers_exactly_the_span(span, angle):
    height = mounting_height_mm(span, angle)
    assert 2 * np.arctan(span / 2 / height) == pytest.approx(angle, rel=1e-12)


def test_angle_of_table_1_applies_to_its_camera_only():
    assert np.rad2deg(CameraSettings().angle_rad) == pytest.approx(57)
    longer = CameraSettings(focal_mm=12)
    assert longer.angle_rad == longer.lens_angle_rad
    assert longer.angle_rad == pytest.approx(2 * np.arctan(2448 * 3.45e-3 / 2 / 12))
    assert np.rad2deg(CameraSettings(focal_mm=12, angle_deg=40).angle_rad) == pytest.approx(40)


def test_recommended_height_sees_belt_and_load_with_their_margins():
    settings = PlanSettings()
    hang = compute_mounting(settings)
    half_angle = np.tan(settings.camera.lens_angle_rad / 2)
    free = [hang.depth_mm(height) * half_angle - width / 2 for height, width in settings.belt.planes]
    assert min(free) == pytest.approx(settings.rig.margin_mm)


def test_belt_section_keeps_its_lengths():
    belt = PlannedBelt(width_mm=1200, span_mm=1040, flat_mm=400)
    wing = np.array([(belt.span_mm - belt.flat_mm) / 2, belt.edge_mm])
    assert 2 * np.linalg.norm(wing) + belt.flat_mm == pytest.approx(belt.width_mm)
    assert np.arctan2(wing[1], wing[0]) == pytest.approx(belt.trough_rad)


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (PlanSettings(camera=CameraSettings(focal_mm=50)),
         "max_height_mm = 3000: a lens of 50 mm sees the span of 780 mm only from 4688 mm above the belt on; "
         "give a lens of at most 31.7 mm"),
        (PlanSettings(rig=RigSettings(height_mm=700)),
         "height_mm = 700: a lens of 8 mm does not see the span of 780 mm from that height; give at least 809 mm, "
         "recommended are 908 mm"),
        (PlanSettings(rig=RigSettings(height_mm=900, max_height_mm=850)),
         "height_mm = 900 is above max_height_mm = 850; lower it"),
        (PlanSettings(rig=RigSettings(height_mm=900), belt=PlannedBelt(material_mm=(0, 880), top_width_mm=10)),
         "height_mm = 900: the load reaches 880 mm and would touch the cameras; give at least 931 mm"),
        (PlanSettings(rig=RigSettings(), belt=PlannedBelt(material_mm=(0, 2990), top_width_mm=10)),
         "max_height_mm = 3000: the load reaches 2990 mm and would touch the cameras; give at least 3041 mm"),
    ],
)  # fmt: skip
def test_impossible_mounting_is_refused_in_one_line(settings, line):
    with pytest.raises(InputError) as said:
        compute_mounting(settings)
    assert str(said.value) == line


def test_proposed_lens_is_sufficient():
    compute_mounting(PlanSettings(camera=CameraSettings(focal_mm=31.7)))
