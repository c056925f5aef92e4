"""The historian on a disk of 8 MiB that another program fills; prints its state as JSON. Run by test_disk_full.py.

Mounts the disk itself: run it in a mount namespace of its own.
"""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

from beltscape.core.errors import OutputError
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import record, same

SETTINGS = HistorySettings(reserve_mib=1)
BATCH = 50


def filled(path: Path) -> None:
    """All that is left of the disk, to the last block."""
    with path.open("wb", buffering=0) as file:
        for size in (1 << 16, 1 << 12):
            try:
                while True:
                    file.write(bytes(size))
            except OSError:
                continue


def batch(historian: Historian) -> list:
    number = historian.ledger_end.number
    return [record(n, 1, time.time_ns()) for n in range(number + 1, number + 1 + BATCH)]


def until_refused(historian: Historian) -> str:
    """Write until it cannot be; why."""
    for _ in range(2000):
        try:
            historian.write(batch(historian))
        except OutputError as error:
            return str(error)
    return ""


def main(folder: Path) -> None:
    """Full, fuller, free again; twice."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(folder)], check=True)
    seen: dict[str, object] = {}
    historian = Historian(folder / "data", SETTINGS)
    for _ in range(4):
        historian.write(batch(historian))
    seen["well"] = [historian.trouble, historian.ledger_end.number]
    filled(folder / "filler")
    # what the log still has room for goes as before
    while not historian.trouble:
        historian.write(batch(historian))
    seen["full"] = [historian.trouble, historian.ledger_end.number]
    historian.add_event("alarm", "disk", "full")
    seen["refusal"] = until_refused(historian)
    seen["refused"] = historian.ledger_end.number
    seen["read_while_full"] = len(historian.records(0, 1 << 62, limit=1 << 40))
    held = batch(historian)
    try:
        historian.write(held)
    except OutputError:
        seen["refused_again"] = historian.ledger_end.number
    historian.close()
    # a start on a full disk
    historian = Historian(folder / "data", SETTINGS)
    seen["start"] = [historian.trouble, historian.ledger_end.number]
    (folder / "filler").unlink()
    historian.write(held)
    seen["free"] = [historian.trouble, historian.ledger_end.number]
    historian.write(batch(historian))
    reserve = (folder / "data" / "reserve").stat()
    seen["reserve"] = [reserve.st_size, os.statvfs(folder).f_bavail > 0]
    found = historian.records(0, 1 << 62, limit=1 << 40, sections=True)
    seen["numbers"] = [r.number for r in found] == list(range(1, historian.ledger_end.number + 1))
    seen["same"] = all(same(r, record(r.number, 1, r.wall_ns), sections=False) for r in found)
    seen["with_section"] = [r.number for r in found if r.section is not None]
    seen["events"] = len(historian.events(0, 1 << 62))
    seen["last"] = historian.ledger_end.number
    historian.close()
    with sqlite3.connect(folder / "data" / "history.db") as connection:
        seen["integrity"] = connection.execute("PRAGMA integrity_check").fetchone()[0]
    connection.close()
    print(json.dumps(seen))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
