"""Who is logged in. Only hashes of the tokens are kept, so that a stolen backup opens no session."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import sqlite3
import time
from collections.abc import Callable

from beltscape.core.errors import OutputError
from beltscape.service.access.database import Database
from beltscape.service.access.roles import User

PER_USER = 32
"""Sessions of one user; the one unused longest makes way."""
UNKEPT_S = 3600
"""How long a session lasts that could not be written down."""
_TOUCH_S = 60
_CLOCK_BACK_S = 300


class Sessions:
    """The sessions in ``users.db``, for any thread. They survive restarts."""

    def __init__(
        self, database: Database, idle_s: float, life_s: float, clock: Callable[[], float] = time.time
    ) -> None:
        self._database = database
        self._idle_s, self._life_s, self._clock = idle_s, life_s, clock
        # only where the disk is full: sessions that were ended, or opened, without its knowing
        self._ended: set[str] = set()
        self._unkept: dict[str, tuple[User, int]] = {}

    def open(self, user: User, address: str) -> str:
        """A new session's token, 256 random bits. OutputError where it cannot be kept."""
        token, now = secrets.token_urlsafe(32), int(self._clock())
        with self._database.change() as change:
            self._sweep(change, now)
            change.execute(
                "DELETE FROM sessions WHERE name = ?1 AND token NOT IN "
                "(SELECT token FROM sessions WHERE name = ?1 ORDER BY seen_s DESC LIMIT ?2)",
                (user.name, PER_USER - 1),
            )
            change.execute(
                "INSERT INTO sessions VALUES (?, ?, ?, ?, ?)", (kept_as(token), user.name, now, now, address)
            )
        return token

    def open_unkept(self, user: User) -> str:
        """A session for an hour that ends with the process: for when the disk is full and somebody must look."""
        token = secrets.token_urlsafe(32)
        now = int(self._clock())
        alive = {k: v for k, v in self._unkept.items() if 0 <= now - v[1] < UNKEPT_S}
        self._unkept = dict([*alive.items(), (kept_as(token), (user, now))][-PER_USER:])
        return token

    def find(self, token: str, *, touch: bool = True) -> User | None:
        """Whose session it is; None where it never was or has ended. ``touch``: it is used now."""
        key, now = kept_as(token), int(self._clock())
        rows = self._database.rows(
            "SELECT u.name, role, s.created_s, seen_s FROM sessions s JOIN users u USING(name) WHERE token = ?",
            key,
        )
        if key in self._ended:
            return None
        if not rows:
            return self._unkept_user(key, now)
        name, role, created_s, seen_s = rows[0]
        if not self._alive(now, created_s, seen_s):
            self._end(key)
            return None
        if touch and abs(now - seen_s) >= _TOUCH_S:
            self._touch(key, now)
        return User(name, role)

    def close(self, token: str) -> None:
        """Log out; at once even where that cannot be written."""
        self._end(kept_as(token))

    def _unkept_user(self, key: str, now: int) -> User | None:
        user, since_s = self._unkept.get(key, (None, 0))
        if user is None or not 0 <= now - since_s < UNKEPT_S:
            return None
        query = "SELECT name, role FROM users WHERE name = ? AND changed_s <= ?"
        rows = self._database.rows(query, user.name, since_s)
        return User(*rows[0]) if rows else None

    def _alive(self, now: int, created_s: int, seen_s: int) -> bool:
        # a session from the future tells that the clock was set back: nobody knows its age, so it ends
        return (
            -_CLOCK_BACK_S <= now - created_s < self._life_s and -_CLOCK_BACK_S <= now - seen_s < self._idle_s
        )

    def _touch(self, key: str, now: int) -> None:
        try:
            with self._database.change() as change:
                change.execute("UPDATE sessions SET seen_s = ? WHERE token = ?", (now, key))
        except OutputError:
            pass  # a full disk must not lock people out; the session only ends earlier

    def _end(self, key: str) -> None:
        self._unkept.pop(key, None)
        try:
            with self._database.change() as change:
                change.execute("DELETE FROM sessions WHERE token = ?", (key,))
        except OutputError:
            self._ended.add(key)

    def _sweep(self, change: sqlite3.Connection, now: int) -> None:
        change.execute(
            "DELETE FROM sessions WHERE created_s <= ? OR seen_s <= ?",
            (now - self._life_s, now - self._idle_s),
        )


def page_token(token: str) -> str:
    """What the page sends beside the cookie, so that another site cannot act for its user."""
    return hmac.new(token.encode(), b"beltscape page", hashlib.sha256).hexdigest()


def kept_as(token: str) -> str:
    """What of a token is written down: a hash."""
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()
