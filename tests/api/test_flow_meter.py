"""The flow meter of the Python interface on a heap that passes a synthetic camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import beltscape as bs
from tests.measure.flow.moving_belt import COARSE_CAMERA, depth_map
from tests.measure.flow.test_flow_meter import HEAP, positions, seen

STEP_MM = 150.0


@pytest.fixture(scope="module")
def rig() -> bs.Rig:
    return bs.Rig("cam0", {"cam0": COARSE_CAMERA}, {"cam0": bs.Pose.identity()})


@pytest.fixture(scope="module")
def belt(rig: bs.Rig) -> bs.Belt:
    return bs.learn_belt([depth_map(None, 0.0, seed=99, camera=COARSE_CAMERA)], rig)


def measure(meter: bs.FlowMeter, *, encoder: bool) -> list[bs.FlowRecord]:
    records: list[bs.FlowRecord] = []
    for number, place in enumerate(positions(STEP_MM)):
        records += meter.push(seen(HEAP, place, 1), round(number * 1e8), place if encoder else None)
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


def test_the_sigma_of_the_rigs_lengths_is_in_the_total(rig, belt):
    """Of a cross-section it is twice that of a length; the encoder measures the belt."""
    meter = bs.FlowMeter(rig, belt)
    measure(meter, encoder=True)
    known = bs.FlowMeter(replace(rig, quality={"scale_sigma": 0.02}), belt)
    measure(known, encoder=True)
    added_mm3 = np.sqrt(known.totals.sigma_mm3**2 - meter.totals.sigma_mm3**2)
    assert added_mm3 == pytest.approx(2 * 0.02 * meter.totals.volume_mm3, rel=0.02)


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
