"""API keys by which programs read without signing in, such as a Prometheus on another machine."""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass

from starlette.requests import HTTPConnection

from beltscape.core.errors import InputError
from beltscape.service.access.identity.accounts import validate_name
from beltscape.service.access.identity.database import Database
from beltscape.service.access.identity.roles import User
from beltscape.service.access.identity.sessions import hash_token

_SCHEME = "bearer "


@dataclass(frozen=True, slots=True)
class Key:
    """A key as the list of keys shows it."""

    name: str
    created_s: int
    """System clock, seconds since 1970."""


class Keys:
    """The keys in ``users.db``, stored as hashes. A key has the role viewer and allows reading only."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def list(self) -> tuple[Key, ...]:
        """Return all keys by name."""
        return tuple(
            Key(*row) for row in self._database.select("SELECT name, created_s FROM keys ORDER BY name")
        )

    def create(self, name: str) -> str:
        """Return a new key of 256 random bits, which cannot be shown again; it replaces an older one of that name."""
        token = secrets.token_urlsafe(32)
        with self._database.transaction() as connection:
            values = (validate_name(name), hash_token(token), int(time.time()))
            connection.execute("INSERT OR REPLACE INTO keys VALUES (?, ?, ?)", values)
        return token

    def remove(self, name: str) -> None:
        """Remove a key from the next request on. InputError if there is none."""
        with self._database.transaction() as connection:
            if not connection.execute("DELETE FROM keys WHERE name = ?", (validate_name(name),)).rowcount:
                raise InputError(f"key {name[:32]!r}: there is none; see `beltscape users list`")

    def find(self, token: str) -> User | None:
        """Return a viewer with the key's name; None if there is no such key."""
        rows = self._database.select("SELECT name FROM keys WHERE token = ?", hash_token(token))
        return User(f"key {rows[0][0]}", "viewer") if rows else None


def read_key(connection: HTTPConnection) -> str | None:
    """Return the key in a request's ``Authorization: Bearer`` header, or None."""
    header = connection.headers.get("authorization", "")
    return header[len(_SCHEME) :].strip() if header[: len(_SCHEME)].lower() == _SCHEME else None
