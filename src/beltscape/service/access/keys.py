"""Keys by which programs read without signing in: a Prometheus on another machine, a script."""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass

from starlette.requests import HTTPConnection

from beltscape.core.errors import InputError
from beltscape.service.access.accounts import usable
from beltscape.service.access.database import Database
from beltscape.service.access.roles import User
from beltscape.service.access.sessions import kept_as

_SCHEME = "bearer "


@dataclass(frozen=True, slots=True)
class Key:
    """What a list of keys shows."""

    name: str
    created_s: int
    """System clock, seconds since 1970."""


class Keys:
    """The keys in ``users.db``; only their hashes are kept. Whoever brings one is a viewer, and only reads."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def list(self) -> tuple[Key, ...]:
        """All keys by name."""
        return tuple(
            Key(*row) for row in self._database.rows("SELECT name, created_s FROM keys ORDER BY name")
        )

    def make(self, name: str) -> str:
        """A new key, 256 random bits, shown this once; an older one of that name does no longer."""
        token = secrets.token_urlsafe(32)
        with self._database.change() as change:
            values = (usable(name), kept_as(token), int(time.time()))
            change.execute("INSERT OR REPLACE INTO keys VALUES (?, ?, ?)", values)
        return token

    def remove(self, name: str) -> None:
        """It opens nothing any more, from the next request on. InputError where there is none."""
        with self._database.change() as change:
            if not change.execute("DELETE FROM keys WHERE name = ?", (usable(name),)).rowcount:
                raise InputError(f"key {name[:32]!r}: there is none; see `beltscape users list`")

    def find(self, token: str) -> User | None:
        """Who brings it: a viewer by the key's name; None where there is no such key."""
        rows = self._database.rows("SELECT name FROM keys WHERE token = ?", kept_as(token))
        return User(f"key {rows[0][0]}", "viewer") if rows else None


def key_of(connection: HTTPConnection) -> str | None:
    """The key that a request brings in ``Authorization: Bearer``, or None."""
    given = connection.headers.get("authorization", "")
    return given[len(_SCHEME) :].strip() if given[: len(_SCHEME)].lower() == _SCHEME else None
