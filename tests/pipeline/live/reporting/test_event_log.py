"""Events on their way to the history: nobody waits for the disk, and none is lost or doubled."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from beltscape.core.errors import OutputError
from beltscape.pipeline.live import event_log
from beltscape.pipeline.live.event_log import EventLog
from beltscape.pipeline.live.writer import BATCH
from beltscape.sinks.historian import NewEvent
from tests.protocols.broker import wait_until


class Held:
    """A history that refuses events until another program lets it go."""

    def __init__(self) -> None:
        self.is_held, self.events, self.refused = True, list[NewEvent](), threading.Event()

    def add_events(self, events: Sequence[NewEvent]) -> None:
        if self.is_held:
            self.refused.set()
            raise OutputError("history.db: another program holds history.db; close it there")
        self.events += events


def open_log() -> tuple[EventLog, Held]:
    held: Any = Held()
    return EventLog(held), held


def test_refused_events_are_stored_in_their_order_when_the_lock_is_gone() -> None:
    log, held = open_log()
    for number in range(5):
        log.add("alarm", f"a{number}", "raised", number)
    assert held.refused.wait(120)
    log.add("alarm", "a5", "acknowledged", 5, by="ana")  # a person waits for a second at most
    wait_until(lambda: "another program holds" in log.trouble)
    assert held.events == [] and not log.wait(0.05)
    held.is_held = False
    assert log.wait(120) and log.trouble == ""
    assert [one.name for one in held.events] == [f"a{number}" for number in range(6)]
    assert log.close() == 0


def test_a_persons_event_is_stored_when_it_returns() -> None:
    log, held = open_log()
    held.is_held = False
    for number in range(20):
        log.add("alarm", str(number), "acknowledged", 5, by="ana")
        assert len(held.events) == number + 1
    assert log.close() == 0


def test_their_number_is_bounded_and_none_that_is_being_written_is_dropped(monkeypatch) -> None:
    monkeypatch.setattr(event_log, "_CAPACITY", BATCH + 10)
    log, held = open_log()
    for number in range(2 * BATCH):
        log.add("alarm", str(number), "raised", number)
    assert held.refused.wait(120)
    held.is_held = False
    assert log.wait(120)
    names = [int(one.name) for one in held.events]
    assert names == sorted(names) and names[:BATCH] == list(range(BATCH))
    assert names[BATCH:] == list(range(2 * BATCH - 10, 2 * BATCH))
    assert log.close() == 0
