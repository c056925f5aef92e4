"""Users: their roles, their accounts in ``users.db``, and the user, role and address of a request.

Accounts work with or without the service running. Routes take the user by FastAPI dependencies, as the guard has
identified them.
"""

from __future__ import annotations

import time
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from sqlite3 import Connection
from typing import Any, Literal

from fastapi import HTTPException, Request, WebSocket
from starlette.requests import HTTPConnection

from beltscape.core.errors import InputError
from beltscape.service.access.database import Database
from beltscape.service.access.passwords import (
    ScryptCost,
    hash_password,
    make_unmatched_hash,
    validate_password,
    verify_password,
)
from beltscape.service.access.throttle import normalise_address

Role = Literal["viewer", "operator", "engineer"]
"""viewer: reads; operator: also acknowledges alarms, keeps recordings, begins maintenance; engineer: also sees the
system's checks and manages users"""
ROLES: tuple[Role, ...] = ("viewer", "operator", "engineer")
"""All roles, from least to most; each includes those before it."""
ANONYMOUS = "anonymous"
"""Name of users without a login; no account may have it."""


@dataclass(frozen=True, slots=True)
class User:
    """An identified user."""

    name: str
    role: Role

    def has_role(self, role: Role) -> bool:
        """Return whether the user's role includes ``role``."""
        return ROLES.index(self.role) >= ROLES.index(role)


MAX_NAME_LENGTH = 32
"""Longest name: that of user names on Linux (useradd)."""
_FIND = "SELECT name, role FROM users WHERE name = ?"


@dataclass(frozen=True, slots=True)
class Account:
    """A user as the list of users shows it."""

    name: str
    role: Role
    created_s: int
    """System clock, seconds since 1970."""
    changed_s: int
    """System clock when the password was last set."""
    sessions: int
    """Number of open sessions."""


class Accounts:
    """The users in ``users.db``."""

    def __init__(self, database: Database, cost: ScryptCost | None = None) -> None:
        self._database = database
        self._cost = cost or ScryptCost()
        # checked for unknown users, so that known and unknown names take the same time
        self._dummy_hash = make_unmatched_hash(self._cost)

    @property
    def is_setup_open(self) -> bool:
        """True until the first user is added."""
        return not self._database.select("SELECT 1 FROM facts WHERE key = 'setup_closed'")

    def list(self) -> tuple[Account, ...]:
        """Return all users by name."""
        rows = self._database.select(
            "SELECT u.name, role, u.created_s, changed_s, count(token) FROM users u LEFT JOIN sessions s USING(name) "
            "GROUP BY u.name ORDER BY u.name"
        )
        return tuple(Account(*row) for row in rows)

    def find(self, name: str) -> User:
        """Return the user of that name, or raise InputError."""
        return _single_user(self._database.select(_FIND, normalise_name(name)), name)

    def check(self, name: str, password: str) -> User | None:
        """Return the user if the password is right, else None; an unknown name takes the same time."""
        rows = self._database.select(
            "SELECT name, role, password FROM users WHERE name = ?", normalise_name(name)
        )
        row: tuple[Any, ...] = rows[0] if rows else (None, None, self._dummy_hash)
        user_name, role, kept = row
        is_right = verify_password(password, kept)
        return User(user_name, role) if is_right and user_name else None

    def add(self, name: str, role: Role, password: str, *, first: bool = False) -> User:
        """Add a user. InputError if name, role or password is refused, or ``first`` and there was a user before."""
        user = User(validate_name(name), _validate_role(role))
        password_hash = hash_password(validate_password(password, user.name), self._cost)
        now = int(time.time())
        with self._database.transaction() as connection:
            if first and not self.is_setup_open:
                raise InputError("the setup is over: log in, or use `beltscape users` on the machine itself")
            if connection.execute("SELECT 1 FROM users WHERE name = ?", (user.name,)).fetchone():
                raise InputError(f"user {user.name}: exists already; choose another name")
            connection.execute(
                "INSERT INTO users VALUES (?, ?, ?, ?, ?)", (user.name, user.role, password_hash, now, now)
            )
            connection.execute("INSERT OR REPLACE INTO facts VALUES ('setup_closed', ?)", (str(now),))
        return user

    def remove(self, name: str) -> None:
        """Remove a user with all sessions. The last engineer cannot be removed."""
        with self._database.transaction() as connection:
            self._check_engineer_remains(connection, _get_user(connection, name), None)
            connection.execute("DELETE FROM users WHERE name = ?", (normalise_name(name),))

    def set_role(self, name: str, role: Role) -> None:
        """Change a role from the next request on. The last engineer's role cannot be changed."""
        with self._database.transaction() as connection:
            self._check_engineer_remains(connection, _get_user(connection, name), _validate_role(role))
            connection.execute("UPDATE users SET role = ? WHERE name = ?", (role, normalise_name(name)))

    def set_password(self, name: str, password: str) -> None:
        """Set a password and end all of the user's sessions."""
        password_hash = hash_password(validate_password(password, normalise_name(name)), self._cost)
        with self._database.transaction() as connection:
            _get_user(connection, name)
            values = (password_hash, int(time.time()), normalise_name(name))
            connection.execute("UPDATE users SET password = ?, changed_s = ? WHERE name = ?", values)
            connection.execute("DELETE FROM sessions WHERE name = ?", (normalise_name(name),))

    @staticmethod
    def _check_engineer_remains(connection: Connection, user: User, role: Role | None) -> None:
        (engineers,) = connection.execute("SELECT count(*) FROM users WHERE role = 'engineer'").fetchone()
        if user.role == "engineer" and role != "engineer" and engineers == 1:
            raise InputError(f"user {user.name}: is the last engineer; make another one first")


def normalise_name(name: str) -> str:
    """Return the stored form of a name: the same for every way of typing it."""
    return unicodedata.normalize("NFKC", name).casefold().encode("utf-8", "replace").decode()


def validate_name(name: str) -> str:
    """Return the stored form of a name, or raise InputError if no user can have it."""
    kept = normalise_name(name)
    if (
        not 1 <= len(kept) <= MAX_NAME_LENGTH
        or not all(c.isalnum() or c in "._-" for c in kept)
        or kept[0] in ".-"
    ):
        raise InputError(
            f"user {name[:MAX_NAME_LENGTH]!r}: a name has 1 to {MAX_NAME_LENGTH} letters, digits, dots, hyphens or "
            "underscores, and does not begin with a dot or hyphen"
        )
    if kept == ANONYMOUS:
        raise InputError(f"user {ANONYMOUS}: is reserved for users without a login; choose another name")
    return kept


def _validate_role(role: str) -> Role:
    if role not in ROLES:
        raise InputError(f"role {role!r}: must be one of {', '.join(ROLES)}")
    return role


def _get_user(connection: Connection, name: str) -> User:
    return _single_user(connection.execute(_FIND, (normalise_name(name),)).fetchall(), name)


def _single_user(rows: Sequence[tuple[Any, ...]], name: str) -> User:
    if not rows:
        raise InputError(f"user {name[:MAX_NAME_LENGTH]!r}: there is none; see the list of users")
    return User(*rows[0])


USER = "beltscape.user"
"""Key of the ASGI scope under which the guard stores the User, or None."""


def require_role(role: Role) -> Callable[[Request], User]:
    """Return a dependency that gives the user who has at least ``role``, and answers 401 or 403 otherwise."""

    def user(request: Request) -> User:
        caller = request.scope.get(USER)
        if caller is None:
            raise HTTPException(401, "log in first")
        if not caller.has_role(role):
            raise HTTPException(403, f"only for the role {role}; you are {caller.role}")
        return caller

    return user


def get_socket_user(websocket: WebSocket) -> User | None:
    """Return the user who opens a WebSocket; None: close it. The guard closes it when the session ends."""
    return websocket.scope.get(USER)


def get_address(connection: HTTPConnection) -> str:
    """Return a request's address as throttling and the audit log count addresses."""
    return normalise_address(connection.client.host) if connection.client else ""
