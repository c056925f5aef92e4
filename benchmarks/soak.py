"""Endurance test of a simulated plant: cameras and program are killed, files damaged, disk and database taken.

    unshare --net --mount python benchmarks/soak.py CAPTURE RIG EMPTY OUT [--minutes 60]
        [--calm-minutes 30] [--frames-per-s 2]

CAPTURE is a capture of the moving belt with encoder.csv, repeated by simulated GigE Vision cameras; RIG and EMPTY are
as for `beltscape run`. No fault occurs in the calm minutes, in which the memory is observed. It needs root (addresses
and a small file system), Aravis and Chromium. At the end it checks that every millimetre of the encoder is in the
ledger once and that every record shown on the page reads back unchanged; the pulses are the total's litres. Writes
OUT/soak.json and OUT/page.png.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import random
import signal
import sqlite3
import struct
import subprocess
import sys
import time
import urllib.request
from collections.abc import Generator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

from beltscape.files.json_text import write_json
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from beltscape.sources.fake_genicam.camera import COUNTER
from beltscape.sources.fake_genicam.simulated_cameras import SimulatedCameras, add_addresses, read_pictures

PORT = 8470
MM_PER_COUNT = 0.01
DISK_MIB = 192
SAMPLE_S = 5.0
FAULTS = ("camera", "core", "disk", "kill", "lock", "state")
STATE = ("pulses.json", "alarm_states.json", "alarms.json", "maintenance.json", "encoder.json", "totals.json")


@dataclass
class Observations:
    """Data served to the page, memory and faults during the test."""

    records: dict[int, dict[str, Any]] = field(default_factory=dict)
    rss_mib: list[tuple[float, int, float]] = field(default_factory=list)
    """(seconds, process, MiB)."""
    alarms: set[str] = field(default_factory=set)
    faults: list[tuple[float, str]] = field(default_factory=list)
    unanswered: int = 0


def main() -> None:
    """Run the test and print its result."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("capture", "rig", "empty", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--calm-minutes", type=float, default=30.0, help="before the first fault")
    parser.add_argument("--frames-per-s", type=float, default=2.0)
    arguments = parser.parse_args()
    out: Path = arguments.out
    data = out / "data"
    data.mkdir(parents=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m", "tmpfs", str(data)], check=True)
    pictures, counts, around = read_pictures(arguments.capture, MM_PER_COUNT)
    bench = SimulatedCameras(out / "bench", pictures, arguments.frames_per_s, counts, around)
    add_addresses(bench.devices.values())
    project = out / "project.toml"
    project.write_text(_project(arguments, bench), encoding="utf-8")
    with bench, _page(out / "page.png"):
        observed = run_with_faults(project, bench, data, arguments.minutes * 60, arguments.calm_minutes * 60)
        counted = Encoder(out / "bench", counts, around).position_mm
    result = assess(data, observed, counted)
    write_json(out / "soak.json", result)
    print(json.dumps({k: v for k, v in result.items() if k not in ("faults", "memory")}, indent=1))


def _project(arguments: argparse.Namespace, bench: SimulatedCameras) -> str:
    devices = "\n".join(f'{name} = "{address}"' for name, address in bench.devices.items())
    rate = arguments.frames_per_s
    return f"""name = "soak"
rig = "{arguments.rig.resolve()}"
empty = "{arguments.empty.resolve()}"
data = "data"
[cameras]
frames_per_s = {rate}
pixel_format = "{next(iter(bench.formats.values()))}"
allowed_skew_ms = {150 / rate:.4g}
clocks = "ptp"
packet_size = 9000
[cameras.devices]
{devices}
[cameras.encoder]
feature = "{COUNTER}"
mm_per_count = {MM_PER_COUNT}
[encoder]
kind = "camera"
[history]
reserve_mib = 8
[modbus]
port = {PORT + 1}
pulse_l = 1
[recording]
ring_min = 0.2
limit_gib = 0.1
free_gib = 0.02
[alarms.camera_skew]
skew_ms = {100 / rate:.4g}
[web]
port = {PORT}
[web.access]
anonymous_role = "viewer"
"""


def run_with_faults(
    project: Path, bench: SimulatedCameras, data: Path, seconds: float, calm_s: float
) -> Observations:
    """Run the program, cause and clear faults periodically, and record the data served to the page."""
    observed, chance = Observations(), random.Random(7)
    began = time.monotonic()
    program = _start(project)
    fault_at = max(60.0, calm_s)
    while (now := time.monotonic() - began) < seconds:
        _sample(observed, now, program.pid)
        if now > fault_at and now < seconds - 60:
            kind = FAULTS[len(observed.faults) % len(FAULTS)]
            observed.faults.append((now, kind))
            program = _cause_fault(kind, program, project, bench, data, chance)
            fault_at = time.monotonic() - began + chance.uniform(20, 40)
        time.sleep(SAMPLE_S)
    _sample(observed, seconds, program.pid)
    program.send_signal(signal.SIGINT)
    program.wait(60)
    return observed


def _cause_fault(
    kind: str,
    program: subprocess.Popen[bytes],
    project: Path,
    bench: SimulatedCameras,
    data: Path,
    chance: random.Random,
) -> subprocess.Popen[bytes]:
    """Cause one fault for some seconds; return the program that runs afterwards."""
    names = list(bench.devices)
    if kind in ("camera", "core"):
        name = names[0] if kind == "core" else chance.choice(names[1:])
        bench.kill(name)
        time.sleep(chance.uniform(5, 15))
        bench.start(name)
    elif kind == "disk":
        filler = data / "filler"
        with contextlib.suppress(OSError), filler.open("wb") as file:
            while True:
                file.write(bytes(1 << 16))
                file.flush()
        time.sleep(chance.uniform(8, 15))
        filler.unlink()
    elif kind == "lock":
        other = sqlite3.connect(data / "history.db", isolation_level=None, timeout=60)
        other.execute("BEGIN IMMEDIATE")
        time.sleep(chance.uniform(20, 60))
        other.close()
    else:
        program.kill()
        program.wait()
        for name in STATE if kind == "state" else ():
            with (data / name).open("ab") as file:
                file.truncate(chance.randrange(file.tell() + 1))
        time.sleep(chance.uniform(1, 6))
        return _start(project)
    return program


def _start(project: Path) -> subprocess.Popen[bytes]:
    with (project.parent / "run.log").open("ab") as log:
        words = [sys.executable, "-m", "beltscape", "run", str(project)]
        return subprocess.Popen(words, stdout=log, stderr=log)


def _sample(observed: Observations, now: float, process: int) -> None:
    """Sample the records and alarms of the page's interface, and the process's memory."""
    with contextlib.suppress(OSError):
        pages = Path(f"/proc/{process}/statm").read_text().split()[1]
        observed.rss_mib.append((now, process, int(pages) * 4096 / 2**20))
    try:
        after = max(observed.records, default=0)
        now_ms = time.time_ns() // 10**6 + 60_000
        for record in _get(f"records?since_ms=0&until_ms={now_ms}&limit=1000&after={after}"):
            observed.records[record["number"]] = record
        observed.alarms |= {alarm["name"] for alarm in _get("state")["alarms"] if alarm["state"] != "clear"}
    except (OSError, ValueError):
        observed.unanswered += 1


def _get(what: str) -> Any:
    with urllib.request.urlopen(f"http://127.0.0.1:{PORT}/api/{what}", timeout=5) as answer:
        return json.load(answer)


@dataclass
class Encoder:
    """The counter of the simulated cameras, from their file of instants."""

    folder: Path
    counts: list[int]
    around: int

    @property
    def position_mm(self) -> float:
        """Belt position of the newest instant."""
        (number,) = struct.unpack("<q", (self.folder / "instants").read_bytes()[:8])
        rounds, index = divmod(number, len(self.counts))
        return (self.counts[index] + rounds * self.around) * MM_PER_COUNT


def assess(data: Path, observed: Observations, counted_mm: float) -> dict[str, Any]:
    """Compare the ledger with the encoder and with the records served to the page."""
    historian = Historian(data, HistorySettings(reserve_mib=8))
    records = historian.records(0, 1 << 62, 1 << 40)
    totals = historian.totals
    historian.close()
    kept = {record.number: record for record in records}
    placed = [one for one in records if one.strip is not None and math.isfinite(one.strip.belt_position_mm)]
    view = next(one.belt_mm[1] - one.strip.belt_position_mm for one in placed if one.strip is not None)
    return {
        "minutes": observed.rss_mib[-1][0] / 60,
        "records": len(records),
        "runs": len({record.run for record in records}),
        "numbers_follow": all(b.number == a.number + 1 for a, b in pairwise(records)),
        "intervals_meet": all(b.belt_mm[0] == a.belt_mm[1] for a, b in pairwise(records)),
        "ledger_m": (records[-1].belt_mm[1] - records[0].belt_mm[0]) / 1000,
        "valid_m": totals.valid_mm / 1000,
        "degraded_m": totals.degraded_mm / 1000,
        "missing_m": totals.missing_mm / 1000,
        "ledger_end_less_encoder_mm": records[-1].belt_mm[1] - counted_mm,
        "view_ahead_of_encoder_mm": view,
        "volume_m3": totals.volume_mm3 * 1e-9,
        "sum_of_records_m3": sum(r.volume_mm3 for r in records) * 1e-9,
        "pulses": json.loads((data / "pulses.json").read_text())["count"],
        "shown": len(observed.records),
        "shown_and_lost": sorted(set(observed.records) - set(kept)),
        "shown_and_changed": [
            n
            for n, shown in observed.records.items()
            if n in kept and abs(shown["to_m"] * 1000 - kept[n].belt_mm[1]) > 1e-6
        ],
        "alarms": sorted(observed.alarms),
        "faults": observed.faults,
        "unanswered": observed.unanswered,
        "memory_mib": _memory(observed.rss_mib),
        "memory": observed.rss_mib,
    }


def _memory(samples: list[tuple[float, int, float]]) -> list[dict[str, float]]:
    """Return, per process of at least ten minutes and without its first two, start, end and peak memory."""
    rows = []
    for process in dict.fromkeys(number for _, number, _ in samples):
        own = [(now, mib) for now, number, mib in samples if number == process]
        settled = [mib for now, mib in own if now > own[0][0] + 120]
        if own[-1][0] - own[0][0] < 600:
            continue
        tenth = max(1, len(settled) // 10)
        first, last = median(settled[:tenth]), median(settled[-tenth:])
        minutes = (own[-1][0] - own[0][0]) / 60
        rows.append({"minutes": minutes, "first": first, "last": last, "most": max(settled)})
    return rows


@contextlib.contextmanager
def _page(picture: Path) -> Generator[None]:
    """Keep the operator's page open in a browser."""
    script = Path(__file__).with_name("open_page.py")
    words = [sys.executable, str(script), f"http://127.0.0.1:{PORT}/", str(picture)]
    browser = subprocess.Popen(words, stdin=subprocess.PIPE)
    try:
        yield
    finally:
        if browser.stdin:
            browser.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            browser.wait(10)
        browser.kill()


if __name__ == "__main__":
    main()
