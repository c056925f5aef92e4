"""Setting the zero of a running system: measured on the empty belt, confirmed, kept over a restart."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.errors import MeasureError
from beltscape.core.events import ZeroProposal
from beltscape.core.findings import Finding
from beltscape.core.geometry.pose import Pose
from beltscape.core.progress import Silent
from beltscape.core.translatable_message import get_key
from beltscape.files.belt_json import read_zero_settings
from beltscape.health.belt.cells import compute_belt_cells
from beltscape.health.belt.zero_shift import estimate_zero_shift
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import EmptyBeltReference, make_reference
from beltscape.pipeline.live.zero import FILE, ZeroControl, read_zero
from tests.measure.flow.moving_belt import CAMERA, depth_map, make_empty_belt
from tests.pipeline.live.feed import Feed, check, engine_of, everything, track

REFERENCE = make_empty_belt()
SHIFT = Finding("zero_shift", 1.2, 0.05, 0.3, "mm", text="it has risen", effect="degraded")
DIRT = Finding("dirt", 5.0, 0.1, 0.5, "%", "cam1", text="dirt", effect="degraded")


def moved(rise_mm: float) -> EmptyBeltReference:
    """The reference as learned before the belt rose."""
    motion = Pose(np.eye(3), np.array([0.0, 0.0, rise_mm]))
    return make_reference(
        replace(REFERENCE.belt, belt_from_core=motion @ REFERENCE.belt.belt_from_core), CAMERA
    )


def measure(control: ZeroControl, findings: Sequence[Finding] = (SHIFT,)) -> ZeroProposal:
    """Measure on frames of the empty belt that another thread adds."""
    ended = threading.Event()

    def add() -> None:
        seed = 0
        while not ended.wait(0.01):
            control.add(depth_map(None, 0.0, seed=seed), findings)
            seed += 1

    feeding = threading.Thread(target=add)
    feeding.start()
    try:
        return control.measure()
    finally:
        ended.set()
        feeding.join()


def read_offset(reference: EmptyBeltReference) -> float:
    cells = compute_belt_cells(depth_map(None, 0.0, seed=77), reference)
    return estimate_zero_shift(cells, reference.belt, reference.cell_mm, 40.0).offset_mm


def test_a_confirmed_zero_is_used_and_survives_a_restart(tmp_path: Path) -> None:
    path, learned, reporter = tmp_path / FILE, moved(1.2), Silent()
    control = ZeroControl(learned, BeltLimits(), path, "abc")
    proposal = measure(control)
    assert proposal.offset_mm == pytest.approx(1.2, abs=4 * proposal.sigma_mm)
    assert control.pop_reference() is None and not path.exists()
    assert control.set(proposal.number + 1, "eva") is None
    assert control.set(proposal.number, "eva") is not None
    assert control.set(proposal.number, "eva") is None
    present = control.pop_reference()
    assert present is not None and abs(read_offset(present)) < 0.05
    assert control.pop_reference() is None
    (entry,) = read_zero_settings(path)
    assert (entry["by"], entry["offset_mm"]) == ("eva", pytest.approx(proposal.offset_mm))
    assert abs(read_offset(read_zero(path, learned, "abc", reporter))) < 0.05
    assert reporter.warnings == []
    assert read_zero(path, learned, "other", reporter) is learned
    document = json.loads(path.read_text())
    path.write_text(json.dumps({**document, "along_mm": [-1.0, 1.0]}))
    assert read_zero(path, learned, "abc", reporter) is learned
    path.write_bytes(b"\x00\xff")
    assert read_zero(path, learned, "abc", reporter) is learned
    assert len(reporter.warnings) == 3
    assert all(str(path) in line and line.endswith("set the zero again") for line in reporter.warnings)


def test_the_limit_bounds_the_sum_of_settings_and_old_measurements_expire(tmp_path: Path) -> None:
    now_s = [0.0]
    limits = BeltLimits(set_limit_mm=1.0)
    control = ZeroControl(moved(0.7), limits, tmp_path / FILE, monotonic_s=lambda: now_s[0])
    first = measure(control)
    assert control.set(first.number, "eva") is not None
    assert measure(control).offset_mm == pytest.approx(first.offset_mm, abs=0.1)  # against the learned belt
    now_s[0] += 301
    assert control.set(first.number + 1, "eva") is None
    with pytest.raises(MeasureError) as caught:
        measure(ZeroControl(moved(1.4), limits))
    assert get_key(caught.value.args[0]) == "zero_set_rise"


def test_frames_with_faults_are_not_used() -> None:
    control = ZeroControl(moved(0.5), BeltLimits(), patience_s=0.3)
    with pytest.raises(MeasureError, match="only 0 of 5 frames") as caught:
        measure(control, (SHIFT, DIRT))
    assert get_key(caught.value.args[0]) == "zero_set_no_frames"


def test_the_engine_sets_it_with_an_event(tmp_path: Path) -> None:
    engine, watcher, historian, _ = engine_of(tmp_path, Feed(track(6000, 7200), pause_s=0.05))
    engine.start()
    proposal = engine.measure_zero()
    assert abs(proposal.offset_mm) < 0.1
    assert not engine.set_zero(proposal.number + 1, "eva") and engine.set_zero(proposal.number, "eva")
    assert engine.wait(300)
    engine.stop()
    check(everything(historian))
    (event,) = [one for one in historian.events(0, time.time_ns() + 10**9) if one.kind == "zero"]
    assert (event.name, event.by) == ("set", "eva")
    assert json.loads(event.parameters)["value"] == pytest.approx(proposal.offset_mm, abs=0.001)
    assert (tmp_path / FILE).is_file() and watcher.frames
    historian.close()
