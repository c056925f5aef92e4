"""Starts writers and kills them, over and over; prints what it found as JSON. Run by test_kill.py with ``python -m``.

One process that has everything loaded forks the writers: a kill every few hundredths of a second.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sqlite3
import sys
import time
from itertools import pairwise
from pathlib import Path

from beltscape.sinks.historian import Historian
from beltscape.sinks.historian.day_files import read_day
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import START_NS, record, same

SETTINGS = HistorySettings(reserve_mib=1, database_days=2)
HOUR_NS = 3_600_000_000_000


def write_until_killed(folder: Path, acknowledge: int) -> None:
    """Batches of one to four records; each batch's last number goes out when it is acknowledged.

    Days fly by: between the batches files are closed and records pruned, and are killed at it.
    """
    historian = Historian(folder, SETTINGS)
    run = historian.begin_run()
    number = historian.ledger_end.number
    while True:
        # a quarter of an hour from record to record, on a clock that is two hours off every now and then
        batch = [
            record(n, run, START_NS + (n + (n % 5 - 2) * 8 * (n % 50 == 0)) * HOUR_NS // 4)
            for n in range(number + 1, number + 2 + number % 4)
        ]
        historian.write(batch)
        number = batch[-1].number
        os.write(acknowledge, number.to_bytes(8, "little"))
        if number % 3 == 0:
            historian.maintain(batch[-1].wall_ns)


def killed_once(folder: Path, after_s: float, *, writing_first: bool) -> int:
    """Number of the last record that a writer acknowledged before it was killed; 0 where none.

    The time counts from the first acknowledgement, or from the start: then the database may just be opening.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            write_until_killed(folder, writing)
        finally:
            os._exit(1)
    os.close(writing)
    received = os.read(reading, 8) if writing_first else b""
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "a writer ended by itself"
    with os.fdopen(reading, "rb") as pipe:
        received += pipe.read()
    return int.from_bytes(received[len(received) // 8 * 8 - 8 :][:8], "little") if len(received) >= 8 else 0


def main(folder: Path, kills: int, least: int) -> None:
    """Kill that often, and until so many records are acknowledged; then look at everything."""
    rng = random.Random(7)
    acknowledged, repairs, kill = 0, [], -1
    while (kill := kill + 1) < kills or acknowledged < least:
        acknowledged = max(
            acknowledged, killed_once(folder, rng.uniform(0, 0.06), writing_first=kill % 3 > 0)
        )
        if kill % 10 == 9:
            historian = Historian(folder, SETTINGS)
            repairs.append(historian.repair_message)
            assert historian.ledger_end.number >= acknowledged, (historian.ledger_end, acknowledged)
            historian.close()
    historian = Historian(folder, SETTINGS)
    historian.maintain(START_NS)
    found = historian.records(0, 1 << 62, limit=1 << 40, sections=True)
    totals, resume = historian.totals, historian.ledger_end
    curves = historian.series(0, 4_000_000_000_000_000_000, 10)
    historian.close()
    filed = [
        r.number
        for path in (folder / "days").glob("*.parquet")
        for r in read_day(path, (0, 1 << 62), (0, 1 << 62), 1 << 40, sections=False)
    ]
    connection = sqlite3.connect(folder / "history.db")
    integrity = connection.execute("PRAGMA integrity_check").fetchone()[0]
    connection.close()
    print(
        json.dumps(
            {
                "acknowledged": acknowledged,
                "records": len(found),
                "runs": len({r.run for r in found}),
                "numbers": [r.number for r in found] == list(range(1, len(found) + 1)),
                "contiguous": all(a.belt_mm[1] == b.belt_mm[0] for a, b in pairwise(found)),
                "same": all(same(r, record(r.number, r.run, r.wall_ns)) for r in found),
                "resume": [resume.number, resume.end_mm],
                "end_mm": found[-1].belt_mm[1],
                "volumes_mm3": [totals.volume_mm3, *(r.volume_mm3 for r in found)],
                "lengths_mm": [totals.length_mm, *(r.length_mm for r in found)],
                "curves": [float(curves.volume_mm3.sum()), int(curves.records.sum())],
                "filed": [len(filed), len(set(filed))],
                "integrity": integrity,
                "repairs": "".join(repairs),
            }
        )
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
