"""A plant at its limit for minutes or hours, with everything on: memory, latency, and the ledger's ends.

    python benchmarks/soak.py [RENDERED] [--minutes M] [--sets-per-s R] [--width PX] [--preset NAME] [--workers N]

`beltscape run` of the rendered moving belt in a loop, with the page, Modbus, OPC UA, CSV and the recording ring. It
prints memory and CPU time of all its processes each minute, then what the history holds: the records, whether each
begins where the last one ended, and how their delay behind their frame sets changed from the first to the last tenth.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from beltscape.core.ledger import BeltRecord
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from captures import parse_true_rig
from live import make_plant, pace_capture
from results import ROOT
from timing import memory_mb

_END_NS, _PAGE = 1 << 62, 5000


def write_project(plant: Path, capture: Path, empty: Path, preset: str, workers: str) -> Path:
    """Write and return the plant's project.toml."""
    project = plant / "project.toml"
    project.write_text(
        f'rig = "{empty / "rig.json"}"\nempty = "{empty}"\ndata = "{plant / "data"}"\n'
        f'[capture]\nfolder = "{capture}"\nloop = true\n[encoder]\nkind = "capture"\n'
        f'[matching]\npreset = "{preset}"\nworkers = {workers}\n'
        "[web]\nport = 0\n[modbus]\nport = 0\n[opcua]\nport = 0\n[csv]\nenabled = true\n"
        '[recording]\nmode = "ring"\nring_min = 1.0\n',
        encoding="utf-8",
    )
    return project


def list_family(process: int) -> list[int]:
    """Return a process and the processes that it began."""
    children = Path(f"/proc/{process}/task/{process}/children")
    began = children.read_text().split() if children.exists() else []
    return [process, *(one for child in began for one in list_family(int(child)))]


def follow_memory(program: subprocess.Popen[str], minutes: float) -> list[float]:
    """Print the memory each minute until the time is over; return it, MB."""
    began, memory_of_minutes = time.monotonic(), list[float]()
    while time.monotonic() - began < 60 * minutes and program.poll() is None:
        time.sleep(min(60.0, max(60 * minutes - (time.monotonic() - began), 0.1)))
        family = list_family(program.pid)
        memory = [memory_mb("VmRSS", process) for process in family]
        memory_of_minutes.append(sum(memory))
        parts = " ".join(f"{each:.0f}" for each in memory)
        print(f"{(time.monotonic() - began) / 60:5.1f} min  {sum(memory):6.0f} MB  ({parts})", flush=True)
    return memory_of_minutes


def read_ledger(data: Path) -> list[BeltRecord]:
    """Return all records of a history."""
    historian, records = Historian(data, HistorySettings()), list[BeltRecord]()
    while page := historian.records(0, _END_NS, limit=_PAGE, after=records[-1].number if records else 0):
        records += page
    historian.close()
    return records


def describe_ledger(records: Sequence[BeltRecord]) -> list[str]:
    """Return lines about the belt's ends, the standings and the change of the delay."""
    gaps = [later.belt_mm[0] - before.belt_mm[1] for before, later in pairwise(records)]
    metres = dict.fromkeys(("valid", "degraded", "missing"), 0.0)
    for record in records:
        metres[record.standing] += record.length_mm * 1e-3
    delays = [
        (record.wall_ns - record.strip.time_ns) * 1e-9
        for record in records
        if record.strip is not None and record.strip.time_ns is not None
    ]
    tenth = max(len(delays) // 10, 1)
    change = (
        statistics.median(delays[-tenth:]) - statistics.median(delays[:tenth]) if delays else float("nan")
    )
    return [
        f"{len(records)} records, largest gap or overlap {max(map(abs, gaps), default=0.0):.6f} mm",
        ", ".join(f"{length:.3f} m {standing}" for standing, length in metres.items()),
        f"delay of the last tenth over that of the first {change:+.3f} s",
    ]


def main() -> None:
    """Run the plant, and print what it did."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    rendered = ROOT.parent / "shared" / "data" / "rendered"
    parser.add_argument("rendered", nargs="?", type=Path, default=rendered)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--sets-per-s", type=float, default=4.0)
    parser.add_argument("--width", type=int, default=612)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--workers", default='"auto"')
    chosen = parser.parse_args()
    rig = parse_true_rig(json.loads((chosen.rendered / "truth" / "rig.json").read_text("utf-8")))
    with tempfile.TemporaryDirectory() as folder:
        plant = Path(folder)
        capture, empty = make_plant(chosen.rendered, rig, plant, chosen.width)
        paced = pace_capture(capture, plant / "paced", chosen.sets_per_s)
        project = write_project(plant, paced, empty, chosen.preset, chosen.workers)
        words = [sys.executable, "-m", "beltscape", "run", str(project), "--json"]
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as program:
            memory = follow_memory(program, chosen.minutes)
            os.kill(program.pid, signal.SIGTERM)
            output, _ = program.communicate()
        if program.returncode:
            raise RuntimeError(f"{' '.join(words)}: ended with {program.returncode}")
        latency = json.loads(output)["latency"]
        third = max(len(memory) // 3, 1)
        growth = statistics.mean(memory[-third:]) - statistics.mean(memory[:third])
        print(f"memory of the last third over that of the first {growth:+.0f} MB")
        print(f"latency {latency}")
        print("\n".join(describe_ledger(read_ledger(plant / "data"))))


if __name__ == "__main__":
    main()
