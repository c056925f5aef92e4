"""Settings of the multi-view matcher: presets, bounds, and sizes for images of any width."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from beltscape.core.errors import SettingsError
from beltscape.stereo.settings import PRESETS, MultiviewSettings


def test_default_of_the_two_presets_is_standard():
    assert set(PRESETS) == {"fast", "standard"}
    assert MultiviewSettings.preset("standard") == MultiviewSettings()
    presets = [MultiviewSettings.preset(name) for name in PRESETS]
    assert all(first != second for first, second in combinations(presets, 2))


def test_presets_are_ordered_by_effort():
    fast, standard = (MultiviewSettings.preset(name) for name in ("fast", "standard"))
    assert fast.grid_step > standard.grid_step == 1
    assert fast.rounds < standard.rounds
    assert fast.plane_step_px > standard.plane_step_px


@pytest.mark.parametrize(
    "wrong",
    [
        {"unknown": 1},
        {"grid_step": 0},
        {"grid_step": 5},
        {"rounds": 0},
        {"rounds": 9},
        {"distances_px": ()},
        {"distances_px": tuple(range(1, 10))},
        {"round_tolerances_px": ()},
        {"candidate_selection": 2},
        {"least_confidence": 1.0},
        {"least_confidence": -0.1},
        {"sweep_width_px": 63},
        {"threads": -1},
        {"threads": 300},
    ],
)
def test_invalid_settings_are_refused(wrong):
    with pytest.raises(SettingsError):
        MultiviewSettings(**wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {"round_tolerances_px": (0.0,)},
        {"final_tolerance_px": -0.5},
        {"distances_px": (0,)},
        {"distances_px": (40_000,)},
    ],
)
def test_numbers_outside_the_kernels_range_are_refused(wrong):
    with pytest.raises(SettingsError):
        MultiviewSettings(**wrong)


def test_settings_are_immutable():
    with pytest.raises(ValidationError):
        MultiviewSettings().rounds = 3  # pyrefly: ignore[read-only]


@given(st.integers(64, 12_000), st.integers(64, 4096))
def test_width_of_the_sweeps_images_hardly_depends_on_the_camera(grid_px, wanted):
    shrink = MultiviewSettings(sweep_width_px=wanted).shrink(grid_px)
    assert shrink >= 1
    assert grid_px / shrink < 1.51 * wanted
    assert shrink == 1 or grid_px / shrink > 0.66 * wanted


@pytest.mark.parametrize(("preset", "counts"), [("standard", (1, 1, 2, 3)), ("fast", (1, 1, 1, 2))])
def test_large_images_are_matched_on_more_grids(preset, counts):
    settings = MultiviewSettings.preset(preset)
    assert tuple(settings.grids(width) for width in (320, 612, 1224, 2448)) == counts


@given(st.integers(1, 12_000), st.integers(1, 4))
def test_smallest_grid_is_wide_enough_for_the_pattern(width_px, step):
    settings = MultiviewSettings(grid_step=step)
    smallest = width_px // settings.step(width_px) // 2 ** (settings.grids(width_px) - 1)
    assert smallest >= min(width_px, 480)
    assert smallest < 960 or smallest == width_px


def test_fast_preset_matches_blocks_only_in_large_images():
    fast, standard = MultiviewSettings.preset("fast"), MultiviewSettings()
    assert [fast.step(width) for width in (1, 612, 959, 960, 1224, 2448)] == [1, 1, 1, 2, 2, 2]
    assert {standard.step(width) for width in (1, 612, 1224, 12_000)} == {1}


@given(st.integers(1, 12_000), st.integers(1, 4))
def test_grid_step_is_reduced_only_for_small_images(width_px, wanted):
    step = MultiviewSettings(grid_step=wanted).step(width_px)
    assert 1 <= step <= wanted
    assert step == 1 or width_px / step >= 480
    assert step == wanted or width_px / (step + 1) < 480


@given(st.lists(st.integers(1, 40), min_size=1, max_size=8), st.floats(0.3, 2))
def test_offsets_are_scaled_and_distinct(distances, scale):
    found = MultiviewSettings(distances_px=tuple(distances)).offsets_px(scale)
    assert list(found) == sorted(set(found))
    assert found[0] >= 1
    assert all(min(abs(d * scale - f) for f in found) <= 0.71 for d in distances)
