"""Passwords: hashes (scrypt, RFC 7914), rules for new ones, and the queue in which they are hashed.

The cost parameters are stored with every hash, so that they can be raised later. The queue hashes one password at a
time, lets few wait, and is throttled against guessing.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import math
import os
import unicodedata
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from fastapi import HTTPException

from beltscape.core.errors import InputError
from beltscape.service.access.throttle import Throttle, TokenBuckets

MIN_LENGTH = 10
"""NIST SP 800-63B requires 8 characters at least."""
MAX_LENGTH = 200
"""NIST SP 800-63B: at least 64 must be allowed; a limit bounds the time of the hash."""
_LEAST_DISTINCT = 5
"""Least number of different characters: refuses "aaaaaaaaaa" and "1212121212". Chosen."""
_SALT_BYTES, _HASH_BYTES = 16, 32
"""NIST SP 800-132: a salt of at least 16 bytes; the hash has the length of SHA-256's."""


@dataclass(frozen=True, slots=True)
class ScryptCost:
    """Cost of one hash: 128·r·2^log2_n bytes of memory, p times. The default is the least that OWASP recommends."""

    log2_n: int = 15
    """Binary logarithm of the cost N of RFC 7914: with r = 8, 32 MiB of memory."""
    r: int = 8
    """Block size of RFC 7914."""
    p: int = 3
    """Parallelisation of RFC 7914; here one after the other."""


def hash_password(password: str, cost: ScryptCost) -> str:
    """Return a password's hash as ``scrypt$log2_n$r$p$salt$hash``, the last two in base64."""
    salt = os.urandom(_SALT_BYTES)
    return _format_hash(salt, _scrypt(password, salt, cost), cost)


def make_unmatched_hash(cost: ScryptCost) -> str:
    """Return a hash that no known password has, at once; to verify a password against it takes as long as ever."""
    return _format_hash(os.urandom(_SALT_BYTES), os.urandom(_HASH_BYTES), cost)


def _format_hash(salt: bytes, digest: bytes, cost: ScryptCost) -> str:
    parts = (base64.b64encode(part).decode() for part in (salt, digest))
    return "$".join(["scrypt", str(cost.log2_n), str(cost.r), str(cost.p), *parts])


def verify_password(password: str, kept: str) -> bool:
    """Return whether ``kept`` is a hash of this password, in constant time."""
    kind, log2_n, r, p, salt, digest = kept.split("$")
    if kind != "scrypt":
        raise InputError(f"users.db: unknown kind of password hash {kind!r}; set the password again")
    computed = _scrypt(password, base64.b64decode(salt), ScryptCost(int(log2_n), int(r), int(p)))
    return hmac.compare_digest(computed, base64.b64decode(digest))


def validate_password(password: str, name: str) -> str:
    """Return ``password`` if it is strong enough for ``name``, else raise InputError with the reason."""
    plain = unicodedata.normalize("NFKC", password)
    if not MIN_LENGTH <= len(plain) <= MAX_LENGTH:
        raise InputError(f"password: must have {MIN_LENGTH} to {MAX_LENGTH} characters, not {len(plain)}")
    if len(set(plain)) < _LEAST_DISTINCT:
        raise InputError(f"password: too few different characters; use at least {_LEAST_DISTINCT}")
    if len(name) > 2 and name.casefold() in plain.casefold():
        raise InputError("password: must not contain the user's name")
    return password


def _scrypt(password: str, salt: bytes, cost: ScryptCost) -> bytes:
    plain = unicodedata.normalize("NFKC", password).encode("utf-8", "surrogatepass")
    n = 2**cost.log2_n
    return hashlib.scrypt(
        plain, salt=salt, n=n, r=cost.r, p=cost.p, maxmem=2 * 128 * cost.r * n, dklen=_HASH_BYTES
    )


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
