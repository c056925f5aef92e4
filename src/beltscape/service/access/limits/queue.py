"""A queue for password hashing: one at a time, few waiting, throttled against guessing."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from fastapi import HTTPException

from beltscape.core.errors import InputError
from beltscape.service.access.limits.throttle import Throttle, TokenBuckets

MAX_WAITING = 8
"""Passwords that may wait for their check, of some 0.1 s each; further ones are refused. Chosen."""
UNKNOWN_HZ, UNKNOWN_BURST = 0.5, 30
"""Rate and burst of password checks for all accounts and addresses without an earlier login together: 43,000 guesses
a day, too few for any valid password. Chosen."""
Result = TypeVar("Result")


class PasswordQueue:
    """Hashes in one thread, so that many logins at once do not take memory and cores from the measurement."""

    def __init__(self, throttle: Throttle) -> None:
        self._throttle = throttle
        self._thread = ThreadPoolExecutor(1, "beltscape-passwords")
        self._waiting = 0
        self._unknown = TokenBuckets(UNKNOWN_HZ, UNKNOWN_BURST)

    async def run_throttled(self, work: Callable[[], Result], account: str, address: str) -> Result:
        """Run ``work`` that checks a password; HTTPException 429 while ``account`` or ``address`` must wait."""

        def run_unless_blocked() -> Result:
            wait_s = self._throttle.wait_s(account, address)
            if wait_s:
                raise _make_retry_error(wait_s)
            return work()

        # guesses from many unknown addresses take a small share of one core and do not delay known users
        wait_s = 0.0 if self._throttle.has_logged_in(account, address) else self._unknown.take("")
        if wait_s or self._waiting >= MAX_WAITING:
            raise _make_retry_error(max(wait_s, 2))
        return await self.run(run_unless_blocked)

    async def run(self, work: Callable[[], Result]) -> Result:
        """Run ``work`` in the thread; HTTPException 409 if it raises InputError."""
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, convert_input_errors, work)
        finally:
            self._waiting -= 1

    def close(self) -> None:
        """Stop the thread."""
        self._thread.shutdown(cancel_futures=True)


def convert_input_errors(work: Callable[[], Result]) -> Result:
    """Return the result of ``work``; an InputError becomes HTTPException 409 with its message."""
    try:
        return work()
    except InputError as error:
        raise HTTPException(409, str(error)) from error


def _make_retry_error(wait_s: float) -> HTTPException:
    seconds = math.ceil(wait_s)
    return HTTPException(429, f"try again in {seconds} s", {"retry-after": str(seconds)})
