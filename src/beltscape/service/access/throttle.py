"""Guessing passwords is slow: after a few failures every further one makes the next wait longer."""

from __future__ import annotations

import ipaddress
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

REMEMBERED = 4096
"""Accounts and addresses remembered; beyond, the ones unused longest are forgotten."""


@dataclass(frozen=True, slots=True)
class Delays:
    """Free failures, then 1, 2, 4 … seconds up to the longest; forgotten after a quiet time."""

    free: int
    longest_s: float
    forget_s: float = 3600

    def after(self, failures: int) -> float:
        """Seconds to wait after so many failures in a row."""
        return 0.0 if failures < self.free else min(self.longest_s, 2.0 ** min(failures - self.free, 30))


ACCOUNT = Delays(free=5, longest_s=60)
"""Short, since a stranger must not be able to lock a user out."""
ADDRESS = Delays(free=10, longest_s=900)


class Throttle:
    """Counts failures per account and per address; for any thread, in bounded memory."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._failures: OrderedDict[tuple[str, str], tuple[int, float]] = OrderedDict()
        self._known: OrderedDict[tuple[str, str], None] = OrderedDict()

    def wait_s(self, name: str, address: str) -> float:
        """Seconds until this address may try this account again; 0: now. An empty name is no account: the setup's."""
        with self._lock:
            waits = [self._wait(("address", address), ADDRESS)]
            # somebody who logged in from here before is not held up by strangers guessing elsewhere
            if name and (name, address) not in self._known:
                waits.append(self._wait(("account", name), ACCOUNT))
            return max(waits)

    def knows(self, name: str, address: str) -> bool:
        """Whether that user logged in from there since the start."""
        with self._lock:
            return (name, address) in self._known

    def failed(self, name: str, address: str) -> None:
        """A wrong password."""
        with self._lock:
            for key in (("address", address), ("account", name))[: 2 if name else 1]:
                failures, _ = self._failures.pop(key, (0, 0.0))
                self._failures[key] = (failures + 1, self._clock())
            _bound(self._failures)

    def succeeded(self, name: str, address: str) -> None:
        """A right one; the account's failures are forgotten, the address's are not."""
        with self._lock:
            self._failures.pop(("account", name), None)
            self._known.pop((name, address), None)
            self._known[(name, address)] = None
            _bound(self._known)

    def _wait(self, key: tuple[str, str], delays: Delays) -> float:
        failures, last_s = self._failures.get(key, (0, 0.0))
        passed = self._clock() - last_s
        if passed > delays.forget_s:
            self._failures.pop(key, None)
            return 0.0
        return max(0.0, delays.after(failures) - passed)


class Buckets:
    """Token buckets: ``burst`` requests at once, ``rate`` a second in the long run; in bounded memory."""

    def __init__(self, rate_hz: float, burst: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate_hz, self._burst, self._clock = rate_hz, burst, clock
        self._lock = threading.Lock()
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, key: str) -> float:
        """0 where ``key`` may go on, else the seconds to wait."""
        with self._lock:
            now = self._clock()
            left, then = self._left.pop(key, (float(self._burst), now))
            left = min(self._burst, left + (now - then) * self._rate_hz)
            allowed = left >= 1
            self._left[key] = (left - 1 if allowed else left, now)
            _bound(self._left)
            return 0.0 if allowed else (1 - left) / self._rate_hz


class Pace:
    """Work that must be done, but no faster than its rate: each piece says how long to wait after it."""

    def __init__(
        self, rate_hz: float, longest_s: float = 2.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate_hz, self._longest_s, self._clock = rate_hz, longest_s, clock
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def spend(self, key: str, cost: float = 1) -> float:
        """Count a piece of ``key``'s work; seconds until it is its turn again. A second's work may come at once."""
        now = self._clock()
        left, then = self._left.pop(key, (self._rate_hz, now))
        left = min(self._rate_hz, left + (now - then) * self._rate_hz) - cost
        left = max(left, -self._longest_s * self._rate_hz)
        self._left[key] = (left, now)
        _bound(self._left)
        return max(0.0, -left / self._rate_hz)


def network(address: str) -> str:
    """What counts as one address: an IPv4 address, or the /64 network that one IPv6 customer has to itself."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv6Address):
        if found.ipv4_mapped:
            return str(found.ipv4_mapped)
        return str(ipaddress.ip_network((found, 64), strict=False))
    return str(found)


def _bound(entries: OrderedDict) -> None:
    while len(entries) > REMEMBERED:
        entries.popitem(last=False)
