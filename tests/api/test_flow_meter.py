"""The flow meter of the Python interface on a heap that passes a synthetic camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import beltscape as bs
from tests.measure.flow.moving_belt import COARSE_CAMERA, Heap, depth_map
from tests.measure.flow.test_flow_meter import HEAP, positions, seen

STEP_MM = 150.0


@pytest.fixture(scope="module")
def rig() -> bs.Rig:
    return bs.Rig("cam0", {"cam0": COARSE_CAMERA}, {"cam0": bs.Pose.identity()})


@pytest.fixture(scope="module")
def belt(rig: bs.Rig) -> bs.Belt:
    return bs.learn_belt([depth_map(None, 0.0, seed=99, camera=COARSE_CAMERA)], rig)


def scale(depth: bs.DepthMap, share: float) -> bs.DepthMap:
    """Return a depth map as a rig of a larger board would measure it."""
    return replace(depth, depth_mm=depth.depth_mm * np.float32(1 + share))


def measure(meter: bs.FlowMeter, *, encoder: bool, share: float = 0.0) -> list[bs.FlowRecord]:
    records: list[bs.FlowRecord] = []
    for number, place in enumerate(positions(STEP_MM)):
        depth = scale(seen(HEAP, place, 1), share)
        records += meter.push(depth, round(number * 1e8), place if encoder else None)
    return records + meter.finish()


@pytest.mark.parametrize("encoder", [True, False])
def test_total_is_the_heap(rig, belt, encoder):
    meter = bs.FlowMeter(rig, belt, density_kg_m3=1600)
    records = measure(meter, encoder=encoder)
    true_mm3 = HEAP.volume_between_mm3(HEAP.start_mm, HEAP.end_mm)
    assert meter.totals.volume_mm3 == pytest.approx(true_mm3, rel=0.02)
    assert sum(record.volume_mm3 for record in records) == pytest.approx(meter.totals.volume_mm3)
    assert meter.totals.mass_kg == pytest.approx(1600e-9 * meter.totals.volume_mm3)
    assert records == meter.records
    assert repr(meter).startswith("FlowMeter(")
    assert repr(records[3]).startswith("FlowRecord(")
    assert len(meter.plot().get_axes()) >= 2
    assert "data:image/png" in meter._repr_html_()


@pytest.mark.parametrize("encoder", [True, False])
def test_the_sigma_of_the_rigs_lengths_is_what_another_size_of_its_board_changes(rig, belt, encoder):
    """The material's motion follows the rig's scale and places the frames, so that all three lengths do."""
    share = 0.003  # within the tolerance of an encoder
    meter = bs.FlowMeter(rig, belt)
    measure(meter, encoder=encoder)
    known = bs.FlowMeter(replace(rig, quality={"scale_sigma": share}), belt)
    records = measure(known, encoder=encoder)
    added_mm3 = np.sqrt(known.totals.sigma_mm3**2 - meter.totals.sigma_mm3**2)
    larger = bs.learn_belt([scale(depth_map(None, 0.0, seed=99, camera=COARSE_CAMERA), share)], rig)
    scaled = bs.FlowMeter(rig, larger)
    measure(scaled, encoder=encoder, share=share)
    assert added_mm3 == pytest.approx(scaled.totals.volume_mm3 - meter.totals.volume_mm3, rel=0.03)
    assert sum(one.sigma_parts.scale_mm3 for one in records) == pytest.approx(added_mm3, rel=1e-6)


def test_an_encoder_alone_does_not_follow_the_rigs_scale(rig, belt):
    """Between views that hardly overlap no motion shows; then the encoder measures the belt's length."""
    share = 0.003
    larger = bs.learn_belt([scale(depth_map(None, 0.0, seed=99, camera=COARSE_CAMERA), share)], rig)
    known = replace(rig, quality={"scale_sigma": share})
    plain, scaled = measure_apart(known, belt, 0.0), measure_apart(rig, larger, share)
    assert plain[0].sigma_parts.scale_mm3 == pytest.approx(3 * share * plain[0].volume_mm3)
    for one, other in zip(plain[1:], scaled[1:], strict=True):
        assert one.sigma_parts.scale_mm3 == pytest.approx(2 * share * one.volume_mm3)
        assert other.volume_mm3 - one.volume_mm3 == pytest.approx(one.sigma_parts.scale_mm3, rel=0.05)


def measure_apart(rig: bs.Rig, belt: bs.Belt, share: float) -> list[bs.FlowRecord]:
    """Measure an even load every 500 mm, of a view of 551 mm."""
    even = Heap(start_mm=-1e5, end_mm=1e5, hills_mm=0.0)
    meter = bs.FlowMeter(rig, belt, direction="+y")
    for number in range(4):
        depth = scale(seen(even, number * 500.0, 1), share)
        meter.push(depth, round(number * 1e8), number * 500.0)
    meter.finish()
    return meter.records


def test_a_wrong_direction_is_refused(rig, belt):
    with pytest.raises(bs.BeltscapeError, match="direction"):
        measure(bs.FlowMeter(rig, belt, direction="-y"), encoder=False)


@pytest.mark.parametrize(
    ("given", "says"),
    [({"direction": "up"}, "direction = .up."), ({"density_kg_m3": 0}, "density_kg_m3 = 0")],
)
def test_arguments_are_named(rig, belt, given, says):
    with pytest.raises(bs.BeltscapeError, match=says):
        bs.FlowMeter(rig, belt, **given)
