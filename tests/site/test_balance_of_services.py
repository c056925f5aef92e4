"""Balances over HTTP: two services whose flows are the truth, one behind the other by a known time.

All records lie in the past, so that no test waits for a clock: the ledgers, not the time, decide what is known.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.ledger import BeltRecord, FlowRecord
from beltscape.site.balance import BalanceResult
from beltscape.site.run import RunningSite
from tests.protocols.broker import wait_until
from tests.site.services import Belt, run, serve_belts, write_site

pytest.importorskip("httpx", reason="httpx is not installed; pip install 'beltscape[site]' brings it")

STEP_S, MINUTES, WINDOW_MIN = 0.5, 14, 2
DELAYS_S = {"a": 42.0, "c": 12.5}
"""From belt a to the transfer point, and from there to the measuring place of belt c."""
DENSITY_T_M3, SIGMA, DELAY_SIGMA_S = 1.6, 0.01, 0.5
ERRORS = {"a": 0.006, "c": -0.007}
"""Relative error of each machine, common to all of its records: within its σ of 1 %."""
BALANCE = f"""
clock_s = 60
[[balances]]
name = "tower"
inflow = ["a"]
outflow = ["c"]
delay_s = {{a = {DELAYS_S["a"]}, c = {DELAYS_S["c"]}}}
delay_sigma_s = {DELAY_SIGMA_S}
window_min = {WINDOW_MIN}
"""


def feed(t_s: np.ndarray | float) -> np.ndarray:
    """Return the flow at the transfer point, m³/s: waves, and a feeder that stops for half a minute."""
    flow = 0.2 + 0.08 * np.sin(np.asarray(t_s) / 9) + 0.05 * np.sin(np.asarray(t_s) / 41)
    return np.where((np.asarray(t_s) > 500) & (np.asarray(t_s) < 530), 0.0, flow)


def integrate(from_s: float, to_s: float) -> float:
    """Return the volume that passes the transfer point, m³."""
    times = np.arange(from_s, to_s, 0.01) + 0.005
    return float(feed(times).sum() * 0.01)


@dataclass
class Ledgers:
    """Two belts whose ledgers the test writes, and the second in which they begin."""

    belts: dict[str, Belt]
    begin_s: int

    def measure(self, name: str, from_min: float, to_min: float) -> None:
        """Write the records of a time; the flow is that of the transfer point, earlier or later by the delay."""
        history, run_number = self.belts[name].parts.history, self.belts[name].parts.history.ledger_end.number
        lead_s = DELAYS_S["a"] if name == "a" else -DELAYS_S["c"]
        steps = np.arange(round(from_min * 60 / STEP_S), round(to_min * 60 / STEP_S))
        volumes = [integrate(k * STEP_S + lead_s, (k + 1) * STEP_S + lead_s) for k in steps]
        records = [
            self._make_record(
                run_number + n + 1, (k + 1) * STEP_S, volume * (1 + ERRORS[name]), self.runs[name]
            )
            for n, (k, volume) in enumerate(zip(steps, volumes, strict=True))
        ]
        history.write(records)

    def __post_init__(self) -> None:
        self.runs = dict.fromkeys(self.belts, 1)

    def begin_run(self, name: str) -> None:
        """Let the belt's program start anew."""
        self.runs[name] = self.belts[name].parts.history.begin_run()

    def _make_record(self, number: int, end_s: float, volume_m3: float, run_number: int) -> BeltRecord:
        belt = ((number - 1) * 1000.0, number * 1000.0)
        mm3 = volume_m3 * 1e9
        strip = FlowRecord(
            f"{number:06d}",
            None,
            belt[1],
            belt,
            mm3 / 1000.0,
            mm3,
            mm3 * SIGMA,
            2000.0,
            DENSITY_T_M3 * 1e3,
            0.9,
            0.9,
            "measured",
        )
        # the record's time lies within its last second; half a step before its end, its second is that of its belt
        wall_ns = round((self.begin_s + end_s - STEP_S / 2) * 1e9)
        return BeltRecord(number, run_number, belt, "valid", "", wall_ns, strip, 0.0, 5, None)


@pytest.fixture
def ledgers(tmp_path: Path) -> Iterator[Ledgers]:
    with serve_belts(tmp_path, "ac") as belts:
        yield Ledgers(belts, (int(time.time()) - 3600) // 120 * 120)


def read_results(running: RunningSite) -> list[BalanceResult]:
    return running.state.store.read_balances("tower", 100)


def check_result(result: BalanceResult, begin_s: int) -> float:
    """Compare a window with the truth; return how many σ inflow and outflow differ."""
    window_s = result.start_ms / 1000 - begin_s, result.end_ms / 1000 - begin_s
    truth_t = integrate(*window_s) * DENSITY_T_M3
    assert result.state == "balanced", result
    assert result.inflow is not None and result.outflow is not None and result.sigma is not None
    assert result.inflow == pytest.approx(truth_t * (1 + ERRORS["a"]), rel=0.004)
    assert result.outflow == pytest.approx(truth_t * (1 + ERRORS["c"]), rel=0.004)
    # the flow at an edge is a mean over 10 s
    edges = [integrate(t_s - 5, t_s + 5) / 10 for t_s in window_s]
    shifts_t = (edges[1] - edges[0]) * DENSITY_T_M3 * DELAY_SIGMA_S
    sigma_t = math.hypot(SIGMA * result.inflow, SIGMA * result.outflow, shifts_t, shifts_t)
    assert result.sigma == pytest.approx(sigma_t, rel=0.02)
    return (result.inflow - result.outflow) / result.sigma


def test_what_passes_one_service_passes_the_other_after_the_delay(ledgers: Ledgers, tmp_path: Path) -> None:
    for name in "ac":
        ledgers.measure(name, 0, MINUTES)
    with run(write_site(tmp_path, ledgers.belts, BALANCE, away_s=60)) as (running, _):
        wait_until(lambda: len(read_results(running)) == 5)
        deviations = [check_result(result, ledgers.begin_s) for result in read_results(running)]
    expected = (ERRORS["a"] - ERRORS["c"]) / SIGMA / math.sqrt(2)  # of windows whose edges have the same flow
    assert max(deviations) == pytest.approx(expected, rel=0.1)


@pytest.mark.thorough
def test_a_service_that_was_away_is_balanced_when_it_is_back(ledgers: Ledgers, tmp_path: Path) -> None:
    ledgers.measure("a", 0, 6)
    ledgers.measure("c", 0, 6)
    path = write_site(tmp_path, ledgers.belts, BALANCE, away_s=1)
    with run(path) as (running, show):
        wait_until(lambda: len(read_results(running)) == 1)
        ledgers.belts["c"].stop()
        ledgers.measure("a", 6, MINUTES)
        ledgers.measure("c", 6, 10)  # it goes on by itself
        wait_until(lambda: show("c")["is_away"])
        wait_until(lambda: running.state.take_snapshot()["balances"][0]["waits_for"] == ("c",))
        assert len(read_results(running)) == 1
        ledgers.belts["c"].start()
        wait_until(lambda: len(read_results(running)) == 3)
    ledgers.measure("c", 10, MINUTES)  # now the site is away
    with run(path) as (running, _):
        wait_until(lambda: len(read_results(running)) == 5)
        for result in read_results(running):
            check_result(result, ledgers.begin_s)


@pytest.mark.thorough
def test_windows_in_which_a_program_did_not_run_are_incomplete_and_no_others(
    ledgers: Ledgers, tmp_path: Path
) -> None:
    ledgers.measure("a", 0, MINUTES)
    ledgers.measure("c", 0, 7)
    ledgers.begin_run("c")
    ledgers.measure("c", 7.75, MINUTES)
    with run(write_site(tmp_path, ledgers.belts, BALANCE, away_s=60)) as (running, _):
        wait_until(lambda: len(read_results(running)) == 5)
        results = read_results(running)
    states = [(one.state, one.reason, one.belt) for one in results]
    assert (
        states
        == [("balanced", "", "")] * 2 + [("incomplete", "not_running", "c")] + [("balanced", "", "")] * 2
    )
    for result in results:
        if result.state == "balanced":
            check_result(result, ledgers.begin_s)
