"""The output of `measure flow`: mass only with a density, and the evidence for the direction."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from beltscape.cli.commands.measure_flow import summary
from beltscape.core.ledger import FlowRecord
from beltscape.measure.flow.density import Density, make_unknown_density
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from beltscape.measure.flow.rows import BeltPicture
from beltscape.pipeline.measuring.flow import Flow, write_flow_result
from tests.measure.flow.moving_belt import COARSE_CAMERA, Heap, depth_map, make_empty_belt

HEAP = Heap(start_mm=-900, end_mm=-300)


def measured(density: Density, *, timed: bool = True, heap: Heap | None = HEAP) -> Flow:
    belt = make_empty_belt(COARSE_CAMERA)
    picture, steps, records = BeltPicture(belt), list[FramePlacement](), list[FlowRecord]()
    meter = BeltFlowMeter(belt, density=density, watch_belt=picture.add, watch_step=steps.append)
    for k in range(10):
        depth = depth_map(heap, 130.0 * k, camera=COARSE_CAMERA)
        records += meter.push(depth, round(k * 1e8) if timed else None, 130.0 * k, frame=f"{k:03d}")
    records += meter.finish()
    return Flow(records, steps, meter, picture, 0.1, True, None)


def write_without_density(folder: Path, *, timed: bool) -> tuple[Mapping[str, Any], Path]:
    unknown = make_unknown_density()
    return write_flow_result(folder, measured(unknown, timed=timed), unknown, ()), folder


@pytest.fixture(scope="module")
def timed_flow(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mapping[str, Any], Path]:
    """The result of a flow without a density, and its folder."""
    return write_without_density(tmp_path_factory.mktemp("flow"), timed=True)


@pytest.mark.parametrize("timed", [True, pytest.param(False, marks=pytest.mark.thorough)])
def test_flow_without_density_has_no_mass(
    timed_flow: tuple[Mapping[str, Any], Path], tmp_path: Path, timed: bool
) -> None:
    result, folder = timed_flow if timed else write_without_density(tmp_path, timed=False)
    text = summary(result)
    assert "mass" not in text
    assert not re.search(r"\bnan\b", text, re.IGNORECASE)
    assert not re.search(r"\bnan\b", (folder / "flow.json").read_text(), re.IGNORECASE)
    totals = json.loads((folder / "flow.json").read_text())["totals"]
    assert totals["mass_t"] is None
    assert (totals["mean_volume_flow_m3_h"] is None) == (not timed)


def test_flow_with_density_has_mass(tmp_path: Path) -> None:
    density = Density.constant(1600.0)
    result = write_flow_result(tmp_path, measured(density), density, ())
    totals = result["totals"]
    assert totals["mass_t"] == pytest.approx(totals["volume_mm3"] * 1600e-12)
    assert "mass" in summary(result)


def test_summary_names_the_evidence_of_the_direction(timed_flow: tuple[Mapping[str, Any], Path]) -> None:
    result, _ = timed_flow
    evidence = result["motion_evidence"]
    assert evidence["pairs_towards_plus_y"] == evidence["encoder_agrees"] >= 5
    assert f"in {evidence['pairs_towards_plus_y']} of" in summary(result)


@pytest.mark.thorough
def test_direction_of_an_empty_belt_is_unknown(tmp_path: Path) -> None:
    result = write_flow_result(
        tmp_path, measured(make_unknown_density(), heap=None), make_unknown_density(), ()
    )
    assert result["direction"] is None
    assert "direction unknown" in summary(result)
    assert not re.search(r"\bnan\b", summary(result), re.IGNORECASE)
