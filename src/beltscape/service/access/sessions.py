"""Login sessions with their cookie, and the API keys by which programs read without signing in.

Only hashes of the tokens are stored, so that a stolen backup opens no session.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import sqlite3
import time
from collections.abc import Callable
from dataclasses import dataclass

from starlette.requests import HTTPConnection
from starlette.responses import Response

from beltscape.core.errors import InputError, OutputError
from beltscape.service.access.accounts import User, validate_name
from beltscape.service.access.database import Database

MAX_PER_USER = 32
"""Sessions of one user, which bounds the table; beyond, the one unused longest is removed. Chosen."""
IN_MEMORY_LIFE_S = 3600
"""Life of a session that could not be written to disk: an hour, in which to repair the disk. Chosen."""
_TOUCH_S = 60
"""The last use of a session is stored at most this often, which bounds the writes."""
_CLOCK_BACK_S = 300
"""Correction of the clock up to which sessions created "in the future" stay valid; NTP steps less. Chosen."""


class Sessions:
    """The sessions in ``users.db``; they survive restarts. Thread-safe."""

    def __init__(
        self, database: Database, idle_s: float, life_s: float, clock: Callable[[], float] = time.time
    ) -> None:
        self._database = database
        self._idle_s, self._life_s, self._clock = idle_s, life_s, clock
        # while the disk is full: sessions that were ended, or opened, without being written
        self._ended: set[str] = set()
        self._in_memory: dict[str, tuple[User, int]] = {}

    def set_lives(self, idle_s: float, life_s: float) -> None:
        """End sessions after another time without a request, and after another life."""
        self._idle_s, self._life_s = idle_s, life_s

    def open(self, user: User, address: str) -> str:
        """Open a session and return its token of 256 random bits. OutputError if it cannot be written."""
        token, now = secrets.token_urlsafe(32), int(self._clock())
        with self._database.transaction() as connection:
            self._delete_expired(connection, now)
            connection.execute(
                "DELETE FROM sessions WHERE name = ?1 AND token NOT IN "
                "(SELECT token FROM sessions WHERE name = ?1 ORDER BY seen_s DESC LIMIT ?2)",
                (user.name, MAX_PER_USER - 1),
            )
            connection.execute(
                "INSERT INTO sessions VALUES (?, ?, ?, ?, ?)",
                (hash_token(token), user.name, now, now, address),
            )
        return token

    def open_in_memory(self, user: User) -> str:
        """Open a session in memory for an hour: access must remain possible while the disk is full."""
        token = secrets.token_urlsafe(32)
        now = int(self._clock())
        valid = {k: v for k, v in self._in_memory.items() if 0 <= now - v[1] < IN_MEMORY_LIFE_S}
        self._in_memory = dict([*valid.items(), (hash_token(token), (user, now))][-MAX_PER_USER:])
        return token

    def find(self, token: str, *, touch: bool = True) -> User | None:
        """Return the session's user; None if there is no such session. ``touch``: count this as a use."""
        key, now = hash_token(token), int(self._clock())
        rows = self._database.select(
            "SELECT u.name, role, s.created_s, seen_s FROM sessions s JOIN users u USING(name) WHERE token = ?",
            key,
        )
        if key in self._ended:
            return None
        if not rows:
            return self._find_in_memory(key, now)
        name, role, created_s, seen_s = rows[0]
        if not self._is_valid(now, created_s, seen_s):
            self._end(key)
            return None
        if touch and abs(now - seen_s) >= _TOUCH_S:
            self._touch(key, now)
        return User(name, role)

    def close(self, token: str) -> None:
        """End a session at once, even if that cannot be written."""
        self._end(hash_token(token))

    def _find_in_memory(self, key: str, now: int) -> User | None:
        user, since_s = self._in_memory.get(key, (None, 0))
        if user is None or not 0 <= now - since_s < IN_MEMORY_LIFE_S:
            return None
        query = "SELECT name, role FROM users WHERE name = ? AND changed_s <= ?"
        rows = self._database.select(query, user.name, since_s)
        return User(*rows[0]) if rows else None

    def _is_valid(self, now: int, created_s: int, seen_s: int) -> bool:
        # a session from the future means that the clock was set back: its age is unknown, so it ends
        return (
            -_CLOCK_BACK_S <= now - created_s < self._life_s and -_CLOCK_BACK_S <= now - seen_s < self._idle_s
        )

    def _touch(self, key: str, now: int) -> None:
        try:
            with self._database.transaction() as connection:
                connection.execute("UPDATE sessions SET seen_s = ? WHERE token = ?", (now, key))
        except OutputError:
            pass  # a full disk must not lock users out; the session only ends earlier

    def _end(self, key: str) -> None:
        self._in_memory.pop(key, None)
        try:
            with self._database.transaction() as connection:
                connection.execute("DELETE FROM sessions WHERE token = ?", (key,))
        except OutputError:
            self._ended.add(key)

    def _delete_expired(self, connection: sqlite3.Connection, now: int) -> None:
        connection.execute(
            "DELETE FROM sessions WHERE created_s <= ? OR seen_s <= ?",
            (now - self._life_s, now - self._idle_s),
        )


def derive_page_token(token: str) -> str:
    """Return the token that the page sends beside the cookie, so that no other site can act for the user (CSRF)."""
    return hmac.new(token.encode(), b"beltscape page", hashlib.sha256).hexdigest()


def hash_token(token: str) -> str:
    """Return the hash under which a token is stored."""
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()


_KEY_SCHEME = "bearer "


@dataclass(frozen=True, slots=True)
class AccessKey:
    """A key as the list of keys shows it."""

    name: str
    created_s: int
    """System clock, seconds since 1970."""


class Keys:
    """The keys in ``users.db``, stored as hashes. A key has the role viewer and allows reading only."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def list(self) -> tuple[AccessKey, ...]:
        """Return all keys by name."""
        return tuple(
            AccessKey(*row) for row in self._database.select("SELECT name, created_s FROM keys ORDER BY name")
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
    return header[len(_KEY_SCHEME) :].strip() if header[: len(_KEY_SCHEME)].lower() == _KEY_SCHEME else None


PATH_PREFIX = "beltscape.path_prefix"
"""Key of the ASGI scope under which the server stores the path, such as "/belt4", of a trusted proxy's page."""
TOKEN_HEADER = "x-beltscape-token"
"""Header in which the page sends its token with every request that changes something."""
_LONGEST_TOKEN = 100
"""Characters of a token; a longer one is none: 32 bytes have 43 characters in base64."""


def read_session_token(connection: HTTPConnection) -> str | None:
    """Return a request's session token, or None."""
    token = connection.cookies.get(_cookie_name(connection))
    return token if token and len(token) <= _LONGEST_TOKEN else None


def set_session_cookie(response: Response, connection: HTTPConnection, token: str, life_s: float) -> None:
    """Set the cookie: no script can read it, no other site sends it."""
    https = connection.scope["scheme"] == "https"
    response.set_cookie(
        _cookie_name(connection),
        token,
        max_age=int(life_s),
        path=_cookie_path(connection),
        secure=https,
        httponly=True,
        samesite="strict",
    )


def delete_session_cookie(response: Response, connection: HTTPConnection) -> None:
    """Delete the cookie."""
    https = connection.scope["scheme"] == "https"
    response.delete_cookie(
        _cookie_name(connection),
        path=_cookie_path(connection),
        secure=https,
        httponly=True,
        samesite="strict",
    )


def _cookie_path(connection: HTTPConnection) -> str:
    return f"{connection.scope.get(PATH_PREFIX, '')}/"


def _cookie_name(connection: HTTPConnection) -> str:
    """Return a name of this belt's own: below a proxy's paths several belts share a host's cookies."""
    prefix = connection.scope.get(PATH_PREFIX, "")
    name = "beltscape" + prefix.replace("/", "-")
    if connection.scope["scheme"] not in ("https", "wss"):
        return name
    # the first part binds the cookie to TLS, and where it may to this host
    return f"__Secure-{name}" if prefix else f"__Host-{name}"
