"""Throttling: growing delays after wrong passwords, token buckets for requests, pacing of work."""

from __future__ import annotations

import ipaddress
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

_MOST_DOUBLINGS = 30
"""Bound of the exponent, against overflow; the delays' own limits are reached far earlier."""
MAX_ENTRIES = 4096
"""Accounts and addresses that are remembered, which bounds the memory; beyond, those unused longest are forgotten."""


@dataclass(frozen=True, slots=True)
class Delays:
    """Delays after failures: none for the first ``free``, then 1, 2, 4 … seconds up to ``longest_s``."""

    free: int
    longest_s: float
    forget_s: float = 3600
    """Time without a failure after which failures are forgotten."""

    def compute_s(self, failures: int) -> float:
        """Return the seconds to wait after that many failures in a row."""
        return (
            0.0
            if failures < self.free
            else min(self.longest_s, 2.0 ** min(failures - self.free, _MOST_DOUBLINGS))
        )


ACCOUNT = Delays(free=5, longest_s=60)
"""Delays of an account: short, so that an attacker cannot lock a user out. Chosen."""
ADDRESS = Delays(free=10, longest_s=900)
"""Delays of an address: several users may share it, and one that guesses waits up to 15 minutes. Chosen."""


class Throttle:
    """Counts failures per account and per address. Thread-safe, bounded memory."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._failures: OrderedDict[tuple[str, str], tuple[int, float]] = OrderedDict()
        self._logged_in: OrderedDict[tuple[str, str], None] = OrderedDict()

    def wait_s(self, name: str, address: str) -> float:
        """Return the seconds until ``address`` may try account ``name`` again. An empty name stands for the setup."""
        with self._lock:
            waits = [self._wait(("address", address), ADDRESS)]
            # a user who logged in from this address before is not delayed by guesses from elsewhere
            if name and (name, address) not in self._logged_in:
                waits.append(self._wait(("account", name), ACCOUNT))
            return max(waits)

    def has_logged_in(self, name: str, address: str) -> bool:
        """Return whether that user has logged in from that address since the start."""
        with self._lock:
            return (name, address) in self._logged_in

    def count_failure(self, name: str, address: str) -> None:
        """Count a wrong password."""
        with self._lock:
            for key in (("address", address), ("account", name))[: 2 if name else 1]:
                failures, _ = self._failures.pop(key, (0, 0.0))
                self._failures[key] = (failures + 1, self._clock())
            _evict_oldest(self._failures)

    def count_success(self, name: str, address: str) -> None:
        """Record a login: the account's failures are forgotten, the address's are not."""
        with self._lock:
            self._failures.pop(("account", name), None)
            self._logged_in.pop((name, address), None)
            self._logged_in[(name, address)] = None
            _evict_oldest(self._logged_in)

    def _wait(self, key: tuple[str, str], delays: Delays) -> float:
        failures, last_s = self._failures.get(key, (0, 0.0))
        passed = self._clock() - last_s
        if passed > delays.forget_s:
            self._failures.pop(key, None)
            return 0.0
        return max(0.0, delays.compute_s(failures) - passed)


class TokenBuckets:
    """Token buckets: ``burst`` requests at once, ``rate_hz`` sustained. Bounded memory."""

    def __init__(self, rate_hz: float, burst: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate_hz, self._burst, self._clock = rate_hz, burst, clock
        self._lock = threading.Lock()
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def set_rate(self, rate_hz: float, burst: int) -> None:
        """Allow another rate and burst from now on."""
        with self._lock:
            self._rate_hz, self._burst = rate_hz, burst

    def take(self, key: str) -> float:
        """Take a token of ``key``; return 0 if there was one, else the seconds until the next."""
        with self._lock:
            now = self._clock()
            left, last_s = self._left.pop(key, (float(self._burst), now))
            left = min(self._burst, left + (now - last_s) * self._rate_hz)
            allowed = left >= 1
            self._left[key] = (left - 1 if allowed else left, now)
            _evict_oldest(self._left)
            return 0.0 if allowed else (1 - left) / self._rate_hz


class WorkLimiter:
    """Paces work that cannot be refused: each piece returns the wait after it."""

    def __init__(
        self, rate_hz: float, longest_s: float = 2.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate_hz, self._longest_s, self._clock = rate_hz, longest_s, clock
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def spend(self, key: str, cost: float = 1) -> float:
        """Count work of ``key``; return the seconds until its next. One second's worth may come at once."""
        now = self._clock()
        left, last_s = self._left.pop(key, (self._rate_hz, now))
        left = min(self._rate_hz, left + (now - last_s) * self._rate_hz) - cost
        left = max(left, -self._longest_s * self._rate_hz)
        self._left[key] = (left, now)
        _evict_oldest(self._left)
        return max(0.0, -left / self._rate_hz)


def normalise_address(address: str) -> str:
    """Return what counts as one address: an IPv4 address, or the /64 network of an IPv6 address."""
    try:
        parsed = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(parsed, ipaddress.IPv6Address):
        if parsed.ipv4_mapped:
            return str(parsed.ipv4_mapped)
        return str(ipaddress.ip_network((parsed, 64), strict=False))
    return str(parsed)


def _evict_oldest(entries: OrderedDict[Any, Any]) -> None:
    while len(entries) > MAX_ENTRIES:
        entries.popitem(last=False)
