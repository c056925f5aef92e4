"""Slow work on passwords: one at a time, few waiting, and none for whoever guesses."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from fastapi import HTTPException

from beltscape.core.errors import InputError
from beltscape.service.access.throttle import Buckets, Throttle

WAITING = 8
"""Passwords that may wait to be looked at; whoever comes then is sent away."""
STRANGERS_HZ, STRANGERS_AT_ONCE = 0.5, 30
"""Passwords looked at for those who were never logged in from where they are, all together."""
Result = TypeVar("Result")


class PasswordQueue:
    """Its one thread keeps many logins at once from taking the metering's memory and cores."""

    def __init__(self, throttle: Throttle) -> None:
        self._throttle = throttle
        self._thread = ThreadPoolExecutor(1, "beltscape-passwords")
        self._waiting = 0
        self._strangers = Buckets(STRANGERS_HZ, STRANGERS_AT_ONCE)

    async def guess(self, work: Callable[[], Result], account: str, address: str) -> Result:
        """``work`` for somebody who may be guessing: HTTPException 429 while ``account`` or ``address`` must wait."""

        def unless_guessing() -> Result:
            wait_s = self._throttle.wait_s(account, address)
            if wait_s:
                raise _wait(wait_s)
            return work()

        # strangers from many addresses take a small share of one core, and do not hold up who was here before
        wait_s = 0.0 if self._throttle.knows(account, address) else self._strangers.take("")
        if wait_s or self._waiting >= WAITING:
            raise _wait(max(wait_s, 2))
        return await self.run(unless_guessing)

    async def run(self, work: Callable[[], Result]) -> Result:
        """``work`` in the thread; HTTPException 409 where its input does not do."""
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, or_conflict, work)
        finally:
            self._waiting -= 1

    def close(self) -> None:
        """No more comes."""
        self._thread.shutdown(cancel_futures=True)


def or_conflict(work: Callable[[], Result]) -> Result:
    """What ``work`` gives; where its input does not do, the answer 409 with its message."""
    try:
        return work()
    except InputError as error:
        raise HTTPException(409, str(error)) from error


def _wait(wait_s: float) -> HTTPException:
    seconds = math.ceil(wait_s)
    return HTTPException(429, f"try again in {seconds} s", {"retry-after": str(seconds)})
