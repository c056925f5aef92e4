"""Assembled scenes: reproducible, moved by the belt, changed by faults."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.core.frames import saturated_fraction
from beltscape.simulate import scene_assembly
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from tests.simulate.tiny import tiny
from tests.thorough import list_cases

CAMERAS = ("cam0", "cam1")
DARK = {"speckle": False}


def small(kind: str, **more: Any) -> Scenario:
    """Return a tiny scenario with a pair of cameras."""
    return tiny(kind, **{**more, "rig": {"auxiliaries": 1, **more.get("rig", {})}})


@pytest.fixture(scope="module", autouse=True)
def heaps_made_once():
    """Let scenes with the same heap share it; `test_heap` shows that it is the same."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_assembly, "make_heap", cache(scene_assembly.make_heap))
        yield


@cache
def plain() -> dict[str, np.ndarray]:
    """The loaded belt with nothing wrong, by camera; nobody writes into it."""
    return dict(SimulatedScene(small("belt_loaded")).render_frame(0).images)


@cache
def dark() -> dict[str, np.ndarray]:
    """The same with its projector off."""
    return dict(SimulatedScene(small("belt_loaded", **DARK)).render_frame(0).images)


def same(first, second) -> list[str]:
    """Cameras with the very same image."""
    return [name for name in first if np.array_equal(first[name], second[name])]


def test_same_scenario_gives_the_same_bytes_and_another_seed_others():
    again = SimulatedScene(small("belt_loaded")).render_frame(0)
    assert again.frame == "000"
    assert again.time_ns == 0
    assert tuple(again.images) == CAMERAS
    assert same(plain(), again.images) == list(CAMERAS)
    assert same(SimulatedScene(small("belt_loaded", seed=2)).render_frame(0).images, plain()) == []


def test_seed_draws_noise_and_heap_but_no_other_plant():
    first, second = (
        SimulatedScene(small("belt_loaded", **DARK)),
        SimulatedScene(small("belt_loaded", seed=2, **DARK)),
    )
    assert first.heap is not None
    assert second.heap is not None
    assert (first.heap.rocks.volume_mm3 != second.heap.rocks.volume_mm3).all()
    for name in CAMERAS:
        np.testing.assert_array_equal(
            first.station.cam_from_world(name).translation_mm,
            second.station.cam_from_world(name).translation_mm,
        )
    huge = SimulatedScene(small("belt_empty", seed=2**63 - 1, **DARK)).render_frame(1)
    assert tuple(huge.images) == CAMERAS


def test_two_frames_of_a_still_belt_differ_by_noise_only():
    second = SimulatedScene(small("belt_loaded")).render_frame(1).images
    for name, image in plain().items():
        change = second[name].astype(float) - image
        assert 0 < change.std() < 6
        assert abs(change.mean()) < 0.3


def test_colour_depends_on_the_projector_unless_given():
    def shapes(**more) -> set[int]:
        return {
            image.ndim
            for image in SimulatedScene(small("belt_empty", **more)).render_frame(0).images.values()
        }

    assert {image.ndim for image in plain().values()} == {3}
    assert {image.ndim for image in dark().values()} == {2}
    assert shapes(colour=True, **DARK) == {3}
    assert shapes(colour=False) == {2}
    assert {image.shape[:2] for image in plain().values()} == {(264, 320)}


def test_contrast_grows_without_ambient_light():
    def contrast(ambient: float) -> float:
        quiet = {"shot_noise": False, "read_noise_e": 0.0}
        scene = small("belt_empty", ambient=ambient, sensor=quiet, colour=False)
        inner = SimulatedScene(scene).render_frame(0).images["cam0"].astype(float)[100:160, 120:200]
        return float(inner.std() / inner.mean())

    assert contrast(0.0) > 2 * contrast(10.0) > 0


@pytest.mark.parametrize("colour", list_cases(["grey", "rgb", "bayer"], ["grey", "bayer"]))
def test_auto_exposure_makes_the_first_core_image_just_not_saturated(colour):
    scene = SimulatedScene(
        small("belt_loaded", colour=False, gain_spread=0, sensor={"colour": colour, "shot_noise": False})
    )
    image = scene.render_frame(0).images["cam0"]
    # behind a mosaic only some of the brightest spots have their own colour's filter
    assert 0.85 - (0.1 if colour == "bayer" else 0.04) < np.quantile(image, 0.998) / 255 < 0.89
    assert saturated_fraction(image) < 0.005


def test_a_fault_of_the_belt_leaves_the_exposure_as_it_was_set():
    faults = {"running_off": [{"misaligned_mm": 80.0}], "splice": [{"height_mm": 20.0}]}
    sound, faulty = (SimulatedScene(small("belt_loaded", faults=each)) for each in ({}, faults))
    assert faulty._sensor.electrons_at_1 == sound._sensor.electrons_at_1


def test_sensor_keeps_its_exposure_without_auto_exposure():
    dim = {"electrons_at_1": 1000.0, "read_noise_e": 0.0, "shot_noise": False}
    scene = SimulatedScene(small("belt_empty", auto_exposure=False, gain_spread=0, sensor=dim, **DARK))
    assert scene.render_frame(0).images["cam0"].max() <= np.ceil(255 * 1000 / 14_000)


def test_gains_differ_by_their_spread():
    fixed = {
        "auto_exposure": False,
        "sensor": {"electrons_at_1": 9000},
        "rig": {"seed": 4, "auxiliaries": 2},
        **DARK,
    }
    even = SimulatedScene(small("belt_empty", gain_spread=0.0, **fixed)).render_frame(0).images
    uneven = SimulatedScene(small("belt_empty", gain_spread=0.3, **fixed)).render_frame(0).images
    ratios = [uneven[name].mean() / even[name].mean() for name in even]
    assert all(0.69 < ratio < 1.31 for ratio in ratios)
    assert np.ptp(ratios) > 0.05


# The moving belt


def moving(**motion) -> SimulatedScene:
    return SimulatedScene(small("belt_moving", motion=motion, **DARK))


def test_heap_passes_once():
    scene = moving(speed_mm_s=500, frames_per_s=5)
    places = [scene.heap_position_mm(i) for i in range(scene.frame_count)]
    far = -places[0]
    np.testing.assert_allclose(np.diff(places), 100)
    assert places[-1] < far <= places[-1] + 100
    assert scene.heap_position_mm(scene.frame_count) < places[1]  # it comes again
    end = -scene.scenario.heap.fines.along_mm[0]
    view = 264 / 2 / scene.station.rig.core_camera.focal_px[1] * scene.station.core_from_world.center_mm[2]
    assert far == pytest.approx(end + view)


def test_first_frame_shows_the_empty_belt_and_a_middle_one_the_heap():
    scene = moving(speed_mm_s=500, frames_per_s=5)
    middle = min(range(scene.frame_count), key=lambda i: abs(scene.heap_position_mm(i)))
    first, loaded = (scene.render_frame(i).images["cam0"].mean() for i in (0, middle))
    assert loaded > 1.15 * first
    assert scene.render_frame(middle).time_ns == middle * 200_000_000


@given(
    st.floats(-3000, 3000), st.floats(1, 50), st.integers(0, 300), st.one_of(st.none(), st.floats(-90, 90))
)
def test_belt_and_heap_move_together(speed, rate, frame, start):
    scene = moving(speed_mm_s=speed, frames_per_s=rate, start_mm=start)
    assert scene.belt_position_mm(frame) == pytest.approx(speed * frame / rate)
    round_mm = 2 * scene._far_mm
    assert -round_mm / 2 <= scene.heap_position_mm(frame) <= round_mm / 2
    went = scene.heap_position_mm(frame) - scene.heap_position_mm(0) - scene.belt_position_mm(frame)
    assert went / round_mm == pytest.approx(round(went / round_mm), abs=1e-6)
    if start is not None:
        assert scene.heap_position_mm(0) == pytest.approx(start)


def test_belt_may_run_backwards_or_stand():
    back = moving(speed_mm_s=-500, frames_per_s=5)
    places = [back.heap_position_mm(i) for i in range(back.frame_count)]
    np.testing.assert_allclose(np.diff(places), -100)
    assert places[0] > 0 > places[-1]
    assert moving(speed_mm_s=0).frame_count == 1
    still = SimulatedScene(small("belt_loaded"))
    assert (still.belt_position_mm(7), still.heap_position_mm(7), still.frame_count) == (0, 0, 1)


@pytest.mark.parametrize("speed", [1e-3, 1e-320])
def test_very_slow_belt_requires_the_number_of_frames(speed):
    with pytest.raises(InputError, match="give the number of frames"):
        _ = moving(speed_mm_s=speed).frame_count
    assert SimulatedScene(small("belt_moving", frames=3, motion={"speed_mm_s": speed})).frame_count == 3


def test_motion_blurs_along_the_belt():
    def edges(exposure_us: float) -> float:
        motion = {"start_mm": 0.0, "exposure_us": exposure_us, "speed_mm_s": 2000}
        quiet = {"shot_noise": False, "read_noise_e": 0.0}
        coarse = {"size_px": (200, 164), "pitch_um": 42.0}
        scene = SimulatedScene(
            small("belt_moving", frames=1, motion=motion, sensor=quiet, rig=coarse, **DARK)
        )
        image = scene.render_frame(0).images["cam0"].astype(float)[50:112, 62:138]
        return float(np.abs(np.diff(image, axis=0)).mean())

    assert edges(5000) < 0.9 * edges(0)


# Faults


def spoilt(speckle: bool = False, **faults) -> dict[str, np.ndarray]:
    return dict(SimulatedScene(small("belt_loaded", speckle=speckle, faults=faults)).render_frame(0).images)


def test_dead_projector_equals_no_projector():
    images = spoilt(speckle=True, dead_projector=True)
    assert same(images, dark()) == list(CAMERAS)


def test_dirt_darkens_its_own_camera():
    images = spoilt(dirt=[{"camera": "cam1", "specks_px": [[160, 132, 20]]}])
    assert same(images, dark()) == ["cam0"]
    here = (slice(127, 138), slice(155, 166))
    assert images["cam1"][here].mean() == pytest.approx(0.4 * dark()["cam1"][here].mean(), rel=0.05)
    far = (slice(0, 60), slice(0, 60))
    change = images["cam1"][far].astype(float) - dark()["cam1"][far]
    assert abs(change).max() <= 2  # reading noise is drawn anew


def test_over_exposure_saturates_its_own_camera():
    images = spoilt(over_exposure=[{"camera": "cam1", "factor": 8}])
    assert same(images, dark()) == ["cam0"]
    # the floor beside the belt is bright already; now all that is not black is, whatever the camera's own gain
    assert saturated_fraction(dark()["cam1"]) < 0.15
    assert saturated_fraction(images["cam1"]) > 0.6


def test_moved_camera_changes_its_image_but_not_the_truth():
    knock = [{"camera": "cam1", "rotation_deg": [0, 2, 0]}]
    scene = SimulatedScene(small("belt_loaded", faults={"moved_camera": knock}, **DARK))
    assert same(scene.render_frame(0).images, dark()) == ["cam0"]
    true = SimulatedScene(small("belt_loaded")).station
    for name in CAMERAS:
        np.testing.assert_array_equal(
            scene.station.cam_from_world(name).rotation, true.cam_from_world(name).rotation
        )
    turn = scene.station_at(0).cam_from_world("cam1").rotation @ true.cam_from_world("cam1").rotation.T
    assert np.rad2deg(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(2)
    before = SimulatedScene(small("calibration", faults={"moved_camera": knock}))
    assert before.station_at(0) is before.station


def test_missing_frames_are_absent_and_the_others_unchanged():
    lost = [{"camera": "cam1", "every": 2}, {"camera": "cam0", "first": 1}]
    scene = SimulatedScene(small("belt_loaded", frames=4, faults={"missing_frames": lost}, **DARK))
    there = [scene.delivering_cameras(i) for i in range(4)]
    assert there == [["cam0"], ["cam1"], [], ["cam1"]]
    images = scene.render_frame(0).images
    assert tuple(images) == ("cam0",)
    assert same(images, dark()) == ["cam0"]


# The board


def test_board_is_rendered_without_belt_or_dots():
    scene = SimulatedScene(small("calibration", frames=2))
    assert scene.projector is None
    assert {solid.name for solid in scene.world_at(0).solids} & {"belt"} == set()
    assert len(scene.world_from_board) == 2
    first, second, third = (scene.world_at(number).solids[1].vertices_mm for number in range(3))
    np.testing.assert_array_equal(third, first)
    assert (second != first).any()
    assert SimulatedScene(small("calibration")).frame_count == 24
