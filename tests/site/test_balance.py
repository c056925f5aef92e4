"""Balances over transfer points against flows whose truth is known."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import pytest

from beltscape.site.balancing import Balancer
from beltscape.site.catch_up import Gap, sum_records
from beltscape.site.settings import SiteSettings
from beltscape.site.store import SiteStore
from tests.site.belts import START_MS, make_record, make_site

STEP_MS = 200
MINUTES = 20


def flow(t_s: float, seed: int) -> float:
    """Return a feed that varies, m³/s: waves of one to five minutes, and a stop of the feeder."""
    wave = 0.2 + 0.08 * math.sin(t_s / 11 + seed) + 0.05 * math.sin(t_s / 47 + 2 * seed)
    return 0.0 if 500 + 60 * seed < t_s < 560 + 60 * seed else wave


def fill(
    store: SiteStore, belt: str, volume_of: Any, *, gain: float = 1.0, until_min: float = MINUTES
) -> None:
    """Give a belt the records of a flow; the ledger is known to its end."""
    rng = random.Random(belt)
    step_s = STEP_MS / 1000
    volumes = [
        gain * volume_of(n * step_s) * step_s * rng.gauss(1, 0.005)
        for n in range(round(until_min * 60 / step_s))
    ]
    records = [make_record(n + 1, START_MS + n * STEP_MS, volume) for n, volume in enumerate(volumes)]
    batch = sum_records(None, records, None)
    assert batch is not None
    store.add(belt, store.read_cursor(belt), batch)
    store.set_complete(belt, batch.cursor.wall_ms)


def make_point(store: SiteStore, **more: Any) -> tuple[SiteSettings, Balancer]:
    balance = {
        "name": "tower", "inflow": ["a", "b"], "outflow": ["c"], "window_min": 2, "sigmas": 3,
        "delay_s": {"a": 35.0, "b": 12.5, "c": 8.0}, **more,
    }  # fmt: skip
    site = make_site("a", "b", "c", balances=[balance])
    return site, Balancer(site, site.balances[0], store)


def merged(t_s: float) -> float:
    """Return the flow on belt c: both feeds after their delays."""
    return flow(t_s - 35.0 - 8.0, 1) + flow(t_s - 12.5 - 8.0, 2)


@pytest.fixture
def store(tmp_path: Path) -> SiteStore:
    one = SiteStore(tmp_path)
    fill(one, "a", lambda t_s: flow(t_s, 1))
    fill(one, "b", lambda t_s: flow(t_s, 2))
    return one


NOW_MS = START_MS + (MINUTES + 1) * 60_000


@pytest.mark.parametrize("quantity", ["mass", "volume"])
def test_what_comes_in_goes_out_after_the_delay(store: SiteStore, quantity: str) -> None:
    fill(store, "c", merged)
    _, balancer = make_point(store, quantity=quantity)
    status = balancer.update(NOW_MS)
    results = store.read_balances("tower", 100)
    assert len(results) == 8
    assert {one.state for one in results} == {"balanced"}
    assert status.last == results[-1]
    for one in results:
        assert one.inflow is not None
        assert one.outflow is not None
        assert one.sigma is not None
        assert abs(one.inflow - one.outflow) < 2 * one.sigma
        assert one.sigma < 0.03 * one.inflow + 0.2


def test_without_the_delay_the_same_belts_seem_out_of_balance(store: SiteStore) -> None:
    fill(store, "c", merged)
    _, balancer = make_point(store, delay_s={}, delay_sigma_s=0)
    balancer.update(NOW_MS)
    assert "imbalance" in {one.state for one in store.read_balances("tower", 100)}


def test_spillage_is_an_imbalance(store: SiteStore) -> None:
    fill(store, "c", merged, gain=0.9)
    _, balancer = make_point(store)
    assert {one.state for one in store.read_balances("tower", 100)} == set()
    balancer.update(NOW_MS)
    states = [one.state for one in store.read_balances("tower", 100)]
    assert states.count("imbalance") >= 6


def test_what_the_belts_cannot_know_widens_the_limit(store: SiteStore) -> None:
    fill(store, "c", merged, gain=0.9)
    _, balancer = make_point(store, relative_sigma=0.05)
    balancer.update(NOW_MS)
    assert {one.state for one in store.read_balances("tower", 100)} == {"balanced"}


def test_a_belt_that_is_away_is_waited_for_and_then_balanced(store: SiteStore) -> None:
    fill(store, "c", merged, until_min=9)
    _, balancer = make_point(store)
    status = balancer.update(NOW_MS)
    assert status.waits_for == ("c",)
    before = len(store.read_balances("tower", 100))
    assert before < 5
    again = SiteStore(store._path.parent)  # as after a restart of the site
    _, balancer = make_point(again)
    records = [
        make_record(n + 1, START_MS + n * STEP_MS, merged(n * 0.2) * 0.2)
        for n in range(9 * 300, MINUTES * 300)
    ]
    batch = sum_records(again.read_cursor("c"), records, None)
    assert batch is not None
    again.add("c", again.read_cursor("c"), batch)
    again.set_complete("c", batch.cursor.wall_ms)
    balancer.update(NOW_MS)
    assert [one.state for one in again.read_balances("tower", 100)] == ["balanced"] * 8


def test_a_belt_that_never_comes_back_does_not_hold_the_balance_for_ever(store: SiteStore) -> None:
    fill(store, "c", merged, until_min=9)
    site, balancer = make_point(store)
    balancer.update(NOW_MS + round(site.keep_days * 86_400_000))
    first = next(one for one in store.read_balances("tower", 1000) if one.state != "balanced")
    assert (first.state, first.reason, first.belt) == ("incomplete", "away", "c")


@pytest.mark.parametrize("reason", ["not_running", "missing", "clock", "replaced"])
def test_a_window_with_a_gap_is_no_imbalance(store: SiteStore, reason: Any) -> None:
    fill(store, "c", lambda t_s: 0.0 if 300 < t_s < 400 else merged(t_s))
    store.add_gap("c", Gap(START_MS + 300_000, START_MS + 400_000, reason))
    _, balancer = make_point(store)
    balancer.update(NOW_MS)
    results = store.read_balances("tower", 100)
    assert "imbalance" not in {one.state for one in results}
    assert {(one.reason, one.belt) for one in results if one.state == "incomplete"} == {(reason, "c")}


def test_unmeasured_belt_and_unknown_densities_are_no_imbalance(store: SiteStore) -> None:
    lacks = ({"mass_t": None} if n < 2000 else {"standing": "missing"} for n in range(MINUTES * 300))
    records = [make_record(n + 1, START_MS + n * STEP_MS, 0.08, **one) for n, one in enumerate(lacks)]
    batch = sum_records(None, records, None)
    assert batch is not None
    store.add("c", store.read_cursor("c"), batch)
    store.set_complete("c", batch.cursor.wall_ms)
    _, balancer = make_point(store)
    balancer.update(NOW_MS)
    results = store.read_balances("tower", 100)
    assert {one.state for one in results} == {"incomplete"}
    assert {one.reason for one in results} == {"density", "unmeasured"}


def test_sigma_is_that_of_the_belts_and_the_share(store: SiteStore) -> None:
    fill(store, "c", merged)
    _, balancer = make_point(store, delay_sigma_s=0, relative_sigma=0.02)
    balancer.update(NOW_MS)
    one = store.read_balances("tower", 100)[0]
    assert one.inflow is not None
    assert one.outflow is not None
    assert one.sigma is not None
    known = math.hypot(0.02 * (one.inflow + one.outflow) / 2, 0.01 * one.outflow)
    assert known < one.sigma <= math.hypot(known, 0.01 * one.inflow)
