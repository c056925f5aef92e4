"""What a route asks about whoever calls it. The guard has looked already; these only read what it found."""

from __future__ import annotations

from collections.abc import Callable

from fastapi import HTTPException, Request, WebSocket
from starlette.requests import HTTPConnection

from beltscape.service.access.roles import Role, User
from beltscape.service.access.throttle import network

USER = "beltscape.user"
"""Key of the scope under which the guard puts the User, or None."""


def needs(role: Role) -> Callable[[Request], User]:
    """A dependency that gives the user if he may do what ``role`` may, else answers 401 or 403."""

    def user(request: Request) -> User:
        found = request.scope.get(USER)
        if found is None:
            raise HTTPException(401, "log in first")
        if not found.may(role):
            raise HTTPException(403, f"only for the role {role}; you are {found.role}")
        return found

    return user


def socket_user(websocket: WebSocket) -> User | None:
    """Who opens a WebSocket; None: close it. The guard closes it when the session ends."""
    return websocket.scope.get(USER)


def address_of(connection: HTTPConnection) -> str:
    """Where a request comes from, as throttling and the audit log count addresses."""
    return network(connection.client.host) if connection.client else ""
