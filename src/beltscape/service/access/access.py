"""Access control of one data folder: users, sessions, keys, throttling and the audit log together."""

from __future__ import annotations

import hmac
import logging
import secrets
from pathlib import Path

from beltscape.core.errors import InputError, OutputError
from beltscape.service.access.accounts import ANONYMOUS, Accounts, User, normalise_name
from beltscape.service.access.audit import Audit
from beltscape.service.access.database import Database, UsersUnreadableError
from beltscape.service.access.passwords import PasswordQueue, ScryptCost
from beltscape.service.access.sessions import Keys, Sessions
from beltscape.service.access.throttle import Throttle, TokenBuckets
from beltscape.service.settings import AccessSettings


class Access:
    """Identifies users and programs. ``folder`` is the project's data folder. Thread-safe."""

    def __init__(
        self, folder: Path, settings: AccessSettings | None = None, cost: ScryptCost | None = None
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
        self.requests = TokenBuckets(self.settings.requests_per_s, self.settings.requests_burst)
        self.passwords = PasswordQueue(self.throttle)
        self._is_setup_logged = False
        self._setup_token = _format_token(secrets.token_hex(10))

    @property
    def setup_token(self) -> str | None:
        """Token that /setup asks of the first engineer, new at every start; None once there has been a user.

        It is logged once while there is no user.
        """
        if not self._is_setup_open():
            self._is_setup_logged = False
            return None
        if not self._is_setup_logged:
            self._is_setup_logged = True
            logging.getLogger("beltscape.access").warning(
                "no user yet: open the page, give the setup token %s and create the first engineer",
                self._setup_token,
            )
        return self._setup_token

    def set_settings(self, settings: AccessSettings) -> None:
        """Hold sessions, requests and the audit log to other settings from now on."""
        self.settings = settings
        self.sessions.set_lives(settings.session_idle_hours * 3600, settings.session_days * 86_400)
        self.requests.set_rate(settings.requests_per_s, settings.requests_burst)
        self.audit.set_size(int(settings.audit_file_mb * 1e6), settings.audit_files)

    @property
    def trouble(self) -> str:
        """Why nobody can sign in, in one line; empty without a fault."""
        return self._database.trouble

    def _is_setup_open(self) -> bool:
        try:
            return self.accounts.is_setup_open
        except (UsersUnreadableError, OutputError):  # there may be users: nobody may become the first one
            return False

    def set_up(self, token: str, name: str, password: str, address: str) -> User:
        """Create the first engineer. InputError if the token is wrong or the setup is over."""
        expected = self.setup_token
        is_right = hmac.compare_digest(
            _normalise_token(token).encode(), _normalise_token(self._setup_token).encode()
        )
        if expected is None or not is_right:
            self.throttle.count_failure("", address)
            self.audit.write("setup failed", ANONYMOUS, address)
            if expected is None:
                raise InputError("the setup is over: log in, or use `beltscape users` on the machine itself")
            raise InputError("setup token: is not the one that the program printed at its start")
        user = self.accounts.add(name, "engineer", password, first=True)
        self.audit.write("setup", user.name, address, {"role": user.role})
        return user

    def log_in(self, name: str, password: str, address: str) -> str | None:
        """Return a new session's token; None if name or password is wrong. Check ``throttle.wait_s`` first."""
        user = self.verify_login(name, password, address)
        return None if user is None else self._open_session(user, address)

    def verify_login(self, name: str, password: str, address: str) -> User | None:
        """Return the user; None if name or password is wrong. Check ``throttle.wait_s`` first."""
        user = self._verify_password(name, password, address, "login")
        if user is not None:
            self.audit.write("login", user.name, address)
        return user

    def change_password(self, user: User, old: str, new: str, address: str) -> str | None:
        """Change the password, end all sessions and return a new one's token; None if ``old`` is wrong."""
        if self._verify_password(user.name, old, address, "password change") is None:
            return None
        self.accounts.set_password(user.name, new)
        self.audit.write("password changed", user.name, address, {"user": user.name})
        return self._open_session(user, address)

    def _verify_password(self, name: str, password: str, address: str, action: str) -> User | None:
        name = normalise_name(name)
        user = self.accounts.check(name, password)
        if user is None:
            self.throttle.count_failure(name, address)
            self.audit.write(f"{action} failed", name, address)
        else:
            self.throttle.count_success(user.name, address)
        return user

    def _open_session(self, user: User, address: str) -> str:
        try:
            return self.sessions.open(user, address)
        except OutputError:
            return self.sessions.open_in_memory(user)

    def identify(self, token: str | None, *, touch: bool = True) -> User | None:
        """Return the session's user; without a session the anonymous user if the settings allow one, else None."""
        user = self.sessions.find(token, touch=touch) if token else None
        if user is None and self.settings.anonymous_role is not None:
            return User(ANONYMOUS, self.settings.anonymous_role)
        return user

    @staticmethod
    def is_anonymous(user: User) -> bool:
        """Return whether the user has not logged in."""
        return user.name == ANONYMOUS

    def close(self) -> None:
        """Close the database and the password thread."""
        self.passwords.close()
        self._database.close()


def _format_token(token: str) -> str:
    return "-".join(token[i : i + 4] for i in range(0, len(token), 4))


def _normalise_token(token: str) -> str:
    return "".join(c for c in token.lower() if c.isascii() and c.isalnum())
