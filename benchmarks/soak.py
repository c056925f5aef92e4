"""A plant at its limit for minutes or hours, with everything on: memory, latency, and the ledger's ends.

    python benchmarks/soak.py [RENDERED] [--minutes M] [--sets-per-s R] [--width PX] [--preset NAME] [--workers N]

`beltscape run` of the rendered moving belt in a loop, with the page, all protocols, CSV and the recording ring, and a
client of each of them (MQTT where mosquitto is installed). It prints the memory of all its processes each minute,
then what the clients read and what the history holds: the records, whether each begins
where the last one ended, and their delay behind their frame sets, by tenths of the time.
"""

from __future__ import annotations

import argparse
import json
import logging
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from beltscape.core.ledger import BeltRecord
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from captures import read_true_rig
from live import make_plant, pace_capture
from protocols.clients import describe_reading, read_all
from protocols.load import find_broker, find_ports, run_broker
from results import ROOT
from timing import memory_mb

_TABLES = {
    "web": '[web]\nport = {port}\n[web.access]\nanonymous_role = "viewer"',
    "modbus": "[modbus]\nport = {port}\npulse_kg = 100",
    "mqtt": '[mqtt]\nhost = "127.0.0.1"\nport = {port}',
    "opcua": '[opcua]\nport = {port}\nsecurity = "none"\nclients = "any"\nanonymous_role = "viewer"',
    "syslog": '[syslog]\nhost = "127.0.0.1"\nport = {port}',
    "outputs": '[outputs]\nhost = "127.0.0.1"\nport = {port}\nheartbeat = 12\npulse = {{ kg = 25, address = 3 }}\n'
    '[[outputs.analogue]]\nvalue = "flow_t_h"\naddress = 10\nfull = 1000',
}
"""By table of project.toml with a port: its text."""
_END_NS, _PAGE = 1 << 62, 5000
_PARTS = 10
"""Parts of the time for which the delay is stated."""


def write_project(
    plant: Path, capture: Path, empty: Path, preset: str, workers: str, ports: Mapping[str, int]
) -> Path:
    """Write and return the plant's project.toml."""
    project = plant / "project.toml"
    tables = [
        f'rig = "{empty / "rig.json"}"\nempty = "{empty}"\ndata = "{plant / "data"}"',
        f'[capture]\nfolder = "{capture}"\nloop = true\n[encoder]\nkind = "capture"',
        f'[matching]\npreset = "{preset}"\nworkers = {workers}',
        '[density]\nkg_m3 = 850\n[csv]\nenabled = true\n[recording]\nmode = "ring"\nring_min = 1.0',
        *(_TABLES[name].format(port=port) for name, port in ports.items()),
    ]
    project.write_text("\n".join(tables) + "\n", encoding="utf-8")
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
    parts = [part for part in np.array_split(np.array(delays), _PARTS) if len(part)]
    least = min(
        (float(np.median(part)) for part in parts), default=0.0
    )  # times of the capture are no wall times
    shares = [np.quantile(part, (0.5, 0.9)) - least for part in parts]
    by_part = ", ".join(f"{middle:.2f} / {most:.2f}" for middle, most in shares)
    return [
        f"{len(records)} records, largest gap or overlap {max(map(abs, gaps), default=0.0):.6f} mm",
        ", ".join(f"{length:.3f} m {standing}" for standing, length in metres.items()),
        f"delay of records by tenths of the time, median / 90 %, over the least median, s: {by_part}",
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
    rig = read_true_rig(chosen.rendered)
    for name in (
        "asyncua",
        "pymodbus_internal",
        "pymodbus.logging",
    ):  # clients begin before the servers and outlive them
        logging.getLogger(name).setLevel(logging.CRITICAL)
    has_broker = find_broker() is not None
    ports = find_ports(name for name in _TABLES if name != "mqtt" or has_broker)
    if not has_broker:
        print("without MQTT: mosquitto is not installed")
    with tempfile.TemporaryDirectory() as folder, run_broker(Path(folder), needed=has_broker) as broker:
        plant = Path(folder)
        ports |= {"mqtt": broker} if has_broker else {}
        capture, empty = make_plant(chosen.rendered, rig, plant, chosen.width)
        paced = pace_capture(capture, plant / "paced", chosen.sets_per_s)
        project = write_project(plant, paced, empty, chosen.preset, chosen.workers, ports)
        words = [sys.executable, "-m", "beltscape", "run", str(project), "--json"]
        with (
            (plant / "log").open("w+", encoding="utf-8") as log,
            subprocess.Popen(words, stdout=subprocess.PIPE, stderr=log, text=True) as program,
            read_all(ports),
        ):
            memory = follow_memory(program, chosen.minutes)
            program.send_signal(signal.SIGTERM)  # nothing where it has ended
            output, _ = program.communicate()
        if program.returncode:
            last = (plant / "log").read_text("utf-8").splitlines()[-1:]
            raise RuntimeError(f"{' '.join(words)}: ended with {program.returncode}: {last}")
        latency = json.loads(output)["latency"]
        third = max(len(memory) // 3, 1)
        growth = statistics.mean(memory[-third:]) - statistics.mean(memory[:third])
        print(f"memory of the last third over that of the first {growth:+.0f} MB")
        print(f"latency {latency}")
        print(f"read by clients: {describe_reading(ports)}")
        print("\n".join(describe_ledger(read_ledger(plant / "data"))))


if __name__ == "__main__":
    main()
