"""The ends of an empty belt against floor, rails and boards, for rigs turned and inclined against it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.measure.belt.edges import find_belt_edges
from beltscape.measure.belt.empty_belt import learn_belt
from beltscape.measure.belt.given import describe_doubts, measure_width_mm
from beltscape.measure.belt.reference import make_reference
from beltscape.measure.belt.settings import GivenBelt
from beltscape.measure.volume.load import compute_capacity_mm2
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.volume import measure_volume
from tests.measure.belt_scenes import Block, Scene, Slab, depth_map, trough, world_points_mm
from tests.optional import require
from tests.thorough import list_cases

CORE = Camera("cam0", (408, 342), np.array([300.0, 300.3]), np.array([205.8, 169.1]), np.zeros(5))
TROUGH = trough(300, (308, 25))
END, RIM = 150 + 308 * np.cos(np.deg2rad(25)), 308 * np.sin(np.deg2rad(25))
INCLINED: dict[str, Any] = {"camera_mm": (14.0, 0.0, 1300.0), "camera": CORE, "tilt_deg": (4.0, 4.5)}
"""Core camera of a rig of three in an L, 6° off the vertical; a pixel is 4.3 mm on the belt."""
NEAR_MM = 9.0
"""Two pixels: an end is located to the column of pixels that it runs through."""


def beside(first: float, last: float, low: float, high: float, *sides: int) -> tuple[Slab, ...]:
    """Slabs along the belt from x ``first`` to ``last``, on both sides by default."""
    return tuple(
        Slab((min(s * first, s * last), -4000.0, low), (max(s * first, s * last), 4000.0, high))
        for s in sides or (-1, 1)
    )


def measure_depth(scene: Scene, dark: Any = None, seed: int = 0) -> DepthMap:
    """Depth with a matcher's noise and holes; nothing is measured where ``dark`` (of world points) holds."""
    exact = scene.depth_mm()
    if dark is not None:
        exact = np.where(dark(world_points_mm(scene, exact)), np.nan, exact)
    return depth_map(exact, noise_mm=0.5, holes=0.02, seed=seed)


@cache
def learn_before_floor() -> tuple[Scene, Belt]:
    """Return a trough turned against the rig before a floor, and its belt."""
    scene = Scene(TROUGH, floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    return scene, learn_belt([measure_depth(scene)], CORE)


def true_ends(scene: Scene, belt: Belt, at: tuple[float, float]) -> np.ndarray:
    """x in the belt frame of the lines at world x = ``at``."""
    belt_from_world = belt.belt_from_core @ scene.core_from_world
    height = np.interp(at, *scene.section_mm.T)
    x = belt_from_world.apply(np.column_stack([at, [0.0, 0.0], height]))[:, 0]
    return np.sort(x)


def ends_of(belt: Belt) -> tuple[str, str]:
    return require(belt.ends)


SECTIONS = {"trough": TROUGH, "narrow": trough(150, (140, 30)), "flat": trough(400)}
POSITIONS = ((0.0, -100.0), (0.0, -600.0), (25.0, -100.0), (25.0, -600.0), (60.0, -300.0), (90.0, -600.0))
"""Yaw of the belt in degrees and height of the floor in mm."""
FEW = {
    ("trough", 90.0, -600.0),
    ("narrow", 60.0, -300.0),
    ("flat", 25.0, -100.0),
}
"""Each section at some yaw, before the nearest floor and the farthest one."""


@pytest.mark.parametrize(
    ("section", "yaw_deg", "floor_mm"),
    [
        pytest.param(
            section,
            yaw_deg,
            floor_mm,
            id=f"{name}-{yaw_deg}-{floor_mm}",
            marks=() if (name, yaw_deg, floor_mm) in FEW else pytest.mark.thorough,
        )
        for name, section in SECTIONS.items()
        for yaw_deg, floor_mm in POSITIONS
    ],
)
def test_floor_on_both_sides_is_no_belt(section: np.ndarray, yaw_deg: float, floor_mm: float) -> None:
    scene = Scene(section, floor_mm=floor_mm, belt_yaw_deg=yaw_deg, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE)
    true = true_ends(scene, belt, (section[0, 0], section[-1, 0]))
    assert ends_of(belt) == ("seen", "seen")
    assert not describe_doubts(belt)
    np.testing.assert_allclose(belt.across_mm, true, atol=NEAR_MM)
    edges = require(belt.edges)
    assert abs(edges.left_mm - true[0]) < 4 * edges.left_sigma_mm < 10
    assert abs(edges.right_mm - true[1]) < 4 * edges.right_sigma_mm < 10
    window = make_reference(belt, CORE).window_mm
    assert window[1] - window[0] > 700


def test_trough_whose_middle_is_not_under_the_core_ends_at_its_own_ends() -> None:
    scene = Scene(
        TROUGH, floor_mm=-300.0, belt_yaw_deg=25.0, **(INCLINED | {"camera_mm": (280.0, 0.0, 1300.0)})
    )
    belt = learn_belt([measure_depth(scene)], CORE)
    np.testing.assert_allclose(belt.across_mm, true_ends(scene, belt, (-END, END)), atol=NEAR_MM)
    assert ends_of(belt) == ("seen", "seen")


@pytest.mark.parametrize("rise_mm", list_cases([-20.0, 0.0, 20.0], [0.0]))
@pytest.mark.parametrize("yaw_deg", [pytest.param(0.0, marks=pytest.mark.thorough), 25.0])
def test_rail_beside_the_belt_across_a_gap_is_no_belt(yaw_deg: float, rise_mm: float) -> None:
    rails = beside(END + 40, END + 120, RIM + rise_mm - 60, RIM + rise_mm)
    scene = Scene(TROUGH, rails, floor_mm=-300.0, belt_yaw_deg=yaw_deg, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE)
    true = true_ends(scene, belt, (-END, END))
    np.testing.assert_allclose(belt.across_mm, true, atol=NEAR_MM)
    assert ends_of(belt) == ("seen", "seen")
    edges = find_belt_edges(measure_depth(scene, seed=5), CORE, belt)
    assert abs(edges.offset_mm) < 4 * edges.sigma_mm


def test_lumps_that_stand_over_an_edge_do_not_move_it() -> None:
    plate = {"floor_mm": -60.0, "camera_mm": (0.0, 0.0, 1300.0), "camera": CORE}
    belt = learn_belt([measure_depth(Scene(trough(600), **plate))], CORE)
    lumps = tuple(Block((-x, 430.0 + y), (80.0, 90.0, 150.0)) for x, y in ((215, -110), (228, 0), (240, 110)))
    shifted = Scene(np.add(trough(600), [60.0, 0.0]), lumps, **plate)
    edges = find_belt_edges(measure_depth(shifted, seed=5), CORE, belt)
    assert abs(edges.offset_mm - 60) < 3 * edges.sigma_mm < 5


def test_rail_level_with_a_flat_belt_across_a_gap_is_no_belt() -> None:
    scene = Scene(trough(600), beside(340, 420, -60, 0), floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE)
    true = true_ends(scene, belt, (-300.0, 300.0))
    np.testing.assert_allclose(belt.across_mm, true, atol=NEAR_MM)
    edges = require(belt.edges)
    assert (edges.left_mm, edges.right_mm) == pytest.approx(tuple(true), abs=NEAR_MM)


@pytest.mark.parametrize(
    "section", [TROUGH, pytest.param(trough(800), marks=pytest.mark.thorough)], ids=["trough", "flat"]
)
def test_skirt_board_on_one_side_ends_the_belt_and_is_named(section: np.ndarray) -> None:
    board = beside(250, 262, 0 if len(section) == 2 else 60, 260, 1)
    scene = Scene(section, board, floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE)
    true = true_ends(scene, belt, (section[0, 0], 250.0))
    np.testing.assert_allclose(belt.across_mm, true, atol=3 * NEAR_MM)
    assert belt.across_mm[1] < true[1] + NEAR_MM
    assert ends_of(belt) == ("seen", "covered")
    (warning,) = describe_doubts(belt)
    assert "right end was not seen" in warning
    assert "left" not in warning
    assert "--width MM" in warning


@pytest.mark.thorough
def test_skirt_boards_on_both_sides_end_the_belt() -> None:
    scene = Scene(TROUGH, beside(250, 262, 60, 260), floor_mm=-300.0, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE)
    np.testing.assert_allclose(belt.across_mm, true_ends(scene, belt, (-250.0, 250.0)), atol=3 * NEAR_MM)
    assert ends_of(belt) == ("covered", "covered")
    warning = describe_doubts(belt)[0]
    assert "left end was not seen" in warning
    assert "right end was not seen" in warning


@pytest.mark.parametrize("yaw_deg", list_cases([0.0, 25.0, 60.0, 90.0], [25.0]))
def test_belt_wider_than_the_view_has_no_ends_and_still_a_window(yaw_deg: float) -> None:
    scene = Scene(trough(700, (800, 25)), floor_mm=-300.0, belt_yaw_deg=yaw_deg, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE)
    assert ends_of(belt) == ("out of view", "out of view")
    assert "reaches the image's border" in describe_doubts(belt)[0]
    reference = make_reference(belt, CORE)
    low, high = reference.belt.across_mm
    assert high - low > 1000
    assert reference.window_mm[1] - reference.window_mm[0] > 900


def test_beam_across_the_view_cuts_no_belt() -> None:
    beam = Slab((-2000.0, 100.0, 300.0), (2000.0, 220.0, 380.0))
    scene = Scene(TROUGH, (beam,), floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE)
    np.testing.assert_allclose(belt.across_mm, true_ends(scene, belt, (-END, END)), atol=NEAR_MM)
    assert belt.along_mm[1] - belt.along_mm[0] > 1500


def test_dark_floor_leaves_the_ends_unknown_and_a_dark_stripe_ends_no_belt() -> None:
    scene = Scene(TROUGH, floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    unlit = learn_belt([measure_depth(scene, lambda p: p[..., 2] < -200)], CORE)
    assert ends_of(unlit) == ("unmeasured", "unmeasured")
    np.testing.assert_allclose(unlit.across_mm, true_ends(scene, unlit, (-END, END)), atol=NEAR_MM)
    striped = learn_belt(
        [measure_depth(scene, lambda p: (p[..., 0] > 140) & (p[..., 0] < 180) & (p[..., 2] > -200))], CORE
    )
    np.testing.assert_allclose(striped.across_mm, true_ends(scene, striped, (-END, END)), atol=NEAR_MM)


def test_width_places_an_end_that_a_board_hides() -> None:
    board = beside(250, 262, 60, 260, 1)
    scene = Scene(TROUGH, board, floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE, GivenBelt(width_mm=916.0))
    assert ends_of(belt) == ("seen", "inferred")
    edges = require(belt.edges)
    true = true_ends(scene, belt, (-END, END))
    assert abs(edges.right_mm - true[1]) < 3 * edges.right_sigma_mm
    assert belt.across_mm[1] < true_ends(scene, belt, (-END, 250.0))[1] + NEAR_MM
    assert belt.width_mm == 916.0
    assert not describe_doubts(belt)


def test_width_of_a_trough_wider_than_the_view_lies_about_its_middle() -> None:
    scene = Scene(trough(700, (800, 25)), floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE, GivenBelt(width_mm=1000.0))
    assert ends_of(belt) == ("told", "told")
    reach = 350 + 150 * np.cos(np.deg2rad(25))
    np.testing.assert_allclose(belt.across_mm, true_ends(scene, belt, (-reach, reach)), atol=NEAR_MM)
    assert measure_width_mm(belt) == pytest.approx(1000, abs=1)
    assert "1000 mm about the trough's middle" in describe_doubts(belt)[0]


def test_width_that_fits_leaves_what_was_seen() -> None:
    scene, plain = learn_before_floor()
    given = learn_belt([measure_depth(scene)], CORE, GivenBelt(width_mm=920.0))
    assert (plain.across_mm, plain.ends) == (given.across_mm, given.ends)


def test_contradictory_widths_are_refused_with_the_fix() -> None:
    scene = Scene(TROUGH, floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    with pytest.raises(
        MeasureError, match=r"9[01]\d mm apart along its surface, but its width is given as 1200 mm"
    ):
        learn_belt([measure_depth(scene)], CORE, GivenBelt(width_mm=1200.0))
    flat = Scene(trough(2600), **INCLINED)
    with pytest.raises(MeasureError, match=r"a flat belt .*; give --across A B"):
        learn_belt([measure_depth(flat)], CORE, GivenBelt(width_mm=1000.0))


def test_ends_that_are_given_limit_the_belt() -> None:
    scene = Scene(TROUGH, floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    belt = learn_belt([measure_depth(scene)], CORE, GivenBelt(across_mm=(-200.0, 300.0)))
    assert belt.across_mm == (-200.0, 300.0)
    assert (belt.x_mm[0], belt.x_mm[-1]) == (-200.0, 300.0)
    assert ends_of(belt) == ("told", "told")
    with pytest.raises(MeasureError, match="nothing was measured between x 2000 and 2400 mm"):
        learn_belt([measure_depth(scene)], CORE, GivenBelt(across_mm=(2000.0, 2400.0)))


def test_region_selects_the_belt_where_the_optical_axis_meets_a_platform_beside_it() -> None:
    # a wide platform as high as a flat belt, without a gap: only a person can tell them apart
    scene = Scene(trough(500), beside(250, 2000, -60, -0.01, 1), floor_mm=-300.0, **INCLINED)
    merged = learn_belt([measure_depth(scene)], CORE)
    assert ends_of(merged)[1] == "out of view"
    corners = np.array(
        [[-330.0, -600.0, 0.0], [250.0, -600.0, 0.0], [250.0, 600.0, 0.0], [-330.0, 600.0, 0.0]]
    )
    seen = scene.core_from_world.apply(corners)
    pixels = seen[:, :2] / seen[:, 2:] * CORE.focal_px + CORE.center_px
    region = tuple((float(u), float(v)) for u, v in pixels)
    belt = learn_belt([measure_depth(scene)], CORE, GivenBelt(region_px=region))
    np.testing.assert_allclose(belt.across_mm, true_ends(scene, belt, (-250.0, 250.0)), atol=NEAR_MM)
    assert ends_of(belt) == ("seen", "told")


@pytest.mark.parametrize("share", [0.0, 0.06, 0.3])
def test_sparse_depth_is_refused_or_measured_but_no_crash(share: float) -> None:
    scene = Scene(TROUGH, floor_mm=-300.0, **INCLINED)
    exact = scene.depth_mm()
    rng = np.random.default_rng(4)
    sparse = np.where(rng.random(exact.shape) < share, exact, np.nan)
    with pytest.raises(MeasureError, match=r"project speckle|give"):
        learn_belt([depth_map(sparse, noise_mm=0.5)], CORE)


def test_region_beside_the_image_is_refused() -> None:
    scene = Scene(TROUGH, floor_mm=-300.0, **INCLINED)
    with pytest.raises(MeasureError, match=r"hardly anything was measured in the region u 2000 to 2100"):
        learn_belt([measure_depth(scene)], CORE, GivenBelt(region_px=((2000, 0), (2100, 0), (2100, 90))))


def test_volume_on_a_belt_with_floor_in_view_is_that_of_the_load() -> None:
    scene, belt = learn_before_floor()
    load = Block((30.0, 20.0), (180.0, 150.0, 100.0), 20.0)
    volume = measure_volume(
        measure_depth(replace(scene, solids=(load,)), seed=7),
        belt,
        CORE,
        VolumeSettings(),
        across_mm=None,
        along_mm=(-250, 250),
    )
    assert volume.volume_mm3 == pytest.approx(load.volume_mm3, rel=0.04)
    assert abs(volume.volume_mm3 - load.volume_mm3) < 4 * volume.sigma_mm3
    assert volume.sigma_mm3 < 0.1 * load.volume_mm3
    assert 0 < volume.fullness.level < 1
    assert volume.fullness.whole_belt


def test_shape_that_holds_no_load_has_no_fill_level() -> None:
    _, belt = learn_before_floor()
    ridge = replace(belt, z_mm=-belt.z_mm)
    assert compute_capacity_mm2(belt, 0.3) > 1e4
    assert compute_capacity_mm2(ridge, 0.0) == 0.0


def test_flat_belt_without_edges_says_that_its_direction_is_not_known() -> None:
    scene = Scene(trough(2600), belt_yaw_deg=25.0, **INCLINED)
    depth = measure_depth(scene)
    belt = learn_belt([depth], CORE)
    assert belt.yaw_from == "camera"
    assert "beltscape measure belt --travel DEG" in describe_doubts(belt)[0]
    travel = scene.core_from_world.rotation @ [0.0, 1.0, 0.0]
    angle = (np.rad2deg(np.arctan2(-travel[0], travel[1])) + 90) % 180 - 90
    given = learn_belt([depth], CORE, GivenBelt(travel_deg=float(angle)))
    assert given.yaw_from == "told"
    assert not any("direction of travel" in doubt for doubt in describe_doubts(given))
    assert np.rad2deg(np.arccos(min(1.0, abs(float(travel @ given.belt_from_core.rotation[1]))))) < 1.0


def test_direction_that_contradicts_the_shape_or_the_edges_is_refused() -> None:
    troughed = measure_depth(Scene(TROUGH, floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED))
    with pytest.raises(MeasureError, match="but its shape shows"):
        learn_belt([troughed], CORE, GivenBelt(travel_deg=70.0))
    flat = Scene(trough(600), floor_mm=-300.0, belt_yaw_deg=25.0, **INCLINED)
    with pytest.raises(MeasureError, match="but its edges show"):
        learn_belt([measure_depth(flat)], CORE, GivenBelt(travel_deg=-60.0))
