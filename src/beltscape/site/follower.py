"""The follower of one belt: a thread that reads its state and fetches its ledger, and says what is wrong with it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event, Lock
from typing import Protocol

from beltscape import __version__
from beltscape.core.errors import InputError, OutputError
from beltscape.core.supervision import make_supervised_thread
from beltscape.site.catch_up import Cursor, Gap, find_break, sum_records
from beltscape.site.client import (
    RECORDS,
    BeltClient,
    BeltFault,
    BeltFaultError,
    PageAnswer,
    RecordAnswer,
    StateAnswer,
)
from beltscape.site.settings import SiteBeltSettings, SiteSettings
from beltscape.site.store import SiteStore

_PAUSES_S = (1.0, 2.0, 5.0, 10.0)
"""Pauses between attempts to reach a belt; the last one repeats."""
_STOPPED_M_S = 0.001
"""A slower belt stands still, as on the belt's own page."""
_SETTLE_MS = 10_000
"""Time within which a record reaches the ledger: measurement and writing take less."""
_DAY_MS = 86_400_000
"""Milliseconds of a day."""
_LEDGER_S = 3600.0
"""Time for which a break of a ledger is shown."""
_CATCH_UP_S = 1.0
"""Time for fetching records between two readings of the state, so that the flow stays current meanwhile. Chosen."""


class Client(Protocol):
    """A reader of one belt, such as BeltClient."""

    def read_page(self) -> PageAnswer:
        """Return the settings of its page."""
        ...

    def read_state(self) -> StateAnswer:
        """Return its state."""
        ...

    def read_records(self, after: int, since_ms: int) -> list[RecordAnswer]:
        """Return records of its ledger."""
        ...

    def close(self) -> None:
        """Close the connections."""
        ...


@dataclass(frozen=True, slots=True)
class BeltView:
    """Present state of a belt, as far as the site has read it."""

    settings: SiteBeltSettings
    page: PageAnswer | None
    state: StateAnswer | None
    """The last state that was read."""
    age_s: float | None
    """Seconds since it was read; None: never."""
    is_away: bool
    """Whether there is no current state."""
    faults: tuple[BeltFault, ...]
    """What is wrong with it."""
    waiting: int
    """Records of its ledger that are not fetched yet."""


class BeltFollower:
    """Follows one belt until it is closed."""

    def __init__(
        self,
        site: SiteSettings,
        settings: SiteBeltSettings,
        store: SiteStore,
        on_message: Callable[[str], None],
        make_client: Callable[[SiteBeltSettings], Client] = BeltClient,
    ) -> None:
        self.settings = settings
        self._site, self._store, self._on_message = site, store, on_message
        self._make_client = make_client
        self._lock, self._stop = Lock(), Event()
        self._page: PageAnswer | None = None
        self._state: StateAnswer | None = None
        self._state_s = self._state_wall_ms = 0.0
        self._faults: dict[str, BeltFault] = {}
        self._since_ms = round(time.time() * 1000 - site.first_days * _DAY_MS)
        self._clock_right_ms = round(time.time() * 1000)
        self._misplaced: tuple[int, int] | None = None
        self._ledger_s = 0.0
        self._thread = make_supervised_thread(
            f"belt-{settings.name}",
            self._run,
            lambda failure: on_message(f"{settings.name}: {failure}"),
            self._stop.wait,
        )

    def start(self) -> None:
        """Start; returns at once."""
        self._thread.start()

    def close(self, patience_s: float = 3.0) -> None:
        """Stop following."""
        self._stop.set()
        self._thread.join(patience_s)

    def take_view(self) -> BeltView:
        """Return what is known of the belt now."""
        cursor = self._store.read_cursor(self.settings.name)
        with self._lock:
            age_s = None if self._state is None else time.monotonic() - self._state_s
            record = 0 if self._state is None else self._state.record or 0
            return BeltView(
                self.settings,
                self._page,
                self._state,
                age_s,
                age_s is None or age_s > max(self._site.away_s, 2 * self._site.poll_s),
                tuple(self._faults.values()),
                max(0, record - cursor.number) if cursor is not None else 0,
            )

    def _run(self) -> None:
        attempt = 0
        while not self._stop.is_set():
            started_s = time.monotonic()
            wait_s = self._follow_until_broken()
            attempt = 0 if time.monotonic() - started_s > _PAUSES_S[-1] else attempt
            self._stop.wait(max(wait_s, _PAUSES_S[min(attempt, len(_PAUSES_S) - 1)]))
            attempt += 1

    def _follow_until_broken(self) -> float:
        """Poll the belt until it cannot be read; keep why, and return the least seconds until the next attempt."""
        try:
            client = self._make_client(self.settings)
        except InputError:
            self._set_fault("connection", BeltFault("key", {"url": self.settings.url}))
            return 0.0
        try:
            self._read_page(client)
            self._set_fault("connection", None)
            while not self._stop.is_set():
                started_s = time.monotonic()
                self.poll(client)
                self._stop.wait(max(0.0, self._site.poll_s - (time.monotonic() - started_s)))
        except BeltFaultError as error:
            self._set_fault("connection", error.fault)
            return error.wait_s
        except OutputError as error:
            self._set_fault("store", BeltFault("store", {"reason": str(error)}))
        finally:
            client.close()
        return 0.0

    def _read_page(self, client: Client) -> None:
        page = client.read_page()
        with self._lock:
            self._page = page
        is_other = page.version.split(".")[:2] != __version__.split(".")[:2]
        fault = BeltFault("version", {"version": page.version, "own": __version__}) if is_other else None
        self._set_fault("version", fault)

    def poll(self, client: Client) -> None:
        """Read the state and the records behind the cursor once; BeltFaultError where the belt cannot be read."""
        before_s = time.time()
        state = client.read_state()
        half_s = (time.time() - before_s) / 2
        offset_s = state.wall_ms / 1000 - (before_s + half_s)
        with self._lock:
            self._state, self._state_s = state, time.monotonic()
        # the clock was read at an unknown moment of a slow answer
        is_right = abs(offset_s) - half_s <= self._site.clock_s
        self._set_fault("clock", None if is_right else BeltFault("clock", {"offset_s": offset_s}))
        stale_s = state.stale_s or (5.0 if self._page is None else self._page.stale_s)
        age_s = state.frames.age_s
        is_stale = age_s is not None and age_s > stale_s and not _is_stopped(state)
        self._set_fault("frames", BeltFault("no_frames", {"age_s": age_s or 0.0}) if is_stale else None)
        is_caught_up, times = self._fetch(client)
        self._note_clock(times, is_right=is_right)
        self._set_fault("store", None)
        if is_caught_up and is_right:
            self._set_complete(state, stale_s)

    def _fetch(self, client: Client) -> tuple[bool, tuple[int, int] | None]:
        """Fetch records; return whether all were fetched, and the earliest and the latest time of them."""
        name, end_s = self.settings.name, time.monotonic() + _CATCH_UP_S
        times: list[int] = []
        while True:
            cursor = self._store.read_cursor(name)
            records, broken, is_full = self._read_new(client, cursor)
            self._set_ledger_fault(broken)
            batch = sum_records(cursor, records, broken)
            if batch is not None:
                self._store.add(name, cursor, batch)
                times += [min(batch.seconds) * 1000, max(batch.seconds) * 1000 + 1000]
            if not is_full or time.monotonic() > end_s or self._stop.is_set():
                return not is_full, (min(times), max(times)) if times else None

    def _read_new(
        self, client: Client, cursor: Cursor | None
    ) -> tuple[list[RecordAnswer], BeltFault | None, bool]:
        """Return the next records, why the ledger does not go on behind the cursor, and whether there are more."""
        if cursor is None:
            records = client.read_records(0, self._since_ms)
            return records, None, len(records) >= RECORDS
        records = client.read_records(max(cursor.number - 1, 0), 0)
        broken = find_break(cursor, records)
        if broken is not None and broken.key == "replaced":
            records = client.read_records(0, cursor.wall_ms + 1)
        is_full = len(records) >= RECORDS
        return records[1:] if broken is None else records, broken, is_full

    def _set_ledger_fault(self, broken: BeltFault | None) -> None:
        """Keep a break of the ledger among the faults for some time, since it is over at once."""
        if broken is not None:
            self._ledger_s = time.monotonic()
            self._set_fault("ledger", broken)
        elif time.monotonic() - self._ledger_s > _LEDGER_S:
            self._set_fault("ledger", None)

    def _note_clock(self, times: tuple[int, int] | None, *, is_right: bool) -> None:
        """Keep the periods in which a wrong clock puts records, and from which it takes them, as gaps."""
        now_ms = round(time.time() * 1000)
        if is_right:
            self._clock_right_ms, self._misplaced = now_ms, None
        elif times is not None:
            before = self._misplaced or times
            self._misplaced = min(before[0], times[0]), max(before[1], times[1])
            self._store.add_gap(self.settings.name, Gap(*self._misplaced, "clock"))
            self._store.add_gap(self.settings.name, Gap(self._clock_right_ms, now_ms, "clock"))

    def _set_complete(self, state: StateAnswer, stale_s: float) -> None:
        """Record up to which time the ledger is known: to its last record, or to now where the belt stands still."""
        cursor = self._store.read_cursor(self.settings.name)
        if cursor is None:
            return
        is_current = state.frames.age_s is not None and state.frames.age_s <= stale_s
        complete_ms = cursor.wall_ms
        if is_current and _is_stopped(state):
            complete_ms = max(complete_ms, state.wall_ms - _SETTLE_MS)
        self._store.set_complete(self.settings.name, complete_ms)

    def _set_fault(self, place: str, fault: BeltFault | None) -> None:
        """Keep a fault, and report its beginning and its end."""
        with self._lock:
            before = self._faults.pop(place, None)
            if fault is not None:
                self._faults[place] = fault
        if fault is not None and (before is None or before.key != fault.key):
            self._on_message(f"{self.settings.name}: {fault.text}")
        elif fault is None and before is not None:
            self._on_message(f"{self.settings.name}: no longer: {before.text}")


def _is_stopped(state: StateAnswer) -> bool:
    speed = state.frames.speed_m_s
    return speed is not None and abs(speed) < _STOPPED_M_S
