"""The users: added, removed, given passwords and roles. Works with or without the service running."""

from __future__ import annotations

import time
import unicodedata
from dataclasses import dataclass
from sqlite3 import Connection

from beltscape.core.errors import InputError
from beltscape.service.access.database import Database
from beltscape.service.access.passwords import Cost, accepted, hashed, matches
from beltscape.service.access.roles import ANONYMOUS, ROLES, Role, User

NAME_MOST = 32
_FIND = "SELECT name, role FROM users WHERE name = ?"


@dataclass(frozen=True, slots=True)
class Account:
    """What a list of users shows."""

    name: str
    role: Role
    created_s: int
    """System clock, seconds since 1970."""
    changed_s: int
    """When the password was last set."""
    sessions: int
    """Open ones."""


class Accounts:
    """The users in ``users.db``."""

    def __init__(self, database: Database, cost: Cost | None = None) -> None:
        self._database = database
        self._cost = cost or Cost()
        # compared where there is no such user, so that both take the same time
        self._nobody = hashed("nobody has this password", self._cost)

    @property
    def setup_open(self) -> bool:
        """Whether there has never been a user."""
        return not self._database.rows("SELECT 1 FROM facts WHERE key = 'setup_closed'")

    def list(self) -> tuple[Account, ...]:
        """All users by name."""
        rows = self._database.rows(
            "SELECT u.name, role, u.created_s, changed_s, count(token) FROM users u LEFT JOIN sessions s USING(name) "
            "GROUP BY u.name ORDER BY u.name"
        )
        return tuple(Account(*row) for row in rows)

    def find(self, name: str) -> User:
        """The user of that name, or InputError."""
        return _only(self._database.rows(_FIND, known_as(name)), name)

    def check(self, name: str, password: str) -> User | None:
        """The user of that name if the password is right; unknown users take as long."""
        rows = self._database.rows("SELECT name, role, password FROM users WHERE name = ?", known_as(name))
        known, role, kept = rows[0] if rows else (None, None, self._nobody)
        right = matches(password, kept)
        return User(known, role) if right and known else None

    def add(self, name: str, role: Role, password: str, *, first: bool = False) -> User:
        """A new user. InputError where the name, role or password does not do; ``first``: or there was one before."""
        user = User(usable(name), _role(role))
        kept = hashed(accepted(password, user.name), self._cost)
        now = int(time.time())
        with self._database.change() as change:
            if first and not self.setup_open:
                raise InputError("the setup is over: log in, or use `beltscape users` on the machine itself")
            if change.execute("SELECT 1 FROM users WHERE name = ?", (user.name,)).fetchone():
                raise InputError(f"user {user.name}: exists already; choose another name")
            change.execute("INSERT INTO users VALUES (?, ?, ?, ?, ?)", (user.name, user.role, kept, now, now))
            change.execute("INSERT OR REPLACE INTO facts VALUES ('setup_closed', ?)", (str(now),))
        return user

    def remove(self, name: str) -> None:
        """Take a user and all of his sessions away; not the last engineer."""
        with self._database.change() as change:
            self._leave_an_engineer(change, _there(change, name), None)
            change.execute("DELETE FROM users WHERE name = ?", (known_as(name),))

    def set_role(self, name: str, role: Role) -> None:
        """Another role, from the next request on; the last engineer keeps his."""
        with self._database.change() as change:
            self._leave_an_engineer(change, _there(change, name), _role(role))
            change.execute("UPDATE users SET role = ? WHERE name = ?", (role, known_as(name)))

    def set_password(self, name: str, password: str) -> None:
        """Another password; all of the user's sessions end."""
        kept = hashed(accepted(password, known_as(name)), self._cost)
        with self._database.change() as change:
            _there(change, name)
            values = (kept, int(time.time()), known_as(name))
            change.execute("UPDATE users SET password = ?, changed_s = ? WHERE name = ?", values)
            change.execute("DELETE FROM sessions WHERE name = ?", (known_as(name),))

    @staticmethod
    def _leave_an_engineer(change: Connection, user: User, role: Role | None) -> None:
        (engineers,) = change.execute("SELECT count(*) FROM users WHERE role = 'engineer'").fetchone()
        if user.role == "engineer" and role != "engineer" and engineers == 1:
            raise InputError(f"user {user.name}: is the last engineer; make another one first")


def known_as(name: str) -> str:
    """A name as it is kept: the same for every way of typing it."""
    return unicodedata.normalize("NFKC", name).casefold().encode("utf-8", "replace").decode()


def usable(name: str) -> str:
    """A name as it is kept, or InputError where no user can have it."""
    kept = known_as(name)
    if not 1 <= len(kept) <= NAME_MOST or not all(c.isalnum() or c in "._-" for c in kept) or kept[0] in ".-":
        raise InputError(
            f"user {name[:NAME_MOST]!r}: a name has 1 to {NAME_MOST} letters, digits, dots, hyphens or underscores, "
            "and does not begin with a dot or hyphen"
        )
    if kept == ANONYMOUS:
        raise InputError(f"user {ANONYMOUS}: is the name of those who are not logged in; choose another name")
    return kept


def _role(role: str) -> Role:
    if role not in ROLES:
        raise InputError(f"role {role!r}: must be one of {', '.join(ROLES)}")
    return role


def _there(change: Connection, name: str) -> User:
    return _only(change.execute(_FIND, (known_as(name),)).fetchall(), name)


def _only(rows: list[tuple], name: str) -> User:
    if not rows:
        raise InputError(f"user {name[:NAME_MOST]!r}: there is none; see the list of users")
    return User(*rows[0])
