"""The quick form: volumes of objects by hand, and passes of a heap of known volume under a simulated camera."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from beltscape.cli.main import main
from beltscape.core.ledger import FlowRecord
from beltscape.measure.flow.density import make_unknown_density
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from beltscape.measure.flow.rows import BeltPicture
from beltscape.pipeline.certifying.known_volume import make_box, make_module
from beltscape.pipeline.measuring.belt import describe_measured_by
from beltscape.pipeline.measuring.flow import Flow, write_flow_result
from tests.measure.flow.moving_belt import COARSE_CAMERA, Heap, depth_map, make_empty_belt
from tests.pipeline.certifying.plants import SimulatedPlant

HEAP = Heap(start_mm=-900, end_mm=-300)


def test_a_box_has_the_uncertainty_of_its_edges() -> None:
    box = make_box([300.0, 200.0, 100.0], 0.1)
    assert box.volume_m3 == pytest.approx(0.006)
    by_hand = math.sqrt((200 * 100 * 0.1) ** 2 + (300 * 100 * 0.1) ** 2 + (300 * 200 * 0.1) ** 2)
    assert box.sigma_m3 == pytest.approx(by_hand * 1e-9)


def test_a_module_has_the_volume_below_what_is_seen(tmp_path) -> None:
    path = tmp_path / "module.toml"
    path.write_text(
        'name = "m"\n[base]\nsize_mm = [300, 200, 10]\n'
        '[[cube]]\nname = "c"\nedge_mm = 100\ncenter_mm = [0, 0]\n'
        '[[sphere]]\nname = "s"\ndiameter_mm = 60\ncenter_mm = [100, 0]\n'
        '[[cylinder]]\nname = "z"\ndiameter_mm = 20\nheight_mm = 50\ncenter_mm = [-100, 0]\n'
    )
    module = make_module(path, 0.05)
    base, cube, cylinder = 300 * 200 * 10, 100**3, math.pi * 10**2 * 50
    hidden = math.pi * 30**2 * 30 - 2 / 3 * math.pi * 30**3  # below the equator, beside the lower half
    sphere = 4 / 3 * math.pi * 30**3 + hidden
    assert module.volume_m3 == pytest.approx((base + cube + sphere + cylinder) * 1e-9)
    assert 0 < module.sigma_m3 < 0.01 * module.volume_m3


def write_pass(folder: Path, plant: SimulatedPlant, number: int) -> Path:
    """A pass of the heap under the camera, with noise of its own."""
    belt = make_empty_belt(COARSE_CAMERA)
    picture, steps, records = BeltPicture(belt), list[FramePlacement](), list[FlowRecord]()
    meter = BeltFlowMeter(
        belt, density=make_unknown_density(), watch_belt=picture.add, watch_step=steps.append
    )
    for k in range(12):
        depth = depth_map(HEAP, 130.0 * k + 7 * number, camera=COARSE_CAMERA, seed=100 * number + k)
        records += meter.push(depth, round(k * 1e8), 130.0 * k + 7 * number, frame=f"{k:03d}")
    records += meter.finish()
    flow = Flow(records, steps, meter, picture, 0.1, True, None)
    folder.mkdir()
    measured_by = describe_measured_by(plant.folder / "rig.json", plant.folder / "belt.json")
    write_flow_result(folder, flow, make_unknown_density(), (), measured_by)
    return folder


def test_passes_of_an_object_give_the_error_of_the_volume(tmp_path, capsys) -> None:
    plant = SimulatedPlant(tmp_path / "plant")
    flows = [write_pass(tmp_path / f"pass_{number}", plant, number) for number in range(3)]
    true_mm3 = HEAP.volume_mm3
    edge = true_mm3 ** (1 / 3)
    words = ["certify", "object", *map(str, flows), "--box", *[f"{edge:.6f}"] * 3, "--sigma", "0.05"]
    words += ["--project", str(plant.path), "--out", str(tmp_path / "out"), "--issue", "--json"]
    assert main(words) == 0, capsys.readouterr().err
    document = json.loads(capsys.readouterr().out)
    (error,) = document["errors"]
    assert error["key"] == "volume_error"
    assert abs(error["value"]) < max(error["expanded"], 1.0)  # the meter's own systematic error is below 1 %
    assert error["sigma"] < 1.0
    assert document["applies"].keys() == {"rig", "empty", "networks", "program"}
    assert document["undetermined"] == ["mass_factor", "bulk_density"]
    assert set(document["notes"]) == {"one_load", "no_zero"}
    page = (tmp_path / "out/report.html").read_text()
    assert "belt.tiff, SHA-256" in page
    assert main([*words[:4], *words[5:]]) == 2
    assert "give the results of 3 or more" in capsys.readouterr().err
