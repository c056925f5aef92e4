"""Slow work on passwords: one at a time, few waiting, and none for whoever guesses."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from fastapi import HTTPException

from beltscape.core.errors import InputError
from beltscape.service.access.throttle import Throttle

WAITING = 8
"""Passwords that may wait to be looked at; whoever comes then is sent away."""
Result = TypeVar("Result")


class PasswordQueue:
    """Its one thread keeps many logins at once from taking the metering's memory and cores."""

    def __init__(self, throttle: Throttle) -> None:
        self._throttle = throttle
        self._thread = ThreadPoolExecutor(1, "beltscape-passwords")
        self._waiting = 0

    async def run(self, work: Callable[[], Result], account: str, address: str) -> Result:
        """``work`` in the thread. HTTPException 429 while ``account`` or ``address`` must wait; 409 for bad input."""

        def unless_guessing() -> Result:
            wait_s = self._throttle.wait_s(account, address)
            if wait_s:
                raise _wait(wait_s)
            return or_conflict(work)

        if self._waiting >= WAITING:
            raise _wait(2)
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, unless_guessing)
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
