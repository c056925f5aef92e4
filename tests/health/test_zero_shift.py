"""The bare belt against the learned one: shifts, tilts, what lies on the belt, and what is published."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import scale_camera
from beltscape.core.ledger import FlowRecord
from beltscape.health.belt.cells import compute_belt_cells
from beltscape.health.belt.monitor import BeltMonitor
from beltscape.health.belt.zero_finding import ZeroHistory, update_zero_history
from beltscape.health.belt.zero_setting import zero_offset
from beltscape.health.belt.zero_shift import ZeroShift, estimate_zero_shift
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import EmptyBeltReference, make_reference
from beltscape.measure.flow.meter import BeltFlowMeter
from beltscape.measure.flow.strips import FlowTotals
from tests.measure.flow.moving_belt import CAMERA, HEIGHT_MM, Heap, depth_map, make_empty_belt, trough_mm
from tests.thorough import list_cases

REFERENCE = make_empty_belt()
LOAD = Heap(-600.0, 2500.0, half_width_mm=170.0)
BESIDE = Heap(-400.0, 2000.0, half_width_mm=190.0)


def moved(rise_mm: float = 0.0, *, across_deg: float = 0.0, along_deg: float = 0.0) -> EmptyBeltReference:
    """The reference as learned before the belt rose and tilted."""
    turn = Pose.of(np.deg2rad([along_deg, -across_deg, 0.0]), np.zeros(3)).rotation
    motion = Pose(turn, np.array([0.0, 0.0, rise_mm]))
    belt = replace(REFERENCE.belt, belt_from_core=motion @ REFERENCE.belt.belt_from_core)
    return make_reference(belt, CAMERA)


def shift_of(depth: DepthMap, reference: EmptyBeltReference) -> ZeroShift:
    return estimate_zero_shift(compute_belt_cells(depth, reference), reference.belt, reference.cell_mm, 40.0)


def with_layer(depth: DepthMap, layer_mm: np.ndarray) -> DepthMap:
    """The depth map with a layer (H, W) on the surface."""
    return replace(depth, depth_mm=(depth.depth_mm - layer_mm).astype(np.float32))


def position() -> tuple[np.ndarray, np.ndarray]:
    """Approximate x and y of the pixels on the belt."""
    rays = CAMERA.rays()
    return rays[..., 0] * HEIGHT_MM, -rays[..., 1] * HEIGHT_MM


@pytest.mark.parametrize("rise_mm", [0.0, 0.2, 1.0, 5.0, 20.0, -0.5, -5.0, -20.0])
@pytest.mark.parametrize("heap", [None, BESIDE])
def test_rise_is_measured_beside_a_load(rise_mm, heap):
    shift = shift_of(depth_map(heap, 300.0), moved(rise_mm))
    assert abs(shift.offset_mm - rise_mm) < 2 * shift.sigma_mm + 0.01
    assert shift.sigma_mm < 0.15


@pytest.mark.parametrize(("across_deg", "along_deg"), [(0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.2, -0.2)])
def test_tilt_and_rise_are_distinguished(across_deg, along_deg):
    shift = shift_of(
        depth_map(Heap(-400.0, 2000.0, half_width_mm=150.0), 300.0),
        moved(1.0, across_deg=across_deg, along_deg=along_deg),
    )
    low, high = REFERENCE.belt.across_mm
    ends = np.ptp(REFERENCE.seen_mm)
    expected = np.tan(np.deg2rad([across_deg, along_deg])) * [high - low, ends]
    # the wings of a trough that turns about its bottom also move sideways
    np.testing.assert_allclose(shift.tilts_mm[:, 0], expected, rtol=0.15, atol=0.1)


def test_a_fully_loaded_belt_is_not_measured():
    rng = np.random.default_rng(1)
    rough = 60 + 8 * rng.normal(size=(CAMERA.size_px[1], CAMERA.size_px[0]))
    findings = {f.check: f for f in BeltMonitor(REFERENCE).check(with_layer(depth_map(None, 0.0), rough))}
    assert np.isnan(findings["zero_shift"].value)
    assert not any(finding.is_fault for finding in findings.values())


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_material_left_on_one_side_is_no_rise(share):
    """A film of 3 mm on a part of the belt is no motion: the rest lies where it was."""
    x, _ = position()
    film = 3.0 * (x > np.quantile(x, 1 - share))
    shift = shift_of(with_layer(depth_map(None, 0.0), film), REFERENCE)
    assert abs(shift.offset_mm) < 0.1


def test_grains_on_the_belt_are_no_rise():
    rng = np.random.default_rng(4)
    grains = rng.uniform(2, 12, (CAMERA.size_px[1], CAMERA.size_px[0])) * (
        rng.random((CAMERA.size_px[1], CAMERA.size_px[0])) < 0.08
    )
    shift = shift_of(with_layer(depth_map(None, 0.0), grains), REFERENCE)
    assert abs(shift.offset_mm) < 0.1


def test_sound_frames_are_no_fault():
    monitor = BeltMonitor(REFERENCE)
    heap = Heap(0.0, 1500.0, half_width_mm=200.0)
    for number in range(12):
        for finding in monitor.check(depth_map(heap, 100.0 * number - 300, seed=number)):
            assert not finding.is_fault
            assert finding.systematic_mm < 0.1


def test_slow_drift_becomes_significant_over_frames():
    """Single frames with a σ of 0.2 mm show a drift of 0.3 mm after some tens of them."""
    rng = np.random.default_rng(2)
    template = shift_of(depth_map(None, 0.0), REFERENCE)
    history = ZeroHistory()
    for _ in range(60):
        frame = replace(template, offset_mm=0.3 + 0.2 * rng.normal(), sigma_mm=0.2, common_mm=0.01)
        history = update_zero_history(history, frame, 0.15)
    assert history.sigma_mm < 0.08
    assert abs(history.offset_mm - 0.3) < 3 * history.sigma_mm


def test_covered_belt_keeps_the_known_shift():
    monitor = BeltMonitor(moved(1.0))
    monitor.check(depth_map(None, 0.0))
    shift, drift, _ = monitor.check(None)
    assert np.isnan(shift.value)
    assert drift.effect == "degraded"
    assert 0.95 < drift.systematic_mm < 1.1


def publish(reference: EmptyBeltReference) -> tuple[list[FlowRecord], FlowTotals]:
    """Return the records and totals of a loaded belt."""
    monitor, meter, records = BeltMonitor(reference), BeltFlowMeter(reference), []
    for number in range(10):
        depth = depth_map(LOAD, 100.0 * number, seed=number)
        records += meter.push(depth, number * 10**8, 100.0 * number, findings=monitor.check(depth))
    return records + meter.finish(), meter.totals


@cache
def publish_sound() -> tuple[list[FlowRecord], FlowTotals]:
    return publish(REFERENCE)


@pytest.mark.parametrize(
    "rise_mm",
    list_cases([0.2, 1.0, 3.0, 10.0, -1.0, -3.0], [0.2, -3.0]),
)
def test_records_on_a_moved_belt_cover_the_error(rise_mm):
    """With the belt risen, no record beyond the limit is valid, and σ covers the error of each and of the total."""
    (sound, total), (records, shifted) = publish_sound(), publish(moved(rise_mm))
    assert all(record.quality == "measured" for record in sound[1:-1])
    if abs(rise_mm) > BeltLimits().zero_mm:
        assert {record.quality for record in records} <= {"degraded", "missing"}
        assert all("learned" in record.reason for record in records if record.quality == "degraded")
    for one, other in zip(sound, records, strict=True):
        assert abs(one.volume_mm3 - other.volume_mm3) <= 2 * other.sigma_mm3
    assert abs(total.volume_mm3 - shifted.volume_mm3) <= 2 * shifted.sigma_mm3


def test_zero_is_set_on_the_empty_belt():
    empty = [depth_map(None, 0.0, seed=seed) for seed in range(3)]
    setting = zero_offset(empty, moved(1.2, across_deg=0.1))
    assert abs(setting.offset_mm - 1.2) < 3 * setting.sigma_mm
    after = shift_of(depth_map(None, 0.0, seed=9), setting.reference)
    assert np.abs(after.motion_mm[:3]).max() < 0.05
    assert setting.reference.belt.drift_mm >= setting.sigma_mm


def test_zero_is_not_set_beyond_the_limit_or_on_a_load():
    empty, loaded = depth_map(None, 0.0), depth_map(Heap(-400.0, 2000.0), 300.0)
    with pytest.raises(MeasureError, match=r"rise of 3\S* mm since it was learned exceeds the limit of 2 mm"):
        zero_offset([empty], moved(3.0))
    with pytest.raises(MeasureError, match=r"frame 1: only \d+ % of the belt is bare"):
        zero_offset([empty, loaded], moved(1.0))
    with pytest.raises(MeasureError, match="the frames differ by"):
        zero_offset([empty, with_layer(empty, np.full(empty.depth_mm.shape, 1.5))], REFERENCE)


def test_trough_of_the_scene_is_the_learned_one():
    x = np.linspace(-150, 150, 7)
    np.testing.assert_allclose(REFERENCE.belt.height_mm(x), trough_mm(x), atol=0.5)


def test_a_belt_learned_from_images_of_another_size_widens_sigma_instead_of_raising_the_zero():
    fine = scale_camera(CAMERA, 2.0)
    learned = replace(REFERENCE.belt, camera=fine)
    other, same = make_reference(learned, CAMERA), make_reference(replace(learned, camera=CAMERA), CAMERA)
    assert same.other_size_mm == 0.0
    assert other.other_size_mm == pytest.approx(0.06 * HEIGHT_MM / CAMERA.focal_px.mean(), rel=0.02)
    lifted = with_layer(depth_map(None, 0.0), np.full(CAMERA.size_px[::-1], 3 * other.other_size_mm))
    for reference, is_fault in ((same, True), (other, False)):
        findings = {one.check: one for one in BeltMonitor(reference).check(lifted)}
        assert findings["zero_shift"].is_fault == is_fault
        assert findings["zero_shift"].systematic_mm >= abs(findings["zero_shift"].value)
