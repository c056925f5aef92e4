"""What does not travel with the belt is found within two frames; what does is never accused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.core.findings import Finding
from beltscape.measure.flow.foreign_objects import ForeignObjectCheck
from beltscape.measure.flow.meter import BeltFlowMeter
from tests.measure.flow.moving_belt import COARSE_CAMERA, HEIGHT_MM, Heap, depth_map, make_empty_belt
from tests.thorough import list_cases, list_rows

Array = NDArray[np.float64]
Heights = NDArray[np.floating]
CELL_MM, ROWS, COLUMNS = 5.0, 124, 120
X, Y = np.meshgrid(CELL_MM * (np.arange(COLUMNS) - 59.5), CELL_MM * (np.arange(ROWS) - 61.5))
BEGIN, END, COUNT = 6, 12, 18
"""The object is there from frame BEGIN to before END."""
HEAP = Heap(start_mm=-20_000, end_mm=20_000, half_width_mm=220.0, hills_mm=9.0)
Load = Callable[[Array, Array], Heights]
"""Height at x and the belt's own y."""
Objects = Callable[[int], Heights]
"""Height of the objects over the static grid in a frame; NaN where there is none."""


def heap(x: Array, y: Array) -> Heights:
    return HEAP.height_mm(x, y)


def empty(x: Array, _: Array) -> Heights:
    return np.zeros_like(x)


def ridge(x: Array, _: Array) -> Heights:
    """A strand that looks alike at every instant."""
    return np.clip(60.0 - 0.4 * np.abs(x), 0, None)


def corrugated(x: Array, y: Array) -> Heights:
    """A load that repeats itself every 75 mm."""
    return np.clip(60.0 - 0.3 * np.abs(x), 0, None) * (1 + 0.3 * np.sin(2 * np.pi * y / 75))


def worn(x: Array, y: Array) -> Heights:
    """Carry-back in patches and a splice."""
    patches = 4.0 * (np.sin(x / 40) * np.sin(y / 55) > 0.3)
    return patches + 3.0 * (np.abs(y % 1600 - 800) < 120)


def lumps(x: Array, y: Array) -> Heights:
    """Single lumps of 80 mm on a bare belt, 700 mm apart."""
    return 80.0 * ((np.abs(x - 30) < 50) & (np.abs((y + 5000) % 700 - 350) < 60))


def make_box(
    width: float, length: float, top: float, path: Callable[[int], tuple[float, float]] = lambda _: (0.0, 0.0)
) -> Objects:
    def heights(frame: int) -> Heights:
        x, y = path(frame)
        inside = (np.abs(X - x) <= width / 2) & (np.abs(Y - y) <= length / 2)
        return np.where(inside, top, np.nan)

    return heights


OBJECTS: dict[str, tuple[Load, Objects]] = {
    "plate at rest": (heap, make_box(90, 320, 166)),
    "plate where the belt enters": (heap, make_box(90, 320, 166, lambda _: (60.0, -250.0))),
    "plate where the belt leaves": (heap, make_box(90, 320, 166, lambda _: (-60.0, 250.0))),
    "arm that moves across": (heap, make_box(90, 320, 166, lambda k: (-250.0 + 80.0 * (k - BEGIN), 0.0))),
    "chain that swings": (heap, make_box(35, 260, 150, lambda k: (70.0 * np.sin(k), 20.0))),
    "cable": (heap, make_box(560, 22, 180, lambda _: (0.0, 40.0))),
    "jammed lump": (empty, make_box(120, 140, 95, lambda _: (40.0, 30.0))),
    "jammed lump under others": (lumps, make_box(120, 140, 130, lambda _: (-150.0, 30.0))),
}


def make_heights(
    load: Load, position_mm: float, objects: Heights | None, seed: int, direction: int = 1
) -> NDArray[np.float32]:
    """Return the heights of a frame."""
    height = load(np.asarray(X, np.float64), np.asarray(Y - direction * position_mm, np.float64))
    if objects is not None:
        height = np.fmax(height, objects)
    return (height + np.random.default_rng(seed).normal(0, 0.4, height.shape)).astype(np.float32)


def run(
    load: Load, objects: Objects | None, step_mm: float, *, count: int = COUNT, direction: int = 1
) -> tuple[list[Finding], dict[int, NDArray[np.bool_]]]:
    """Return the findings, and by frame the cells that are left out."""
    check = ForeignObjectCheck(CELL_MM, ROWS * CELL_MM)
    findings: list[Finding] = []
    masks: dict[int, NDArray[np.bool_]] = {}
    for frame in range(count):
        own = objects(frame) if objects is not None and BEGIN <= frame < END else None
        position = frame * step_mm
        heights = make_heights(load, position, own, frame, direction)
        found = check.check(frame, position, direction, heights, is_proven=load is not empty)
        findings.append(found.finding)
        masks |= found.masks
    return findings, masks


@pytest.mark.parametrize("step_mm", list_cases([25.0, 75.0, 200.0], [75.0]))
@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_is_named_within_two_frames_and_left_out(name: str, step_mm: float) -> None:
    load, objects = OBJECTS[name]
    findings, masks = run(load, objects, step_mm)
    assert not any(one.is_fault for one in findings[:BEGIN])
    assert any(one.is_fault for one in findings[BEGIN : BEGIN + 2])
    fault = next(one for one in findings if one.is_fault)
    assert (fault.check, fault.effect) == ("foreign_object", "degraded")
    assert fault.systematic_mm > 0
    assert fault.cause == ("foreign_object_alone" if load is empty else "foreign_object")
    assert not any(one.is_fault for one in findings[END + 2 :])
    left = [np.isfinite(objects(frame)) & ~masks.get(frame, False) for frame in range(BEGIN, END)]  # pyrefly: ignore[deprecated]
    whole = [np.isfinite(objects(frame)) for frame in range(BEGIN, END)]
    assert sum(map(np.sum, left)) < 0.25 * sum(map(np.sum, whole))
    beside = [mask & ~np.isfinite(objects(frame)) for frame, mask in masks.items() if BEGIN <= frame < END]
    assert max(cells.mean() for cells in beside) < 0.16  # the rim


def test_a_bird_is_in_one_frame() -> None:
    findings, masks = run(
        heap, lambda k: make_box(150, 80, 220)(k) if k == BEGIN else np.full(X.shape, np.nan), 150.0
    )
    assert any(one.is_fault for one in findings[BEGIN : BEGIN + 2])
    assert set(masks) == {BEGIN}


MOTIONS = [(step_mm, direction) for step_mm in (0.0, 3.0, 25.0, 75.0, 210.0, 400.0) for direction in (1, -1)]


@pytest.mark.parametrize(("step_mm", "direction"), list_rows(MOTIONS, [(0.0, 1), (25.0, -1), (210.0, 1)]))
@pytest.mark.parametrize("load", [heap, empty, ridge, corrugated, worn, lumps])
def test_a_belt_with_its_load_is_not_accused(load: Load, step_mm: float, direction: int) -> None:
    findings, masks = run(load, None, step_mm, direction=direction)
    assert not masks
    assert not any(one.is_fault for one in findings)
    assert all(one.value == 0 for one in findings[1:])


@pytest.mark.parametrize("step_mm", [25.0, 75.0, 150.0])
def test_a_lump_that_falls_on_the_belt_travels_with_it(step_mm: float) -> None:
    lump = make_box(120, 120, 140, lambda k: (0.0, -200.0 + step_mm * (k - BEGIN)))
    findings, masks = run(heap, lump, step_mm, count=END)
    assert not masks
    assert not any(one.is_fault for one in findings)


def test_a_motion_that_most_of_the_load_contradicts_is_not_judged() -> None:
    """An encoder that jumps is no object, as long as no registration proves its motion."""
    check = ForeignObjectCheck(CELL_MM, ROWS * CELL_MM)
    bumpy = Heap(start_mm=-20_000, end_mm=20_000, half_width_mm=280.0, hills_mm=40.0)
    for frame in range(6):
        position = 75.0 * frame + (140.0 if frame > 3 else 0.0)
        heights = make_heights(bumpy.height_mm, 75.0 * frame, None, frame)
        found = check.check(frame, position, 1, heights, is_proven=frame <= 3)
        assert not found.finding.is_fault


def test_the_meter_measures_what_lies_under_a_plate() -> None:
    """The volume is that without the plate, within the σ that it adds."""

    def measure(*, has_plate: bool) -> BeltFlowMeter:
        meter = BeltFlowMeter(make_empty_belt(COARSE_CAMERA))
        load = Heap(start_mm=-2000, end_mm=-300)
        for number in range(22):
            depth = depth_map(load, 100.0 * number, seed=3, camera=COARSE_CAMERA)
            if has_plate and 8 <= number < 16:
                rays, top = COARSE_CAMERA.rays(), HEIGHT_MM - 166
                inside = (np.abs(top * rays[..., 0]) < 45) & (np.abs(top * rays[..., 1]) < 130)
                depth = type(depth)(
                    np.where(inside, top, depth.depth_mm).astype(np.float32),
                    depth.sigma_mm,
                    depth.views,
                    depth.confidence,
                )
            meter.push(depth, number * 10**8, 100.0 * number)
        meter.finish()
        return meter

    sound, disturbed = measure(has_plate=False).totals, measure(has_plate=True).totals
    assert disturbed.length_mm == pytest.approx(sound.length_mm, rel=0.002)
    assert disturbed.volume_mm3 == pytest.approx(sound.volume_mm3, rel=0.02)
    assert abs(disturbed.volume_mm3 - sound.volume_mm3) < 2 * disturbed.sigma_mm3
    assert disturbed.sigma_mm3 < 0.15 * sound.volume_mm3


def test_a_lump_that_rolls_back_out_of_view_is_not_accused():
    """At the end of the view the matcher's cut-off windows show the belt where a lump begins."""
    check = ForeignObjectCheck(CELL_MM, CELL_MM * ROWS)
    findings = []
    for number, position_mm in enumerate((210.0, 105.0, 0.0)):
        y = Y - position_mm
        height_mm = np.where((np.abs(X) < 45) & (np.abs(y + 290) < 35), 80.0, 0.0).astype(np.float32)
        height_mm[:11] = 0.0
        found = check.check(number, position_mm, 1, height_mm, is_proven=False)
        findings.append(found.finding.is_fault)
    assert findings == [False, False, False]
