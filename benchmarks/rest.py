"""What a belt at rest or creeping costs: CPU time with all frame sets matched, and with those that show new belt.

    python benchmarks/rest.py [RENDERED] [--seconds S] [--speeds V ...] [--scale F]

The rendered moving belt stops in the middle of its heap: its frame set is shown 8 times a second, with noise of its
own. With --speeds a belt is simulated at each speed, mm/s (minutes), with the heap in view. Both are measured twice
in this process, as the running system does without workers. The table has the frame sets that were matched, the CPU
time for a second of belt, and the volumes with their σ.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

from beltscape.core.frames import FrameSet, Image
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementRun
from beltscape.pipeline.live.measuring_parts import build_context
from beltscape.pipeline.live.project import RunSettings, read_project
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from beltscape.pipeline.simulation import simulate
from beltscape.simulate.scenario import Scenario
from captures import read_true_rig
from live import make_plant
from results import ROOT

FRAMES_PER_S = 8.0
LEARNED = 4
"""Frame sets of a simulated belt in which the images are learned and the belt is found; they are not counted."""
RUNNING = 12
"""Frame sets of the rendered belt before it stops: half of them, the heap is in view."""
NOISE = 1.5
"""σ of the noise of an image that is shown again, grey values of 255: as in the bench of faults."""


@dataclass(frozen=True)
class Belt:
    """Frame sets to be measured."""

    name: str
    rig: Path
    empty: Path
    sets: Sequence[FrameSet]
    first: int
    """The first frame set that is counted."""


def read_sets(capture: Path) -> list[FrameSet]:
    """Return the frame sets of a moving capture with their times and positions."""
    rows = [line.split(",") for line in (capture / "encoder.csv").read_text().splitlines()[1:]]
    known = {Path(frame).stem: (round(float(at) * 1e9), float(position)) for frame, at, position in rows}
    files = read_capture(capture).files
    return [
        FrameSet(frame, {camera: read_image(own[frame]) for camera, own in files.items()}, *place)
        for frame, place in known.items()
    ]


def add_noise(image: Image, camera: str, number: int) -> Image:
    """Return an image with noise of its own."""
    rng = np.random.default_rng([crc32(camera.encode()), number])
    return np.clip(np.rint(image + rng.normal(0, NOISE, image.shape)), 0, 255).astype(np.uint8)


def stop_belt(rendered: Path, folder: Path, seconds: float) -> Belt:
    """Return the rendered belt of another renderer, which stops."""
    rig = read_true_rig(rendered)
    images, empty = make_plant(rendered, rig, folder, 612)
    moving = read_sets(images)[:RUNNING]
    last = moving[-1]
    resting = [
        FrameSet(
            f"rest{k:03d}",
            {camera: add_noise(image, camera, k) for camera, image in last.images.items()},
            (last.time_ns or 0) + round((k + 1) / FRAMES_PER_S * 1e9),
            last.position_mm,
        )
        for k in range(round(seconds * FRAMES_PER_S))
    ]
    return Belt("at rest", empty / "rig.json", empty, [*moving, *resting], RUNNING)


def simulate_belts(folder: Path, speeds_mm_s: Sequence[float], seconds: float, scale: float) -> list[Belt]:
    """Return a loaded belt at each speed, in which the heap is in view."""
    plant = {"rig": {"seed": 31, "scale": scale}, "render": {"passes": 1, "ambient_samples": 1}}
    simulate(
        Scenario.model_validate({**plant, "kind": "belt_empty", "seed": 33}), folder / "images", Silent()
    )
    rig, belts = folder / "images" / "truth" / "rig.json", list[Belt]()
    reconstruct_capture(folder / "images", read_rig(rig), folder / "empty", Silent(), preset="fast")
    for speed in speeds_mm_s:
        motion = {"speed_mm_s": speed, "frames_per_s": FRAMES_PER_S, "start_mm": 0.0}
        count = LEARNED + round(seconds * FRAMES_PER_S)
        scene = {**plant, "kind": "belt_moving", "seed": 32, "frames": count, "motion": motion}
        simulate(Scenario.model_validate(scene), folder / f"{speed:g}", Silent())
        sets = read_sets(folder / f"{speed:g}")
        belts.append(Belt(f"{speed:g} mm/s", rig, folder / "empty", sets, LEARNED))
    return belts


def measure(folder: Path, belt: Belt, *, matches_all: bool) -> tuple[float, int, str]:
    """Return the CPU time, s, of the counted frame sets, how many of them were matched, and the volume."""
    path = folder / "project.toml"
    path.write_text(
        f'rig = "{belt.rig}"\nempty = "{belt.empty}"\n[capture]\nfolder = "{folder}"\n'
        '[matching]\npreset = "fast"\nworkers = 0\n[flow]\ndirection = "+y"\n'
        f"[health]\nlearning_frames = {LEARNED - 1}\n",
        encoding="utf-8",
    )
    context = build_context(read_project(path, RunSettings), read_rig(belt.rig), Silent())
    state, cameras = LedgerState(1, 0, None), tuple(context.rig.cameras)
    run = MeasurementRun(context, state, cameras, time.time_ns, Silent(), matches_all=matches_all)
    entries, count, began = [], 0, 0.0
    for number, frames in enumerate(belt.sets):
        if number == belt.first:
            began = time.process_time()
        outcome = run.push(frames)
        entries += [*outcome.entries, *run.flush().entries]
        count += number >= belt.first and not outcome.is_repeat
    cpu_s = time.process_time() - began
    entries += run.finish().entries
    volume = sum(entry.volume_mm3 for entry in entries) * 1e-6
    return cpu_s, count, f"{volume:.4f} ± {entries[-1].run_sigma_mm3 * 1e-6:.4f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rendered", nargs="?", type=Path, default=ROOT / "shared" / "data" / "rendered")
    parser.add_argument("--seconds", type=float, default=5.0, help="that each belt is measured")
    parser.add_argument("--speeds", type=float, nargs="+", default=[], help="of simulated belts, mm/s")
    parser.add_argument("--scale", type=float, default=0.25, help="of their images to 2448 × 2048 px")
    arguments = parser.parse_args()
    print("| belt | frame sets matched | CPU s a second | volume, l |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder, seconds = Path(name), arguments.seconds
        belts = [stop_belt(arguments.rendered, folder, seconds)] if arguments.rendered.is_dir() else []
        if arguments.speeds:
            belts += simulate_belts(folder, arguments.speeds, seconds, arguments.scale)
        for belt in belts:
            results = [measure(folder, belt, matches_all=matches_all) for matches_all in (True, False)]
            counts = " → ".join(f"{count}" for _, count, _ in results)
            cpu = " → ".join(f"{cpu_s / seconds:.2f}" for cpu_s, _, _ in results)
            volumes = " → ".join(volume for *_, volume in results)
            print(f"| {belt.name} | {counts} | {cpu} | {volumes} |", flush=True)


if __name__ == "__main__":
    main()
