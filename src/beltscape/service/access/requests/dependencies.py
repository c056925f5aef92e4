"""FastAPI dependencies of routes: the caller's user, role and address, as the guard has identified them."""

from __future__ import annotations

from collections.abc import Callable

from fastapi import HTTPException, Request, WebSocket
from starlette.requests import HTTPConnection

from beltscape.service.access.identity.roles import Role, User
from beltscape.service.access.limits.throttle import normalise_address

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
