"""The door: users, sessions, throttling and the audit log of one data folder."""

from __future__ import annotations

import hmac
import secrets
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.service.access.accounts import Accounts, known_as
from beltscape.service.access.audit import Audit
from beltscape.service.access.database import Database
from beltscape.service.access.keys import Keys
from beltscape.service.access.passwords import Cost
from beltscape.service.access.queue import PasswordQueue
from beltscape.service.access.roles import ANONYMOUS, User
from beltscape.service.access.sessions import Sessions
from beltscape.service.access.settings import AccessSettings
from beltscape.service.access.throttle import Buckets, Throttle


class Access:
    """Everything about who may come in. ``folder`` is the project's data folder; for any thread."""

    def __init__(
        self, folder: Path, settings: AccessSettings | None = None, cost: Cost | None = None
    ) -> None:
        self.settings = settings or AccessSettings()
        self._database = Database(folder)
        self.accounts = Accounts(self._database, cost)
        self.sessions = Sessions(
            self._database, self.settings.session_idle_hours * 3600, self.settings.session_days * 86_400
        )
        self.keys = Keys(self._database)
        self.audit = Audit(folder, int(self.settings.audit_file_mb * 1e6), self.settings.audit_files)
        self.throttle = Throttle()
        self.requests = Buckets(self.settings.requests_per_s, self.settings.requests_burst)
        self.passwords = PasswordQueue(self.throttle)
        self._setup_token = _spoken(secrets.token_hex(10))

    @property
    def setup_token(self) -> str | None:
        """What the first engineer is asked for at /setup; None once there has been a user. New at every start."""
        return self._setup_token if self.accounts.setup_open else None

    @property
    def invitation(self) -> str | None:
        """The line to print at the start while there is no user yet."""
        token = self.setup_token
        return (
            token
            and f"no user yet: open the page, give the setup token {token} and create the first engineer"
        )

    def set_up(self, token: str, name: str, password: str, address: str) -> User:
        """Create the first engineer. InputError where the token is wrong or the setup is over."""
        expected = self.setup_token
        right = hmac.compare_digest(_plain(token).encode(), _plain(self._setup_token).encode())
        if expected is None or not right:
            self.throttle.failed("", address)
            self.audit.write("setup failed", ANONYMOUS, address)
            if expected is None:
                raise InputError("the setup is over: log in, or use `beltscape users` on the machine itself")
            raise InputError("setup token: is not the one that the program printed at its start")
        user = self.accounts.add(name, "engineer", password, first=True)
        self.audit.write("setup", user.name, address, {"role": user.role})
        return user

    def log_in(self, name: str, password: str, address: str) -> str | None:
        """A new session's token; None where name or password is wrong. Ask ``throttle.wait_s`` before."""
        user = self._checked(name, password, address, "login")
        if user is None:
            return None
        self.audit.write("login", user.name, address)
        return self._opened(user, address)

    def change_password(self, user: User, old: str, new: str, address: str) -> str | None:
        """All of the user's sessions end; a new one's token. None where the old password is wrong."""
        if self._checked(user.name, old, address, "password change") is None:
            return None
        self.accounts.set_password(user.name, new)
        self.audit.write("password changed", user.name, address, {"user": user.name})
        return self._opened(user, address)

    def _checked(self, name: str, password: str, address: str, what: str) -> User | None:
        name = known_as(name)
        user = self.accounts.check(name, password)
        if user is None:
            self.throttle.failed(name, address)
            self.audit.write(f"{what} failed", name, address)
        else:
            self.throttle.succeeded(user.name, address)
        return user

    def _opened(self, user: User, address: str) -> str:
        try:
            return self.sessions.open(user, address)
        except OutputError:
            return self.sessions.open_unkept(user)

    def who(self, token: str | None, *, touch: bool = True) -> User | None:
        """Whose session it is; without one whoever ``anonymous_role`` says, or None."""
        user = self.sessions.find(token, touch=touch) if token else None
        if user is None and self.settings.anonymous_role is not None:
            return User(ANONYMOUS, self.settings.anonymous_role)
        return user

    @staticmethod
    def anonymous(user: User) -> bool:
        """Whether somebody has not logged in."""
        return user.name == ANONYMOUS

    def close(self) -> None:
        """No more is asked."""
        self.passwords.close()
        self._database.close()


def _spoken(token: str) -> str:
    return "-".join(token[i : i + 4] for i in range(0, len(token), 4))


def _plain(token: str) -> str:
    return "".join(c for c in token.lower() if c.isascii() and c.isalnum())
