"""The fused belt against the truth of moving heaps: single frames, fused frames, and fused frames continued.

    python benchmarks/fused_belt.py CACHE [--heaps NAME …] [--preset fast|standard] [--rendered FOLDER]

Each heap is rendered once into CACHE (minutes each) and reconstructed with the true rig. The rows of the table are
those of the manual's page on the fused belt. The weights of the continuation were fitted to D1, D2 and T1.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np

import rendered_belt
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.evaluate.belt_ceiling import MovingCeiling, read_moving_scene
from beltscape.evaluate.belt_scores import BeltScore, TrueBelt, read_true_belt, score_belt
from beltscape.files.fused_belt import FusedBelt
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from beltscape.measure.flow.rows import PICTURE_CELL_MM, BeltPicture
from beltscape.measure.flow.settings import FlowSettings
from beltscape.pipeline.measuring import flow
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from beltscape.simulate.scenario import Scenario
from matching.scenes import render_once
from tables import format_cells, format_head

_HEAD = (
    "heap", "cameras", "frames", "measured", "< 1 mm", "< 2 mm", "> 5 mm", "bias mm", "visible", "of these measured",
    "volume", "σ",
)  # fmt: skip
_EMPTY_SEED = 500
"""Added to a heap's seed for the noise of the empty belt."""


@dataclass(frozen=True)
class MovingHeap:
    """A heap on the moving belt, and the rig above it."""

    seed: int
    auxiliaries: int
    sizes_mm: tuple[float, float, float]
    """Smallest, largest and median rock."""
    crown_mm: float
    height_mm: float = 744.0
    first_deg: float = 0.0
    around_deg: float = 360.0
    speed_mm_s: float = 1000.0
    frames_per_s: float = 5.0
    pattern: str = "paper"
    scale: float = 0.25
    """Of the images to the sensor of 2448 × 2048 pixels."""
    rocks: int = 800
    bedding: float = 0.15
    """Depth to which a rock sinks into the fines, as a share of its height."""
    candidates: int = 6
    """Places tried for each rock, which takes the lowest: with one place rocks lie loosely, over deep hollows."""
    rolling: float = 0.0
    """1: rocks roll to the flanks; see `HeapSettings`."""
    corners: tuple[int, int] = (13, 25)
    """Least and greatest number of a rock's corners: few make large faces and sharp edges."""
    roughness: float = 0.05

    def make_scenario(self, kind: str) -> Scenario:
        """Return the scene, of the moving heap or of the empty belt."""
        smallest, largest, median = self.sizes_mm
        return Scenario.model_validate({
            "kind": kind,
            "seed": self.seed + (_EMPTY_SEED if kind == "belt_empty" else 0),
            "frames": 1 if kind == "belt_empty" else None,
            "rig": {
                "seed": self.seed, "auxiliaries": self.auxiliaries, "height_mm": self.height_mm, "scale": self.scale,
                "first_deg": self.first_deg, "around_deg": self.around_deg,
            },
            "projector": {
                "pattern": self.pattern, "position_mm": (50, -50, self.height_mm + 13), "seed": self.seed,
            },
            "heap": {
                "rocks": self.rocks, "bedding": self.bedding, "candidates": self.candidates,
                "rolling": self.rolling,
                "shapes": {"corners": self.corners, "roughness": self.roughness},
                "fines": {"crown_mm": self.crown_mm, "along_mm": (-330, 330)},
                "sizes": {"smallest_mm": smallest, "largest_mm": largest, "median_mm": median},
            },
            "motion": {"speed_mm_s": self.speed_mm_s, "frames_per_s": self.frames_per_s},
        })  # fmt: skip


HEAPS = {
    "D1": MovingHeap(11, 3, (10, 79, 50), 80),
    "D2": MovingHeap(12, 4, (8, 60, 35), 70, first_deg=45, frames_per_s=6),
    "T1": MovingHeap(21, 2, (10, 79, 50), 80, around_deg=180),
    "T2": MovingHeap(22, 2, (15, 100, 60), 60, height_mm=800, first_deg=30, speed_mm_s=-1200),
    "T3": MovingHeap(23, 4, (10, 79, 45), 90, 700, speed_mm_s=1500, frames_per_s=8, pattern="fine"),
    "T4": MovingHeap(24, 3, (6, 50, 25), 75, first_deg=90, speed_mm_s=800, frames_per_s=4),
    "S1": MovingHeap(12, 4, (10, 80, 18), 60, first_deg=45, frames_per_s=6, rocks=2500),
    "S2": MovingHeap(31, 4, (10, 80, 18), 80, first_deg=45, rocks=1000),
    "L1": MovingHeap(
        12, 4, (10, 80, 18), 60, first_deg=45, frames_per_s=6, rocks=2500, bedding=0.0, candidates=1
    ),
    "A1": MovingHeap(41, 4, (10, 79, 50), 80, candidates=2, rolling=1.0, corners=(7, 12), roughness=0.0),
    "A2": MovingHeap(
        42,
        3,
        (10, 60, 30),
        90,
        first_deg=45,
        rocks=1300,
        bedding=0.0,
        candidates=1,
        rolling=0.5,
        corners=(8, 14),
        roughness=0.0,
    ),
}


@dataclass(frozen=True)
class Pushed:
    """What the meter got of one frame."""

    depth: DepthMap | None
    time_ns: int | None
    position_mm: float | None
    name: str


def match(measure_flow: Callable[[], object]) -> tuple[EmptyBeltReference, list[Pushed]]:
    """Return the empty belt and the frames' depths of a flow while it is measured."""
    meters, pushed = list[BeltFlowMeter](), list[Pushed]()
    push = BeltFlowMeter.push

    def record(meter: BeltFlowMeter, depth: DepthMap | None, time_ns: int | None, position_mm=None, **words):
        meters.append(meter)
        pushed.append(Pushed(depth, time_ns, position_mm, words["frame"]))
        return push(meter, depth, time_ns, position_mm, **words)

    with patch.object(BeltFlowMeter, "push", record):
        measure_flow()
    return meters[0].reference, pushed


def measure(
    reference: EmptyBeltReference,
    frames: Sequence[Pushed],
    settings: FlowSettings,
    cell_mm: float = PICTURE_CELL_MM,
) -> tuple[BeltFlowMeter, FusedBelt]:
    """Return the meter after the frames, and the fused belt of their whole windows."""
    picture, steps = BeltPicture(reference, cell_mm), list[FramePlacement]()
    meter = BeltFlowMeter(reference, settings, watch_belt=picture.add, watch_step=steps.append)
    for one in frames:
        meter.push(one.depth, one.time_ns, one.position_mm, frame=one.name)
    meter.finish()
    heights, share = picture.height_map()
    direction = 1 if settings.direction == "+y" else -1
    positions = {step.frame: step.place.position_mm for step in steps}
    ends = [place - direction * y for place in positions.values() for y in reference.window_mm]
    pose = reference.belt.belt_from_core
    return meter, FusedBelt(heights, share, pose, direction, positions, (min(ends), max(ends)))


def score_single_frames(
    reference: EmptyBeltReference, frames: Sequence[Pushed], settings: FlowSettings, truth: TrueBelt
) -> dict[str, float]:
    """Return the scores of the frames by themselves, as means over their loaded cells."""
    scores = list[BeltScore]()
    for one in frames:
        try:
            scores.append(score_belt(measure(reference, [one], settings)[1], truth))
        except InputError:  # no load in its window
            continue
    cells = np.array([score.cells for score in scores])
    documents = [score.document() for score in scores]
    return {
        name: float(np.average([each[name] for each in documents], weights=cells)) for name in documents[0]
    }


def render(folder: Path, make_scenario: Callable[[str], Scenario]) -> None:
    """Render the scenarios of a moving belt and of its empty belt where they are not there yet."""
    for name, kind in (("empty", "belt_empty"), ("moving", "belt_moving")):
        render_once(make_scenario(kind), folder / name)


def measure_flow(folder: Path, preset: str) -> flow.Flow:
    """Return the flow of a rendered moving belt, with its encoder, over the empty belt beside it."""
    capture, rig = folder / "moving", read_rig(folder / "moving" / "truth" / "rig.json")
    if not (folder / "empty_rec" / "reconstruction.json").is_file():
        reconstruct_capture(folder / "empty", rig, folder / "empty_rec", Silent())
    return flow.measure_flow_of_capture(
        capture, rig, folder / "empty_rec", Silent(), encoder=capture / "encoder.csv", preset=preset
    )


@dataclass(frozen=True)
class MatchedBelt:
    """The depths of a moving belt's frames, and the truth about its load."""

    name: str
    cameras: int
    reference: EmptyBeltReference
    frames: Sequence[Pushed]
    settings: FlowSettings
    truth: TrueBelt
    volume_mm3: float
    ceiling: MovingCeiling | None = None


def match_heap(name: str, folder: Path, preset: str) -> MatchedBelt:
    """Return one of the heaps, rendered into ``folder`` where it is not there yet."""
    heap = HEAPS[name]
    render(folder, heap.make_scenario)
    reference, frames = match(lambda: measure_flow(folder, preset))
    true = folder / "moving" / "truth"
    scene, volume = read_moving_scene(true), read_json(true / "belt_moving.json")["heap_volume_mm3"]
    settings = FlowSettings(direction="+y" if heap.speed_mm_s > 0 else "-y")
    ceiling = None if scene is None else MovingCeiling(scene)
    return MatchedBelt(
        name, heap.auxiliaries + 1, reference, frames, settings, read_true_belt(true), volume, ceiling
    )


def match_rendered(rendered: Path, folder: Path, preset: str) -> MatchedBelt:
    """Return the moving belt of another renderer."""
    reference, frames = match(lambda: rendered_belt.measure_flow(rendered, folder, preset))
    cameras, truth = len(rendered_belt.read_rig(rendered).cameras), rendered_belt.read_seen_heights(rendered)
    volume_mm3 = rendered_belt.read_volume_mm3(rendered)
    settings = FlowSettings(direction="+y")
    return MatchedBelt("another renderer's", cameras, reference, frames, settings, truth, volume_mm3)


def make_rows(belt: MatchedBelt) -> list[str]:
    """Return the table's rows of one belt."""
    head = [belt.name, str(belt.cameras)]
    off = patch("beltscape.measure.flow.blocks.continue_into_holes", lambda filled, *_: filled)
    with off:
        single = score_single_frames(belt.reference, belt.frames, belt.settings, belt.truth)
    rows = [format_cells([*head, "single", *_format(single), "", ""])]
    variants: dict[str, Callable[[], AbstractContextManager[object]]] = {
        "fused": lambda: off,
        "continued": nullcontext,
    }
    for variant, patched in variants.items():
        with patched():
            meter, fused = measure(belt.reference, belt.frames, belt.settings)
        score, totals = score_belt(fused, belt.truth, belt.ceiling).document(), meter.totals
        ends = [
            f"{totals.volume_mm3 / belt.volume_mm3 - 1:+.2%}",
            f"{totals.sigma_mm3 / belt.volume_mm3:.2%}",
        ]
        rows.append(format_cells([*head, variant, *_format(score), *ends]))
    return rows


def _format(score: dict[str, float]) -> list[str]:
    shares = [f"{score[key]:.1%}" for key in ("measured", "within_1mm", "within_2mm", "gross")]
    visible = [f"{score[key]:.1%}" for key in ("visible", "visible_measured")]
    return [*shares, f"{score['bias_mm']:+.2f}", *visible]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cache", type=Path)
    parser.add_argument("--heaps", nargs="*", default=list(HEAPS), choices=list(HEAPS))
    parser.add_argument("--preset", default="fast", choices=["fast", "standard"])
    parser.add_argument("--rendered", type=Path, help="folder of another renderer's captures")
    arguments = parser.parse_args()
    print("\n".join(format_head(_HEAD)))
    for name in arguments.heaps:
        belt = match_heap(name, arguments.cache / name, arguments.preset)
        print("\n".join(make_rows(belt)), flush=True)
    if arguments.rendered:
        belt = match_rendered(arguments.rendered, arguments.cache, arguments.preset)
        print("\n".join(make_rows(belt)), flush=True)


if __name__ == "__main__":
    main()
