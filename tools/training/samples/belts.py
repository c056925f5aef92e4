"""Samples of the cells that no frame of a moving heap measured, of a heap whose true height is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from beltscape.core.height_map import HeightMap
from beltscape.core.progress import Silent
from beltscape.evaluate.belt_scores import TrueBelt, compute_true_cells, read_true_belt
from beltscape.files.fused_belt import FusedBelt
from beltscape.files.rig_json import read_rig
from beltscape.kernels.holes import HOLE_FEATURES
from beltscape.measure.flow.blocks import BeltBlock, FilledBlock, Rows, gather_holes
from beltscape.pipeline.measuring.flow import Flow, measure_flow_of_capture
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from beltscape.workers.calls import CallsHere, PendingCall
from training.belts import EMPTY, MOVING
from training.reconstructions import reconstruct_frame
from training.samples.holes import BORDER_MM, Samples, draw_cells, list_samples, sample_frame

Value = TypeVar("Value")
_ABOVE_MM = 20.0
"""Depth is searched this far above the heap: no frame need show it first, as those of a dark bare belt do not."""
_SEEN = 0.9
"""Share of the view's length, on the belt, that counts of a single frame."""
_EMPTY_RESULT = "empty_rec"
"""Folder of a heap's empty belt, reconstructed."""


@dataclass
class _BlockRecorder:
    """Keeps the blocks of a belt, and leaves their holes unfilled."""

    blocks: list[BeltBlock] = field(default_factory=list)

    def begin(self, function: Callable[..., Value], *given: Any) -> PendingCall[Value]:  # noqa: ARG002
        """Keep the block that the meter would have filled by the function; see `CallMaker`."""
        block: BeltBlock = given[0]
        self.blocks.append(block)
        return cast("PendingCall[Value]", CallsHere().begin(_make_empty_rows, block))


def _make_empty_rows(block: BeltBlock) -> FilledBlock:
    """Return the rows of a block as those of an empty belt."""
    none = np.zeros(block.own[1] - block.own[0])
    return FilledBlock(Rows(block.number, *[none] * (len(fields(Rows)) - 1)), None)


def draw_belt_samples(folder: Path, preset: str) -> Samples:
    """Return the samples of a heap's captures, matched by a preset with the true rig."""
    capture, rig = folder / MOVING, read_rig(folder / MOVING / "truth" / "rig.json")
    empty = folder / _EMPTY_RESULT
    if not (empty / "reconstruction.json").is_file():
        reconstruct_capture(folder / EMPTY, rig, empty, Silent())
    recorder, truth = _BlockRecorder(), read_true_belt(capture / "truth")
    flow = measure_flow_of_capture(
        capture,
        rig,
        empty,
        Silent(),
        encoder=capture / "encoder.csv",
        preset=preset,
        load_mm=float(truth.height_mm.max()) + _ABOVE_MM,
        calls=recorder,
    )
    return draw_cells(_join_samples([_collect_block(block, flow, truth) for block in recorder.blocks]))


def draw_frame_samples(folder: Path, preset: str) -> Samples:
    """Return the samples of the frame in which a heap is nearest to the middle, by itself."""
    capture = folder / MOVING
    truth = read_true_belt(capture / "truth")
    name = min(truth.heap_mm, key=lambda frame: abs(truth.heap_mm[frame]))
    depth = reconstruct_frame(capture, name, preset)
    camera = read_rig(capture / "truth" / "rig.json").core_camera
    half = _SEEN * truth.core_from_world.center_mm[2] * camera.size_px[1] / camera.focal_px[1] / 2
    load = {"x_mm": truth.x_mm, "y_mm": truth.y_mm + truth.heap_mm[name], "height_mm": truth.height_mm}
    return sample_frame(capture, depth, load, (-half, half))


def _collect_block(block: BeltBlock, flow: Flow, truth: TrueBelt) -> Samples:
    """Return the samples of a block's own rows."""
    holes, true_mm = gather_holes(block), _compute_truth(block, flow, truth)
    return list_samples(holes.height_mm, holes.pinhole, holes.ray_slope, true_mm, block.grid.value.cell_mm)


def _compute_truth(block: BeltBlock, flow: Flow, truth: TrueBelt) -> np.ndarray:
    """Return the (n, Nx) true height of a block's own cells; NaN near the belt's sides and outside the truth."""
    reference, cell = flow.meter.reference, block.grid.value.cell_mm
    shape = block.planes.shape[1:]
    first = block.number - block.own[0]
    origin = (reference.grid.origin_mm[0], first * cell)
    blank = np.full(shape, np.nan)
    fused = FusedBelt(
        HeightMap(blank, blank, origin, cell),
        np.zeros(shape),
        reference.belt.belt_from_core,
        flow.meter.direction or 1,
        {step.frame: step.place.position_mm for step in flow.steps},
        (-np.inf, np.inf),
    )
    true_mm, _ = compute_true_cells(fused, truth)
    x = fused.heights.x_mm
    left, right = reference.belt.across_mm
    true_mm[:, (x < left + BORDER_MM) | (x > right - BORDER_MM)] = np.nan
    true_mm[: block.own[0]] = true_mm[block.own[1] :] = np.nan
    return true_mm


def _join_samples(parts: list[Samples]) -> Samples:
    """Return the samples of all parts; of no part there are none."""
    if not parts:
        return Samples(HOLE_FEATURES, np.empty((0, len(HOLE_FEATURES)), np.float32), np.empty(0), np.empty(0))
    x, y, scale = (np.concatenate([getattr(one, name) for one in parts]) for name in ("x", "y", "scale_mm"))
    return Samples(HOLE_FEATURES, x, y, scale)
