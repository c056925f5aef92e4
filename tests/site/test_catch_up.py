"""Every record of every belt counts once, whatever happens to the connection, the site and the belt."""

from __future__ import annotations

import contextlib
import random
import sqlite3
import threading
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from beltscape.core.errors import OutputError
from beltscape.site import follower as follower_module
from beltscape.site.catch_up import Cursor, Gap, PieceSums, RecordSums
from beltscape.site.client import BeltFaultError, RecordAnswer
from beltscape.site.follower import BeltFollower
from beltscape.site.store import FILE, SiteStore
from tests.protocols.broker import wait_until
from tests.site.belts import START_MS, FakeBelt, make_record, make_site

ALL = 0, 1 << 50


@pytest.fixture(autouse=True)
def _now(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this machine's clock show the time of the records."""
    monkeypatch.setattr(follower_module.time, "time", lambda: START_MS / 1000 + 1)


def make_follower(folder: Path, store: SiteStore, messages: list[str] | None = None) -> BeltFollower:
    site = make_site("a", first_days=1)
    return BeltFollower(site, site.belts[0], store, [].append if messages is None else messages.append)


def count(store: SiteStore) -> RecordSums:
    """Return the sums of all quarters, which agree with those of all seconds."""
    total, by_seconds = RecordSums(), RecordSums()
    for sums in store.read_quarters("a", *ALL).values():
        total += sums
    for sums in store.read_seconds("a", *ALL).values():
        by_seconds += sums
    assert total.records == by_seconds.records
    assert total.volume_m3 == pytest.approx(by_seconds.volume_m3)
    return total


def test_the_sums_of_a_newer_version_stay_as_they_are(tmp_path: Path) -> None:
    SiteStore(tmp_path).close()
    path = tmp_path / FILE
    with contextlib.closing(sqlite3.connect(path)) as newer:
        newer.execute("PRAGMA user_version = 2")
    for _ in range(2):  # the first refusal must not make it this version's
        with pytest.raises(
            OutputError, match=r"site\.db: is of a newer version of Beltscape; update this one"
        ):
            SiteStore(tmp_path)


def test_every_record_counts_once_over_lost_answers_and_killed_sites(tmp_path: Path) -> None:
    rng, belt = random.Random(11), FakeBelt(3)
    belt.broken, belt.limit = 0.4, 40
    store = SiteStore(tmp_path)
    follower = make_follower(tmp_path, store)
    number = 0
    for _ in range(150):
        for _ in range(rng.randint(0, 30)):
            number += 1
            belt.records.append(make_record(number, START_MS + number * 170, rng.uniform(0, 0.2)))
        with contextlib.suppress(BeltFaultError):
            follower.poll(belt)
        if rng.random() < 0.2:  # the site is killed: nothing is closed, and another one opens the same file
            store = SiteStore(tmp_path)
            follower = make_follower(tmp_path, store)
    belt.broken, belt.limit = 0.0, 1000
    follower.poll(belt)
    total = count(store)
    assert total.records == number
    assert total.volume_m3 == pytest.approx(sum(one.volume_m3 or 0 for one in belt.records))
    assert total.valid_m == pytest.approx(0.5 * number)


def test_hours_without_the_connection_are_made_up_for(tmp_path: Path) -> None:
    belt, store = FakeBelt(), SiteStore(tmp_path)
    follower = make_follower(tmp_path, store)
    belt.records = [make_record(n, START_MS + n * 200) for n in range(1, 11)]
    follower.poll(belt)
    belt.records += [make_record(n, START_MS + n * 200) for n in range(11, 25_001)]
    while count(store).records < 25_000:
        follower.poll(belt)
    assert follower.take_view().waiting == 0
    assert count(store).records == 25_000
    assert belt.requests < 80


def test_only_the_last_days_of_an_old_ledger_are_fetched(tmp_path: Path) -> None:
    belt, store = FakeBelt(), SiteStore(tmp_path)
    day_ms = 86_400_000
    belt.records = [make_record(n, START_MS + n * 200 - (2 * day_ms if n <= 50 else 0)) for n in range(1, 81)]
    make_follower(tmp_path, store).poll(belt)
    assert count(store).records == 30


def test_a_replaced_ledger_is_named_and_neither_loses_nor_doubles(tmp_path: Path) -> None:
    belt, store, messages = FakeBelt(), SiteStore(tmp_path), []
    follower = make_follower(tmp_path, store, messages)
    belt.records = [make_record(n, START_MS + n * 200) for n in range(1, 101)]
    follower.poll(belt)
    belt.records = belt.records[:60]  # a backup of an earlier time
    follower.poll(belt)
    belt.records += [make_record(n, START_MS + 40_000 + n * 200, run=2) for n in range(61, 81)]
    follower.poll(belt)
    assert any("its ledger was replaced: record 100" in text for text in messages)
    assert count(store).records == 120
    belt.records = [make_record(n, START_MS + 90_000 + n * 200, 0.07) for n in range(1, 201)]  # an empty one
    follower.poll(belt)
    assert count(store).records == 320
    assert {gap.reason for gap in store.read_gaps("a", *ALL)} == {"replaced"}


def test_records_that_are_gone_are_named(tmp_path: Path) -> None:
    belt, store, messages = FakeBelt(), SiteStore(tmp_path), []
    follower = make_follower(tmp_path, store, messages)
    belt.records = [make_record(n, START_MS + n * 200) for n in range(1, 11)]
    follower.poll(belt)
    belt.records = [make_record(n, START_MS + n * 200) for n in range(31, 41)]
    follower.poll(belt)
    assert any("no longer holds the records 11 to 30" in text for text in messages)
    assert count(store).records == 20


def test_restarts_and_missing_belt_are_gaps(tmp_path: Path) -> None:
    belt, store = FakeBelt(), SiteStore(tmp_path)
    belt.records = [
        make_record(1, START_MS),
        make_record(2, START_MS + 200, standing="missing", volume_m3=0.0, mass_t=0.0),  # a dropped frame
        make_record(3, START_MS + 60_000, standing="missing", volume_m3=0.0, mass_t=0.0),
        make_record(4, START_MS + 60_200),
        make_record(5, START_MS + 90_000, run=2),
    ]
    make_follower(tmp_path, store).poll(belt)
    assert store.read_gaps("a", *ALL) == [
        Gap(START_MS + 200, START_MS + 60_000, "missing"),
        Gap(START_MS + 60_200, START_MS + 90_000, "not_running"),
    ]
    assert count(store).missing_m == pytest.approx(1.0)


def test_a_clock_that_is_off_is_named_and_its_ledger_is_not_complete(tmp_path: Path) -> None:
    belt, store, messages = FakeBelt(), SiteStore(tmp_path), []
    follower = make_follower(tmp_path, store, messages)
    belt.records = [make_record(1, START_MS)]
    follower.poll(belt)
    known_ms = store.read_complete_ms("a")
    belt.records += [make_record(2, START_MS + 3_600_000)]
    belt.clock_ms = START_MS + 3_601_000
    follower.poll(belt)
    assert any("its clock differs by 3600 s" in text for text in messages)
    assert store.read_complete_ms("a") == known_ms
    assert count(store).records == 2  # it counts nevertheless
    reasons = [gap.reason for gap in store.read_gaps("a", START_MS + 3_599_000, START_MS + 3_700_000)]
    assert reasons == ["clock"]
    belt.clock_ms = START_MS + 1000
    follower.poll(belt)
    assert any("no longer: its clock" in text for text in messages)


@pytest.mark.parametrize(("first_s", "is_named"), [(0.0, False), (9.0, True)])
def test_a_slow_answer_is_no_wrong_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first_s: float, *, is_named: bool
) -> None:
    """A busy belt reads its clock at the beginning of the 8 s that its answer takes, or shows a time 9 s earlier."""
    now_s = iter(
        [START_MS / 1000 + 1] * 2 + [START_MS / 1000 + 1, START_MS / 1000 + 9] + [START_MS / 1000 + 9] * 9
    )
    belt, store, messages = FakeBelt(), SiteStore(tmp_path), list[str]()
    monkeypatch.setattr(follower_module.time, "time", lambda: next(now_s))
    follower = make_follower(tmp_path, store, messages)
    belt.clock_ms = START_MS + 1000 - round(first_s * 1000)
    follower.poll(belt)
    assert any("its clock differs" in text for text in messages) == is_named


def test_answers_that_no_belt_gives_are_refused() -> None:
    good = make_record(7, START_MS).model_dump()
    bad = [
        {"number": -1}, {"number": 2**70}, {"wall_ms": -5}, {"wall_ms": 1 << 62}, {"volume_m3": float("inf")},
        {"sigma_m3": float("nan")}, {"standing": "good"}, {"from_m": "x"}, {"run": None},
    ]  # fmt: skip
    for values in bad:
        with pytest.raises(ValidationError):
            RecordAnswer.model_validate({**good, **values})


def test_sums_that_cannot_be_written_are_named_and_nothing_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    belt, store, messages = FakeBelt(), SiteStore(tmp_path), []
    belt.records = [make_record(n, START_MS + n * 200) for n in range(1, 11)]
    site = make_site("a", first_days=1)
    full = [True]

    def add(name: str, before: Cursor | None, batch: PieceSums, write: Any = store.add) -> None:
        if full[0]:
            raise OutputError("site.db: cannot be written (the disk is full)")
        write(name, before, batch)

    monkeypatch.setattr(store, "add", add)
    monkeypatch.setattr(follower_module, "_PAUSES_S", (0.02,))
    follower = BeltFollower(site, site.belts[0], store, messages.append, lambda _: belt)
    follower.start()
    wait_until(lambda: any("its sums cannot be written" in text for text in messages))
    full[0] = False
    wait_until(lambda: sum(one.records for one in store.read_seconds("a", *ALL).values()) == 10)
    wait_until(lambda: sum(one.records for one in store.read_quarters("a", *ALL).values()) == 10)
    assert count(store).records == 10
    wait_until(lambda: follower.take_view().faults == ())
    follower.close()


def test_two_sites_on_one_folder_count_no_record_twice(tmp_path: Path) -> None:
    belt, rng = FakeBelt(), random.Random(6)
    stores = [SiteStore(tmp_path), SiteStore(tmp_path)]
    followers = [make_follower(tmp_path, store) for store in stores]
    for number in range(1, 301):
        belt.records.append(make_record(number, START_MS + number * 200))
        if rng.random() < 0.2:
            threads = [threading.Thread(target=follower.poll, args=(belt,)) for follower in followers]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    followers[0].poll(belt)
    assert count(stores[1]).records == 300
