"""A belt in trouble: its fused surface is no worse than single frames, σ of its total holds, and a check says so."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.core.ledger import FlowRecord
from beltscape.health.belt.monitor import BeltMonitor
from beltscape.measure.flow.blocks import BeltPiece
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from tests.measure.flow.moving_belt import COARSE_CAMERA, Heap, depth_map, make_empty_belt
from tests.thorough import list_cases

HEAP = Heap(start_mm=-1150, end_mm=-450)
STEP_MM = 80.0
COUNT = 20
PLACES = STEP_MM * np.arange(COUNT)
MIDDLE = slice(9, 15)
Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Trouble:
    """Where belt, load and encoder are, frame by frame."""

    load_mm: Array
    encoder_mm: Array | None
    missing: tuple[int, ...] = ()
    lift_mm: Array | None = None
    """Height by which the whole belt is moved."""


def slip(places: Array, factor: float) -> Array:
    steps = np.diff(places, prepend=0.0)
    steps[MIDDLE] *= factor
    return np.cumsum(steps)


_REST = np.array([*PLACES[:10], *[PLACES[9]] * 5, *PLACES[10:]])
_BACK = np.array([*PLACES[:11], PLACES[10] - 40, PLACES[10] - 80, PLACES[10] - 60, *PLACES[10:]])
_SHAKEN = 0.3 * np.random.default_rng(5).normal(size=COUNT)
TROUBLES: dict[str, Trouble] = {
    "none": Trouble(PLACES, PLACES),
    "no encoder": Trouble(PLACES, None),
    "encoder of a wrong scale": Trouble(PLACES, 0.95 * PLACES),
    "encoder that slips": Trouble(PLACES, slip(PLACES, 0.8)),
    "encoder that stands still": Trouble(PLACES, np.minimum(PLACES, PLACES[9])),
    "belt at rest": Trouble(_REST, _REST),
    "belt at rest, no encoder": Trouble(_REST, None),
    "belt that runs back": Trouble(_BACK, _BACK),
    "belt that runs back, no encoder": Trouble(_BACK, None),
    "vibration along the belt": Trouble(PLACES + _SHAKEN, PLACES),
    "vibration across the view": Trouble(PLACES, PLACES, lift_mm=_SHAKEN),
    "frames lost": Trouble(PLACES, PLACES, missing=(7, 8, 11, 13, 14)),
    "frames lost, no encoder": Trouble(PLACES, None, missing=(7, 9, 11)),
    "load that slides": Trouble(slip(PLACES, 0.7), PLACES),
    "load that slides all the time": Trouble(0.9 * PLACES, PLACES),
}
ACCUSED = {
    "encoder of a wrong scale",
    "encoder that slips",
    "encoder that stands still",
    "load that slides",
    "load that slides all the time",
}
"""Where encoder and material contradict each other."""
_QUICK = ["encoder that slips", "vibration across the view", "load that slides"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a run through some trouble gave."""

    meter: BeltFlowMeter
    records: list[FlowRecord]
    findings: list[Finding]
    fused_mm: Array
    """Errors of the fused belt's measured cells."""
    single_mm: Array
    """Errors of the same cells in the frames by themselves, each at its true place."""


def take_depth(trouble: Trouble, frame: int) -> DepthMap | None:
    if frame in trouble.missing:
        return None
    depth = depth_map(HEAP, float(trouble.load_mm[frame]), seed=frame, camera=COARSE_CAMERA)
    lift = 0.0 if trouble.lift_mm is None else trouble.lift_mm[frame]
    return replace(depth, depth_mm=(depth.depth_mm - lift).astype(np.float32))


def compute_true_mm(s_mm: Array) -> Array:
    """Height of the heap (n, Nx) on rows of the belt at the load's own coordinate."""
    return HEAP.height_mm(make_empty_belt(COARSE_CAMERA).grid.x_mm, np.asarray(-s_mm[:, None], np.float64))


def measure(trouble: Trouble) -> Outcome:
    reference = make_empty_belt(COARSE_CAMERA)
    pieces: list[BeltPiece] = []
    steps: list[FramePlacement] = []
    findings: list[Finding] = []
    meter = BeltFlowMeter(reference, watch_belt=pieces.append, watch_step=steps.append)
    checks = BeltMonitor(reference)
    records: list[FlowRecord] = []
    single: list[Array] = []
    for k, place in enumerate(trouble.load_mm):
        depth = take_depth(trouble, k)
        found: list[Finding] = [] if depth is None else list(checks.check(depth))
        reading = None if trouble.encoder_mm is None else float(trouble.encoder_mm[k])
        records += meter.push(depth, round(k * 1e8), reading, frame=str(k), findings=found)
        findings += [*found, *meter.findings]
        if depth is not None:
            layer = reference.place(reference.measure_load(depth), float(place), 1)
            single.append(layer.height_mm - compute_true_mm(_list_rows_mm(layer.first, layer.height_mm)))
    records += meter.finish()
    places = {step.frame: step.place.position_mm for step in steps}
    fused = [
        (piece.height_mm - compute_true_mm(_convert(trouble, places, piece)))[piece.measured]
        for piece in pieces
    ]
    alone = np.concatenate([part.ravel() for part in single])
    return Outcome(meter, records, findings, np.concatenate(fused), alone[np.isfinite(alone)])


def _list_rows_mm(first: int, rows: NDArray[np.floating]) -> Array:
    return (first + np.arange(len(rows))) * make_empty_belt(COARSE_CAMERA).cell_mm


def _convert(trouble: Trouble, places: dict[str, float], piece: BeltPiece) -> Array:
    """Return the load's own coordinates of a piece's rows.

    Counted metres begin anywhere, and equal steps have an error in common: the line through frames with load.
    """
    frames = [frame for frame in range(4, 16) if str(frame) in places]
    counted = [places[str(frame)] for frame in frames]
    rate, offset = np.polyfit(counted, trouble.load_mm[frames], 1)
    assert rate == pytest.approx(1, abs=0.004)
    return offset + rate * _list_rows_mm(piece.first, piece.height_mm)


def share_off(errors_mm: Array, limit_mm: float) -> float:
    return float((np.abs(errors_mm) > limit_mm).mean())


@pytest.mark.parametrize("name", list_cases(TROUBLES, _QUICK))
def test_trouble_is_named_and_spoils_neither_surface_nor_total(name: str) -> None:
    trouble, outcome = TROUBLES[name], measure(TROUBLES[name])
    assert np.std(outcome.fused_mm) < 1.05 * np.std(outcome.single_mm)
    assert share_off(outcome.fused_mm, 1.0) <= 1.5 * share_off(outcome.single_mm, 1.0) + 0.001
    assert share_off(outcome.fused_mm, 5.0) <= share_off(outcome.single_mm, 5.0)
    totals = outcome.meter.totals
    assert abs(totals.volume_mm3 - HEAP.volume_mm3) < min(2 * totals.sigma_mm3, 0.02 * HEAP.volume_mm3)
    named = {one.check for one in outcome.findings if one.is_fault}
    assert ("encoder_motion" in named) == (name in ACCUSED)
    assert ("zero_shift" in named) == (trouble.lift_mm is not None)
    qualities = [record.quality for record in outcome.records]
    if named:
        assert qualities.count("degraded") >= 5
    elif trouble.encoder_mm is not None:
        assert set(qualities) == {"measured"}
    else:  # without an encoder no material shows how far the bare belt in front of it moved
        assert qualities[1] == "degraded"
        assert qualities.count("measured") >= COUNT // 2
