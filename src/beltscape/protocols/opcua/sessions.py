"""Sessions that only accepted clients with a known user open, and that end with their user.

The library leaves four gaps that are closed here. It checks the certificate that a client names when it creates a
session, not the one that its channel was opened with. It attaches a session to another channel before it checks who
asks. It registers servers for discovery without a session. And it calls methods without their caller.
"""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager

from beltscape.protocols.opcua.certificates import ClientCertificates
from beltscape.protocols.plant import PlantUsers
from beltscape.protocols.settings import OpcUaSettings

_MOST_CONNECTIONS = 200
"""Connections at the same time; a plant has some ten clients. Chosen."""
_ACTIVATION_S = 10.0
"""Time for a connection to sign in, after which it is closed: a hundred times what a client needs. Chosen."""
_MOST_SUBSCRIPTIONS = 500
"""Subscriptions of all clients together. Chosen."""


@dataclass(frozen=True, slots=True)
class Caller:
    """The user and client of a request."""

    user: str
    """Name of the user; empty: nobody has signed in."""
    address: str


_NOBODY = Caller("", "")
_CALLER: ContextVar[Caller] = ContextVar("opcua_caller", default=_NOBODY)


def find_caller() -> Caller:
    """Return who called the method that runs now."""
    return _CALLER.get()


class GuardedServer(InternalServer):
    """A server whose sessions check certificate and user."""

    def __init__(self, settings: OpcUaSettings, clients: ClientCertificates, users: PlantUsers) -> None:
        """Prepare; nothing listens yet."""
        self.settings, self.clients, self.users = settings, clients, users
        self.sessions: set[GuardedSession] = set()
        """Sessions of users that are open."""
        super().__init__(user_manager=_Users(settings, users))
        self.allow_remote_admin = False
        self.max_connections = _MOST_CONNECTIONS
        self.max_pending_activation_seconds = _ACTIVATION_S
        self.max_subscriptions = _MOST_SUBSCRIPTIONS
        self.bind_condition_methods = True

    def create_session(
        self,
        name: Any,
        user: User | None = None,
        external: bool = False,
    ) -> InternalSession:
        """Return a new session of a client; ``name`` is the client's address."""
        anonymous = User(role=UserRole.Anonymous)
        return GuardedSession(
            self, self.aspace, self.subscription_service, name, user=user or anonymous, external=external
        )

    def lookup_external_session(self, auth_token: ua.NodeId) -> InternalSession | None:  # noqa: ARG002
        """Return None: a session stays on its channel, and a client that lost the channel makes a new one."""
        return None

    def register_external_session(self, session: InternalSession) -> None:
        """Keep nothing: sessions that are never activated would stay for ever."""

    def register_server(self, server: Any, conf: Any = None) -> None:  # noqa: ARG002
        """Refuse: this is no discovery server."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    def register_server2(self, params: ua.RegisterServer2Parameters) -> None:  # noqa: ARG002
        """Refuse: this is no discovery server."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    async def end_orphaned_sessions(self) -> None:
        """Close the sessions whose user was removed."""
        for session in list(self.sessions):
            name = session.user.name
            if session.is_activated() and name and not self.users.has_role(name, "viewer"):
                await session.close_session()


class GuardedSession(InternalSession):
    """A session of one client."""

    iserver: GuardedServer
    _application = ""

    @property
    def address(self) -> str:
        """Return the address that the client calls from."""
        return self.name if isinstance(self.name, str) else self.name[0]

    async def create_session(
        self, params: ua.CreateSessionParameters, sockname: tuple[str, int] | None = None
    ) -> ua.CreateSessionResult:
        """Create the session of the application that the client says to be."""
        self._application = params.ClientDescription.ApplicationUri or ""
        return await super().create_session(params, sockname)

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        """Admit the user, if the certificate of the channel is accepted; ServiceError otherwise."""
        if peer_certificate:
            self.iserver.clients.check(peer_certificate, self._application)
        elif self.iserver.settings.security != "none":
            raise ServiceError(ua.StatusCodes.BadSecurityModeRejected)
        token = _CALLER.set(Caller("", self.address))
        try:
            result = super().activate_session(params, peer_certificate)
            self.iserver.sessions.add(self)
            return result
        finally:
            _CALLER.reset(token)

    async def close_session(self, delete_subs: bool = True) -> None:
        """Close the session, with its subscriptions."""
        self.iserver.sessions.discard(self)
        await super().close_session(delete_subs)

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Call methods in the user's name."""
        token = _CALLER.set(Caller(self.user.name or "", self.address))
        try:
            return await super().call(params)
        finally:
            _CALLER.reset(token)


class _Users(UserManager):
    """Admits the service's users, and nobody else unless the settings say so."""

    def __init__(self, settings: OpcUaSettings, users: PlantUsers) -> None:
        self._settings, self._users = settings, users

    def get_user(
        self,
        iserver: InternalServer,  # noqa: ARG002
        username: str | None = None,
        password: str | None = None,
        certificate: Any = None,  # noqa: ARG002
    ) -> User | None:
        if not username:
            allowed = self._settings.anonymous_role is not None
            return User(role=UserRole.User, name="") if allowed else None
        name = self._users.find_by_password(username, password or "", find_caller().address)
        return None if name is None else User(role=UserRole.User, name=name)
