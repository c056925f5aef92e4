"""Checks of a given depth range against units, rig and images."""

from __future__ import annotations

import pytest

from beltscape.core.errors import SettingsError
from beltscape.core.progress import Silent
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.reconstructing.reconstruction import open_capture
from beltscape.pipeline.reconstructing.search_range import check_depth_range, require_depth_range
from tests.synthetic.demo import TRUE_RIG


@pytest.fixture(scope="module")
def rig():
    return read_rig(TRUE_RIG)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0.5, 0.8), "were these metres? then give 500 800"),
        ((0.7, 2.0), "were these metres? then give 700 2000"),
        ((60, 90), "were these centimetres? then give 600 900"),
        ((24, 32), "were these inches? then give 609.6 812.8"),
        ((600_000, 800_000), "were these micrometres? then give 600 800"),
        ((5, 8), "meet between 326 and 1592 mm; give a range there"),
        ((1, 5000), "too wide to be searched"),
    ],
)
def test_range_that_does_not_suit_the_rig_is_refused(rig, given, message):
    with pytest.raises(SettingsError) as error:
        require_depth_range(given, rig, rig.auxiliaries)
    assert message in str(error.value)
    assert str(error.value).startswith(f"depth range {given[0]:g} to {given[1]:g} mm: ")


@pytest.mark.parametrize("given", [(400, 900), (200, 3000), (700, 710), (1500, 9000)])
def test_range_that_suits_the_rig_is_accepted(rig, given):
    require_depth_range(given, rig, rig.auxiliaries)


@pytest.mark.parametrize(
    ("given", "is_warning"),
    [
        ((590, 780), False),
        pytest.param((400, 2000), False, marks=pytest.mark.thorough),
        ((700, 701), True),
        pytest.param((900, 1200), True, marks=pytest.mark.thorough),
    ],
)
def test_range_narrower_than_the_images_show_causes_a_warning(cropped, cropped_rig, given, is_warning):
    reporter, rig = Silent(), read_rig(cropped_rig)
    source = open_capture(cropped / "belt_loaded", rig, reporter)
    check_depth_range(given, source, rig, reporter)
    assert any("the images show surfaces from" in warning for warning in reporter.warnings) == is_warning


def test_range_outside_rig_and_images_is_refused(cropped, cropped_rig):
    rig = read_rig(cropped_rig)
    source = open_capture(cropped / "belt_loaded", rig, Silent())
    with pytest.raises(SettingsError, match="neither do the cameras of this rig meet there"):
        check_depth_range((5000, 6000), source, rig, Silent())
