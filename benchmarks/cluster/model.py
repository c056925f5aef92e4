"""How a re-processing scales: an analytic model of its throughput, and a discrete-event simulation that checks it.

A worker takes a piece, sets up, and measures it while its images are read ahead from one store that all workers
share; the driver stores every result, one after the other, and hands out the next piece. The time of a piece is drawn
from the measured ones. Where the demand on the store is above its rate, all readers slow down alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_AHEAD = 2
"""Pieces handed out for each worker, as `beltscape.workers.tasks` does."""


@dataclass(frozen=True)
class Costs:
    """What was measured."""

    piece_s: Sequence[float]
    """Times of pieces on one worker, the setup included: the distribution that is drawn from."""
    piece_bytes: float
    """Bytes that a piece reads."""
    driver_s: float
    """Time of the driver for each piece: to store its result, and to hand out another."""


@dataclass(frozen=True)
class Scaling:
    """Throughput with a number of workers."""

    workers: int
    pieces_per_s: float
    efficiency: float
    """Throughput over that of the same number of workers that never wait."""
    bound: str
    """What bounds it: workers, store or driver."""


def predict(costs: Costs, workers: int, store_bytes_per_s: float) -> Scaling:
    """Return the throughput by the slowest of the three parts."""
    mean_s = float(np.mean(costs.piece_s))
    rates = {
        "workers": workers / mean_s,
        "store": store_bytes_per_s / costs.piece_bytes,
        "driver": 1 / costs.driver_s,
    }
    bound = min(rates, key=lambda name: rates[name])
    return Scaling(workers, rates[bound], rates[bound] * mean_s / workers, bound)


def simulate(costs: Costs, workers: int, store_bytes_per_s: float, pieces: int, seed: int) -> Scaling:
    """Return the throughput of a simulated run, from its begin to its last piece."""
    rng = np.random.default_rng(seed)
    seconds = rng.choice(np.asarray(costs.piece_s, float), pieces)
    left = np.full(workers, np.nan)  # share of the present piece that is left; NaN: idle
    needs_s = np.ones(workers)  # time of the present piece without waiting for the store
    handed = min(pieces, _AHEAD * workers)
    queued = [handed // workers + (worker < handed % workers) for worker in range(workers)]
    clock, stored = 0.0, 0
    to_store: list[int] = []  # workers whose results wait for the driver
    driver_until = np.inf
    started = 0
    while stored < pieces:
        for worker in np.flatnonzero(np.isnan(left)).tolist():
            if queued[worker]:
                queued[worker] -= 1
                left[worker], needs_s[worker], started = 1.0, seconds[started], started + 1
        active = np.flatnonzero(~np.isnan(left))
        if to_store and driver_until == np.inf:
            driver_until = clock + costs.driver_s
        rates = _share_store(1 / needs_s[active], store_bytes_per_s / costs.piece_bytes)
        steps = left[active] / rates if len(active) else np.array([np.inf])
        step = min(float(steps.min()), driver_until - clock)
        clock += step
        left[active] -= rates * step
        for worker in active[left[active] <= 1e-12].tolist():
            left[worker] = np.nan
            to_store.append(worker)
        if driver_until <= clock:
            worker, driver_until, stored = to_store.pop(0), np.inf, stored + 1
            if handed < pieces:
                queued[worker], handed = queued[worker] + 1, handed + 1
    rate = pieces / clock
    return Scaling(workers, rate, rate * float(np.mean(costs.piece_s)) / workers, "")


def _share_store(wanted: np.ndarray, capacity: float) -> np.ndarray:
    """Return the rates (pieces per s) of readers that share a store fairly: none gets more than it wants."""
    rates, order, left = np.zeros(len(wanted)), np.argsort(wanted), capacity
    for rank, index in enumerate(order.tolist()):
        rates[index] = min(wanted[index], left / (len(wanted) - rank))
        left -= rates[index]
    return rates
