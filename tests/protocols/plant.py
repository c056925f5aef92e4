"""A running system without cameras, for the tests of the protocols."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace

from beltscape.core.alarms import Alarm
from beltscape.core.events import CameraHealth
from beltscape.core.ledger import BeltRecord, FlowRecord, Standing, Totals
from beltscape.protocols.plant import PlantState


def make_record(number: int, standing: Standing = "valid") -> BeltRecord:
    """Return a record of 20 mm of belt with 0.2 l."""
    strip = FlowRecord(
        f"{number:05d}", number * 10**8, number * 20.0, (number * 20.0, number * 20.0 + 20.0), 10_000.0, 200_000.0,
        900.0, 200.0, 850.0, 0.97, 0.9, "measured",
    )  # fmt: skip
    belt_mm = (number * 20.0, number * 20.0 + 20.0)
    return BeltRecord(number, 1, belt_mm, standing, "", 10**18 + number, strip, 900.0, 5, None)


class FakePlant:
    """A plant whose records the test adds."""

    def __init__(self) -> None:
        self._records: list[BeltRecord] = []
        self._lock = threading.Lock()
        self.state = PlantState(
            10**18, "valid", 123.4, 0.5, 104.9, 0.4, 10_000.0, 40_000.0, 0.97, float("nan"), 0, Totals(),
            (CameraHealth("cam0", "ok", 9, 0, 5.0, 0.0),),
            (Alarm("overload", "warning", "clear", float("nan"), 500.0, "m³/h", None),), "", float("nan"), (), "", "",
        )  # fmt: skip

    def add(self, count: int) -> None:
        """Add records behind the last one."""
        with self._lock:
            first = len(self._records) + 1
            self._records += [make_record(number) for number in range(first, first + count)]

    def replace_ledger(self) -> None:
        """Start the ledger at 1 again, as after the loss of the database."""
        with self._lock:
            self._records.clear()

    def read_state(self) -> PlantState:
        """Return the state with the number of the newest record."""
        return replace(self.state, record=self.read_last_number())

    def read_records(self, after: int, limit: int) -> Sequence[BeltRecord]:
        """Return records with numbers above ``after``."""
        with self._lock:
            return self._records[after : after + limit]

    def read_period(self, since_ns: int, until_ns: int, limit: int, after: int) -> Sequence[BeltRecord]:
        """Return records of a period with numbers above ``after``."""
        with self._lock:
            found = [one for one in self._records[after:] if since_ns <= one.wall_ns < until_ns]
        return found[:limit]

    def read_last_number(self) -> int:
        """Return the newest number."""
        return len(self._records)
