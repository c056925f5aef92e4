"""Re-processing with one and two workers, and a simulation of more with the measured times.

    cd benchmarks && python -m cluster.scaling [--frames 30] [--recordings 6]

Recordings of a simulated belt (5 cameras of 306×256 px, preset ``fast``) are measured by ``beltscape reprocess`` on
one and on two workers. `cluster.model` then predicts and simulates larger clusters that read the plant's own images.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.progress import Silent
from beltscape.reprocessing.history import decode_result
from beltscape.reprocessing.manifest import Manifest, WorkSpan
from cluster.model import Costs, predict, simulate
from faults.capture import FRAMES_PER_S, SHORT, RoundCapture, open_capture

CAPTURES = Path(__file__).parents[2] / "out" / "bench-faults"
SEED = 31
PIECE_FRAMES, FRAME_BYTES, FRAME_S = 640, 5 * 1224 * 1024, 1.5
"""A plant's piece: its frames with the overlap; bytes of a frame of five cameras as TIFF; its time on one core with
the preset ``fast``."""
STORES = {"hard disk, 0.2 GB/s": 0.2e9, "10 Gbit/s, 1.2 GB/s": 1.2e9, "object store, 10 GB/s": 10e9}
WORKERS = (1, 2, 8, 64, 512)
NOTES = """Recordings without overlap, so that all work counts; *speed-up* is between the begin of the first and the
end of the last piece, without the start of Ray (*start*, once for a run). *Simulated*: pieces of a plant (640 frames
of 5 cameras with 1224×1024 px as TIFF, 1.5 s a frame), with the measured scatter of pieces and the measured time of
the driver for a piece, until 20 pieces for every worker are done; *predicted* is the slowest of workers, store and
driver."""


@dataclass(frozen=True)
class Measurement:
    """One run of the program."""

    piece_s: list[float]
    span_s: float
    """From the begin of the first piece to the end of the last."""
    start_s: float
    """From the program's start to the begin of the first piece."""
    setup_s: float
    """Fixed time of a piece."""
    results: list[bytes]


def make_source(folder: Path, capture: RoundCapture, recordings: int, frames: int) -> None:
    """Link a round's images into recordings of an endless belt, an hour apart, and write the project."""
    for index in range(recordings):
        recording = folder / "recordings" / f"{index + 1:06d}-20261122T{index:02d}0000Z"
        rows = ["frame,timestamp_s,belt_position_mm"]
        for frame in range(frames):
            number, name = index * frames + frame, f"{frame:05d}"
            source = capture.truth["frames"][number % capture.frames]["frame"]
            for camera in capture.rig.cameras:
                (recording / camera).mkdir(parents=True, exist_ok=True)
                image = capture.folder / "moving" / camera / f"{source}.png"
                os.link(image, recording / camera / f"{name}.png")
            time_s, position_mm = (
                3600 * index + frame / FRAMES_PER_S,
                capture.position_mm(number) + 1e4 * index,
            )
            rows.append(f"{name},{time_s!r},{position_mm!r}")
        (recording / "encoder.csv").write_text("\n".join(rows) + "\n")
    shutil.copy(capture.folder / "moving" / "truth" / "rig.json", folder / "rig.json")
    shutil.copytree(capture.folder / "empty_rec", folder / "empty")
    text = 'rig = "rig.json"\nempty = "empty"\n[capture]\nfolder = "."\n[encoder]\nkind = "capture"\n'
    (folder / "project.toml").write_text(text)


def measure(folder: Path, workers: int) -> Measurement:
    """Run the program with a number of workers."""
    store, began_s = folder / f"store{workers}", time.time()
    words = [
        "reprocess",
        folder / "recordings",
        "--project",
        folder / "project.toml",
        "--workers",
        str(workers),
    ]
    subprocess.run(
        [sys.executable, "-m", "beltscape", *words, "--out", store, "--json"], check=True, capture_output=True
    )
    work = json.loads((store / "progress.json").read_text())
    with sqlite3.connect(f"file:{store / 'manifest.sqlite'}?mode=ro", uri=True) as connection:
        rows = connection.execute("SELECT begin_s, seconds, result FROM pieces ORDER BY key").fetchall()
    begins, ends = [row[0] for row in rows], [row[0] + row[1] for row in rows]
    return Measurement(
        [row[1] for row in rows],
        max(ends) - min(begins),
        min(begins) - began_s,
        work["setup_s_per_piece"],
        [row[2] for row in rows],
    )


def measure_driver_s(folder: Path, results: list[bytes]) -> float:
    """Return the driver's time to store a result and to read its times, s."""
    manifest = Manifest(folder, "benchmark")
    began_s = time.perf_counter()
    for number in range(20):
        for index, result in enumerate(results):
            manifest.add(f"{number}-{index}", "recording", result, WorkSpan("worker", 0.0, 1.0))
            decode_result(result)
    spent_s = time.perf_counter() - began_s
    manifest.close()
    return spent_s / (20 * len(results))


def cluster_scaling(recordings: int = 6, frames: int = 30) -> list[str]:
    """Return the tables: measured with one and two workers, simulated with more."""
    capture = open_capture(CAPTURES, SHORT, SEED, Silent())
    # beside the captures: images are linked, which needs one file system
    with tempfile.TemporaryDirectory(dir=CAPTURES) as place:
        folder = Path(place)
        make_source(folder, capture, recordings, frames)
        one, two = measure(folder, 1), measure(folder, 2)
        driver_s = measure_driver_s(folder, one.results)
    same = [decode_result(result).entries for result in one.results]
    is_same = repr(same) == repr([decode_result(result).entries for result in two.results])
    lines = [
        NOTES,
        "",
        "| workers | pieces | time of a piece, s | fixed, s | start, s | span, s | speed-up | same records |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for workers, run in ((1, one), (2, two)):
        lines.append(
            f"| {workers} | {len(run.piece_s)} | {np.mean(run.piece_s):.2f} ± {np.std(run.piece_s):.2f} | "
            f"{run.setup_s:.3f} | {run.start_s:.1f} | {run.span_s:.1f} | {one.span_s / run.span_s:.2f} | "
            f"{'yes' if workers == 1 or is_same else 'NO'} |"
        )
    return [*lines, "", *_simulate(one, driver_s)]


def _simulate(one: Measurement, driver_s: float) -> list[str]:
    """Return the table of larger clusters."""
    scatter = np.asarray(one.piece_s) / np.mean(one.piece_s)
    costs = Costs((scatter * FRAME_S * PIECE_FRAMES).tolist(), float(FRAME_BYTES * PIECE_FRAMES), driver_s)
    lines = [
        f"The driver takes {1000 * driver_s:.1f} ms for a piece.",
        "",
        "| store | workers | predicted, pieces/h | simulated, pieces/h | efficiency | bound by |",
        "|---|---|---|---|---|---|",
    ]
    for name, bytes_per_s in STORES.items():
        for workers in WORKERS:
            expected = predict(costs, workers, bytes_per_s)
            found = simulate(costs, workers, bytes_per_s, 20 * workers, SEED)
            lines.append(
                f"| {name} | {workers} | {3600 * expected.pieces_per_s:.1f} | {3600 * found.pieces_per_s:.1f} | "
                f"{found.efficiency:.2f} | {expected.bound} |"
            )
    return lines


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=6)
    parser.add_argument("--frames", type=int, default=30)
    arguments = parser.parse_args()
    print("\n".join(cluster_scaling(arguments.recordings, arguments.frames)))


if __name__ == "__main__":
    main()
