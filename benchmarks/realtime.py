"""How many frame sets a second the running system holds, by number of workers; and a model of more cores.

    python benchmarks/realtime.py [RENDERED] [--widths PX …] [--presets NAME …] [--workers N …] [--rounds R]

`beltscape replay --speed full` of the rendered moving belt, five cameras, from image files to records on disk. Each
row is the difference of a run of R rounds and one of a single round, so that the start does not count. *Serial* is
the CPU time of the process that checks, orders and measures: no worker shares it. One worker takes a core, and what
measures, reads and fills holes runs on another meanwhile: *× one worker* is the rate over that of one worker with all
cores, *× one core* over that of one worker where all processes share one core. From the serial part and from the CPU
time of a worker the model takes the rate of more cores, of which one orders: the lesser of (cores − 1) / worker and
1 / serial.
The latency is that of a run in which frame sets come at `_HELD` of the rate that the most workers held: that of the
frame sets, and that of the records from their own frame set on and from the last one on that saw their belt.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.geometry.rig import Rig
from captures import read_true_rig
from live import make_plant, replay
from results import ROOT
from tables import format_cells, format_head

HEAD = (
    "width px", "preset", "workers", "cores", "sets/s", "CPU s a set", "serial s", "× one worker", "× one core",
)  # fmt: skip
LATENCY_HEAD = (
    "width px", "preset", "workers", "sets/s", "belt m/s", "latency", "median s", "90 % s", "99 % s", "worst s",
)  # fmt: skip
PARTS = {
    "latency_of_frames": "frame set, to the end of its measurement",
    "latency_after_view": "record, from the last frame set that saw its belt on",
    "latency": "record, from its own frame set on",
}
"""Keys of the program's result, and what they are."""
_HELD = 0.8
"""Share of the rate that is held at which frame sets come: a plant leaves room for other programs."""
CORES = (4, 8, 16, 32)
"""Cores of the model."""
WIDTHS_PX, PRESETS, WORKERS, ROUNDS = (612, 1224), ("fast", "standard"), (1, 2), 2


@dataclass(frozen=True)
class Rate:
    """What a number of workers holds."""

    sets_per_s: float
    cpu_s: float
    """Of a set, all processes together."""
    serial_s: float
    """Of a set, in the process that measures."""

    def predict(self, cores: int) -> float:
        """Return the sets per second of a machine with this number of cores, of which one orders and measures."""
        return min((cores - 1) / max(self.cpu_s - self.serial_s, 1e-9), 1 / self.serial_s)


def measure_rate(
    capture: Path, empty: Path, preset: str, workers: int, rounds: int, cores: int | None = None
) -> Rate:
    """Return the rate in the steady state of a number of workers, with some or all cores for all processes."""
    once, often = (replay(capture, empty, preset, number, workers, cores=cores) for number in (1, rounds))
    sets = often.records - once.records
    return Rate(
        sets / (often.seconds - once.seconds),
        (often.cpu_s - once.cpu_s) / sets,
        (often.own_cpu_s - once.own_cpu_s) / sets,
    )


def measure_latency(
    capture: Path, empty: Path, preset: str, workers: int, rounds: int, rate: float
) -> list[list[str]]:
    """Return the rows of the latencies' distributions at a rate of frame sets, in sets per second."""
    found = replay(capture, empty, preset, rounds, workers, rate).latency
    belt = [float(line.split(",")[2]) for line in (capture / "encoder.csv").read_text().splitlines()[1:]]
    speed = rate * (belt[-1] - belt[0]) / (len(belt) - 1) * 1e-3
    run = [str(workers), f"{rate:.2f}", f"{speed:.2f}"]
    times = ("median_s", "most_90_s", "most_99_s", "worst_s")
    return [[*run, text, *(f"{found[key][name]:.2f}" for name in times)] for key, text in PARTS.items()]


NOTES = """`beltscape replay --speed full` of the rendered moving belt, five cameras, from image files to records on
disk; the start does not count. *Serial*: CPU time a set of the process that checks, orders and measures, which no
worker shares. One worker takes a core, and what measures, reads and fills holes runs on another meanwhile: *× one
worker* is the rate over that of one worker with all cores, *× one core* over that of one worker where all processes
share one core. The model: of all cores one orders and measures, the others match, as fast as one worker does.
*Latency*: with frame sets at 0.8 of the rate that the most workers held, from the arrival of a frame set to the end
of its measurement, and to a record being stored and passed on: from the last frame set on that saw the record's belt,
and from its own, which lies by the length of the view before: the belt has to leave the view first."""


def realtime(rendered: Path, rig: Rig) -> list[str]:
    """Return the tables of every width, preset and number of workers; the reason if the capture is missing."""
    if not (rendered / "belt_moving").is_dir():
        return ["Not run: the rendered moving belt is not available."]
    return [NOTES, "", *tabulate(rendered, rig, WIDTHS_PX, PRESETS, WORKERS, ROUNDS)]


def tabulate(
    rendered: Path,
    rig: Rig,
    widths: Sequence[int],
    presets: Sequence[str],
    workers: Sequence[int],
    rounds: int,
) -> Iterator[str]:
    """Yield the lines of the table, and of the model of more cores."""
    yield from format_head(HEAD)
    model = format_head(("width px", "preset", *(f"{cores} cores, sets/s" for cores in CORES)))
    latency = format_head(LATENCY_HEAD)
    with tempfile.TemporaryDirectory() as folder:
        for width in widths:
            capture, empty = make_plant(rendered, rig, Path(folder), width)
            for preset in presets:
                alone = measure_rate(capture, empty, preset, 1, rounds, cores=1)
                rates = [measure_rate(capture, empty, preset, number, rounds) for number in workers]
                every = len(os.sched_getaffinity(0))
                rows = [
                    (1, 1, alone),
                    *((number, every, rate) for number, rate in zip(workers, rates, strict=True)),
                ]
                for number, cores, rate in rows:
                    figures = f"{rate.sets_per_s:.2f}", f"{rate.cpu_s:.3f}", f"{rate.serial_s:.3f}"
                    gains = (f"{rate.sets_per_s / other.sets_per_s:.2f}" for other in (rates[0], alone))
                    yield format_cells([str(width), preset, str(number), str(cores), *figures, *gains])
                predicted = (f"{rates[0].predict(cores):.1f}" for cores in CORES)
                model.append(format_cells([str(width), preset, *predicted]))
                held = _HELD * rates[-1].sets_per_s
                for cells in measure_latency(capture, empty, preset, workers[-1], rounds, held):
                    latency.append(format_cells([str(width), preset, *cells]))
    yield from ["", *model, "", *latency]


def main() -> None:
    """Print the table, and the model of more cores."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "rendered", nargs="?", type=Path, default=ROOT.parent / "shared" / "data" / "rendered"
    )
    parser.add_argument("--widths", nargs="*", type=int, default=WIDTHS_PX)
    parser.add_argument("--presets", nargs="*", default=PRESETS)
    parser.add_argument("--workers", nargs="*", type=int, default=WORKERS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    chosen = parser.parse_args()
    rig = read_true_rig(chosen.rendered)
    for line in tabulate(chosen.rendered, rig, chosen.widths, chosen.presets, chosen.workers, chosen.rounds):
        print(line, flush=True)


if __name__ == "__main__":
    main()
