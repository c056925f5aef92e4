"""The alarm journal: paged, by alarm, append-only, and complete after the program was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.thorough import THOROUGH

WRITER = """
import sys
from pathlib import Path
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
history = Historian(Path(sys.argv[1]), HistorySettings(reserve_mib=1))
print("open", flush=True)
for number in range(1_000_000):
    history.add_event("alarm", "overload", f"raised {number}", parameters={"state": "raised"})
    print(number, flush=True)
"""
END_NS = 1 << 62


def open_history(folder: Path) -> Historian:
    return Historian(folder, HistorySettings(reserve_mib=1))


def test_the_journal_is_paged_in_order_and_holds_alarms_only(tmp_path: Path) -> None:
    history = open_history(tmp_path)
    for k in range(25):
        history.add_event("alarm" if k % 5 else "note", f"a{k % 2}", f"text {k}", wall_ns=1000 + k)
    pages, after = [], 0
    while page := history.alarm_journal(0, END_NS, after, 7):
        pages.append(page)
        after = page[-1].number
    entries = [event for page in pages for event in page]
    assert [len(page) for page in pages] == [7, 7, 6]
    assert [event.text for event in entries] == [f"text {k}" for k in range(25) if k % 5]
    assert [event.number for event in entries] == sorted(event.number for event in entries)
    assert {event.name for event in history.alarm_journal(0, END_NS, name="a1")} == {"a1"}
    assert [event.wall_ns for event in history.alarm_journal(1003, 1007)] == [1003, 1004, 1006]
    assert [event.text for event in history.alarm_journal(0, END_NS, limit=2, newest=True)] == [
        "text 24",
        "text 23",
    ]
    history.close()


def test_every_entry_that_was_written_is_there_after_a_kill(tmp_path: Path) -> None:
    done = -1
    for _ in range(2 if THOROUGH else 1):
        command = [sys.executable, "-c", WRITER, str(tmp_path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None and process.stdout.readline() == "open\n"
            time.sleep(0.15)
            os.kill(process.pid, signal.SIGKILL)
            lines = process.stdout.read().split()
        history = open_history(tmp_path)
        texts = [event.text for event in history.alarm_journal(0, END_NS, limit=1_000_000)]
        history.close()
        written = len(lines)
        assert written > 3 and len(texts) - (done + 1) in (
            written,
            written + 1,
        )  # the last one may not have been told
        assert texts[done + 1 :][:written] == [f"raised {k}" for k in range(written)]
        done = len(texts) - 1
