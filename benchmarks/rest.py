"""What a belt at rest or creeping costs: CPU time with all frame sets matched, and with those that show new belt.

    python benchmarks/rest.py [--speeds 0 5 40 200] [--seconds S] [--scale F]

Renders a loaded belt at each speed, five cameras at 8 frame sets a second, and measures it twice in this process, on
one thread for each core, as the running system does without workers. It prints the CPU time for a second of belt, how
many frame sets were matched, and both volumes with their σ.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from beltscape.core.frames import FrameSet
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

FRAMES_PER_S = 8.0
LEARNED = 4
"""Frame sets in which the images are learned and the belt is found; they are not counted."""
STANDING_MM_S = 0.001
"""Of a belt that stands: a rendered speed is not 0."""


def make_plant(folder: Path, scale: float) -> dict[str, Any]:
    """Reconstruct the empty belt of a plant; return what its scenes have in common."""
    plant = {"rig": {"seed": 31, "scale": scale}, "render": {"passes": 1, "ambient_samples": 1}}
    simulate(
        Scenario.model_validate({**plant, "kind": "belt_empty", "seed": 33}), folder / "images", Silent()
    )
    rig = read_rig(folder / "images" / "truth" / "rig.json")
    reconstruct_capture(folder / "images", rig, folder / "empty", Silent(), preset="fast")
    return plant


def render(folder: Path, plant: dict[str, Any], speed_mm_s: float, seconds: float) -> list[FrameSet]:
    """Return the frame sets of a loaded belt, in which the heap is in view, with the encoder's positions."""
    motion = {"speed_mm_s": speed_mm_s or STANDING_MM_S, "frames_per_s": FRAMES_PER_S, "start_mm": 0.0}
    count = LEARNED + round(seconds * FRAMES_PER_S)
    scene = {**plant, "kind": "belt_moving", "seed": 32, "frames": count, "motion": motion}
    out = folder / f"{speed_mm_s:g}"
    simulate(Scenario.model_validate(scene), out, Silent())
    rows = [line.split(",") for line in (out / "encoder.csv").read_text().splitlines()[1:]]
    known = {frame: (round(float(at) * 1e9), float(position)) for frame, at, position in rows}
    files = read_capture(out).files
    return [
        FrameSet(frame, {camera: read_image(own[frame]) for camera, own in files.items()}, *known[frame])
        for frame in known
    ]


def measure(folder: Path, sets: Sequence[FrameSet], *, matches_all: bool) -> tuple[float, int, str]:
    """Return the CPU time, s, of the counted frame sets, how many of them were matched, and the volume."""
    path = folder / "project.toml"
    path.write_text(
        f'rig = "images/truth/rig.json"\nempty = "empty"\n[capture]\nfolder = "{folder}"\n'
        '[matching]\npreset = "fast"\nworkers = 0\n[flow]\ndirection = "+y"\n'
        f"[health]\nlearning_frames = {LEARNED - 1}\n",
        encoding="utf-8",
    )
    project = read_project(path, RunSettings)
    context = build_context(project, read_rig(folder / "images" / "truth" / "rig.json"), Silent())
    state, cameras = LedgerState(1, 0, None), tuple(context.rig.cameras)
    run = MeasurementRun(context, state, cameras, time.time_ns, Silent(), matches_all=matches_all)
    entries, used, began = [], 0, 0.0
    for number, frames in enumerate(sets):
        if number == LEARNED:
            began = time.process_time()
        outcome = run.push(frames)
        entries += [*outcome.entries, *run.flush().entries]
        used += number >= LEARNED and not outcome.is_repeat
    cpu_s = time.process_time() - began
    entries += run.finish().entries
    volume = sum(entry.volume_mm3 for entry in entries) * 1e-6
    return cpu_s, used, f"{volume:.4f} ± {entries[-1].run_sigma_mm3 * 1e-6:.4f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--speeds", type=float, nargs="+", default=[0, 5, 40, 200], help="of the belt, mm/s")
    parser.add_argument("--seconds", type=float, default=5.0, help="that each belt is measured")
    parser.add_argument("--scale", type=float, default=0.25, help="of the images to 2448 × 2048 px")
    arguments = parser.parse_args()
    print("| mm/s | frame sets matched | CPU s a second | volume, l |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plant = make_plant(folder, arguments.scale)
        for speed_mm_s in arguments.speeds:
            sets = render(folder, plant, speed_mm_s, arguments.seconds)
            results = [measure(folder, sets, matches_all=matches_all) for matches_all in (True, False)]
            used = " → ".join(str(count) for _, count, _ in results)
            cpu = " → ".join(f"{cpu_s / arguments.seconds:.2f}" for cpu_s, _, _ in results)
            volumes = " → ".join(volume for *_, volume in results)
            print(f"| {speed_mm_s:g} | {used} | {cpu} | {volumes} |", flush=True)


if __name__ == "__main__":
    main()
