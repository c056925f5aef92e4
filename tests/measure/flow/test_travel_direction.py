"""The check of the material's motion against the belt's axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.core.findings import Finding
from beltscape.core.ledger import FlowRecord
from beltscape.measure.flow.meter import BeltFlowMeter
from beltscape.measure.flow.registration import compute_high_pass
from beltscape.measure.flow.travel_direction import LIMIT_DEG, register_in_plane
from tests.measure.flow.moving_belt import COARSE_CAMERA, NOISE_MM, Heap, depth_map, make_empty_belt

HEAP = Heap(start_mm=-2500, end_mm=600, half_width_mm=110.0)
CELL_MM = 5.0
YawFrom = Literal["shape", "edges", "told", "camera"]


@dataclass(frozen=True)
class AskewHeap:
    """The heap on a belt that travels at an angle to the axis of the frame, towards +x."""

    angle_deg: float
    place_mm: float

    def height_mm(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        angle = np.radians(self.angle_deg)
        across = x * np.cos(angle) - y * np.sin(angle)
        return HEAP.height_mm(across, x * np.sin(angle) + y * np.cos(angle) - self.place_mm)


def measure(
    angle_deg: float, *, encoder: bool = True, yaw_from: YawFrom = "camera", frames: int = 14
) -> tuple[list[Finding], list[FlowRecord]]:
    empty = make_empty_belt(COARSE_CAMERA)
    turned = replace(empty, belt=replace(empty.belt, yaw_from=yaw_from, yaw_sigma_rad=None))
    meter = BeltFlowMeter(turned)
    findings: list[Finding] = []
    records: list[FlowRecord] = []
    for k in range(frames):
        place = 80.0 * k
        depth = depth_map(AskewHeap(angle_deg, place), 0.0, seed=k, camera=COARSE_CAMERA)
        records += meter.push(depth, round(k * 1e8), place if encoder else None, frame=f"{k:03d}")
        findings += [one for one in meter.findings if one.check == "travel_direction"]
    return findings, records + meter.finish()


def list_faults(findings: Sequence[Finding]) -> list[Finding]:
    return [one for one in findings if one.is_fault]


@pytest.mark.parametrize(
    ("across_mm", "along_mm"), [(0.0, 85.0), (60.0, 80.0), (-90.0, 40.0), (35.0, -100.0)]
)
def test_any_motion_in_the_plane_is_found_to_a_part_of_a_cell(across_mm: float, along_mm: float) -> None:
    x, y = np.arange(-250, 250, CELL_MM)[None], np.arange(-200, 200, CELL_MM)[:, None]
    wide = Heap(start_mm=-1500, end_mm=1500, half_width_mm=400.0)
    before, after = (
        compute_high_pass(wide.height_mm(x - dx, y - dy), CELL_MM, NOISE_MM)
        for dx, dy in ((0.0, 0.0), (across_mm, along_mm))
    )
    found = register_in_plane(before, after)
    assert found is not None
    assert found.across_mm == pytest.approx(across_mm, abs=0.3 * CELL_MM)
    assert found.along_mm == pytest.approx(along_mm, abs=0.3 * CELL_MM)


def test_other_material_has_no_motion() -> None:
    x, y = np.arange(-250, 250, CELL_MM)[None], np.arange(-200, 200, CELL_MM)[:, None]
    one, two = (
        compute_high_pass(
            Heap(-1500, 1500, half_width_mm=400.0, seed=seed).height_mm(x, y), CELL_MM, NOISE_MM
        )
        for seed in (3, 4)
    )
    assert register_in_plane(one, two) is None


@pytest.mark.parametrize(("angle_deg", "encoder"), [(25.0, True), (-25.0, True), (25.0, False), (5.0, True)])
def test_material_that_moves_askew_is_named_with_the_direction_to_give(
    angle_deg: float, encoder: bool
) -> None:
    findings, records = measure(angle_deg, encoder=encoder)
    fault = list_faults(findings)[-1]
    assert fault.value == pytest.approx(angle_deg, abs=1.0)
    assert abs(fault.value - angle_deg) < 4 * fault.sigma
    # y is against v here: towards +x and +y is the line from the lower left to the upper right of the image
    assert str(fault.text).endswith(f"--travel {round(fault.value, 1):g}")
    assert all(record.quality != "measured" for record in records[3:])


def test_a_turned_rig_is_learned_again() -> None:
    findings, _ = measure(25.0, yaw_from="shape")
    assert "has turned since the empty belt was learned" in list_faults(findings)[-1].text


@pytest.mark.parametrize("angle_deg", [0.0, 1.0])
def test_a_belt_along_its_axis_is_not_accused(angle_deg: float) -> None:
    findings, records = measure(angle_deg)
    assert not list_faults(findings)
    assert findings[-1].value == pytest.approx(angle_deg, abs=0.5)
    assert findings[-1].limit == LIMIT_DEG
    assert any(record.quality == "measured" for record in records)
