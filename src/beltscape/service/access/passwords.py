"""Passwords: what is kept of them, and which are too weak.

scrypt after RFC 7914; its costs are kept with every hash, so that they can grow later.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import os
import unicodedata
from dataclasses import dataclass

from beltscape.core.errors import InputError

LEAST = 10
MOST = 200


@dataclass(frozen=True, slots=True)
class Cost:
    """What one guess costs: 128·r·2^log2_n bytes of memory, p times."""

    log2_n: int = 15
    r: int = 8
    p: int = 3


def hashed(password: str, cost: Cost) -> str:
    """What is kept of a password: ``scrypt$log2_n$r$p$salt$hash``, the last two in base64."""
    salt = os.urandom(16)
    parts = (salt, _scrypt(password, salt, cost))
    return "$".join(
        ["scrypt", str(cost.log2_n), str(cost.r), str(cost.p), *(base64.b64encode(p).decode() for p in parts)]
    )


def matches(password: str, kept: str) -> bool:
    """Whether ``kept`` was made of this password; takes the same time whether or not."""
    kind, log2_n, r, p, salt, digest = kept.split("$")
    if kind != "scrypt":
        raise InputError(f"users.db: unknown kind of password hash {kind!r}; set the password anew")
    found = _scrypt(password, base64.b64decode(salt), Cost(int(log2_n), int(r), int(p)))
    return hmac.compare_digest(found, base64.b64decode(digest))


def accepted(password: str, name: str) -> str:
    """``password`` if it is strong enough for ``name``, or InputError saying what is wrong."""
    plain = unicodedata.normalize("NFKC", password)
    if not LEAST <= len(plain) <= MOST:
        raise InputError(f"password: must have {LEAST} to {MOST} characters, not {len(plain)}")
    if len(set(plain)) < 5:
        raise InputError("password: too few different characters; use at least 5")
    if len(name) > 2 and name.casefold() in plain.casefold():
        raise InputError("password: must not contain the user's name")
    return password


def _scrypt(password: str, salt: bytes, cost: Cost) -> bytes:
    plain = unicodedata.normalize("NFKC", password).encode("utf-8", "surrogatepass")
    n = 2**cost.log2_n
    return hashlib.scrypt(plain, salt=salt, n=n, r=cost.r, p=cost.p, maxmem=2 * 128 * cost.r * n, dklen=32)
