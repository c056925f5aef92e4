"""How many frame sets a second the running system holds, by number of workers; and a model of more cores.

    python benchmarks/realtime.py [RENDERED] [--widths PX …] [--presets NAME …] [--workers N …] [--rounds R]

`beltscape replay --speed full` of the rendered moving belt, five cameras, from image files to records on disk. Each
row is the difference of a run of R rounds and one of a single round, so that the start does not count. *Serial* is
the CPU time of the process that checks, orders and measures: no worker shares it. From it and from the CPU time of a
worker the model takes the rate of more cores, of which one orders: the lesser of (cores − 1) / worker and 1 / serial.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

from captures import parse_true_rig
from live import make_plant, replay
from results import ROOT
from tables import format_cells, format_head

HEAD = ("width px", "preset", "workers", "sets/s", "CPU s a set", "serial s", "× one worker")
CORES = (4, 8, 16, 32)
"""Cores of the model."""


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


def measure_rate(capture: Path, empty: Path, preset: str, workers: int, rounds: int) -> Rate:
    """Return the rate in the steady state."""
    once, often = (replay(capture, empty, preset, number, workers) for number in (1, rounds))
    sets = often.records - once.records
    return Rate(
        sets / (often.seconds - once.seconds),
        (often.cpu_s - once.cpu_s) / sets,
        (often.own_cpu_s - once.own_cpu_s) / sets,
    )


def main() -> None:
    """Print the table, and the model of more cores."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "rendered", nargs="?", type=Path, default=ROOT.parent / "shared" / "data" / "rendered"
    )
    parser.add_argument("--widths", nargs="*", type=int, default=[612, 1224])
    parser.add_argument("--presets", nargs="*", default=["fast", "standard"])
    parser.add_argument("--workers", nargs="*", type=int, default=[1, 2])
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    rig = parse_true_rig(json.loads((arguments.rendered / "truth" / "rig.json").read_text("utf-8")))
    print("\n".join(format_head(HEAD)))
    model = format_head(("width px", "preset", *(f"{cores} cores, sets/s" for cores in CORES)))
    with tempfile.TemporaryDirectory() as folder:
        for width in arguments.widths:
            capture, empty = make_plant(arguments.rendered, rig, Path(folder), width)
            for preset in arguments.presets:
                rates = [
                    measure_rate(capture, empty, preset, workers, arguments.rounds)
                    for workers in arguments.workers
                ]
                for workers, rate in zip(arguments.workers, rates, strict=True):
                    figures = f"{rate.sets_per_s:.2f}", f"{rate.cpu_s:.3f}", f"{rate.serial_s:.3f}"
                    gain = f"{rate.sets_per_s / rates[0].sets_per_s:.2f}"
                    print(format_cells([str(width), preset, str(workers), *figures, gain]), flush=True)
                predicted = (f"{rates[0].predict(cores):.1f}" for cores in CORES)
                model.append(format_cells([str(width), preset, *predicted]))
    print("\n" + "\n".join(model))


if __name__ == "__main__":
    main()
