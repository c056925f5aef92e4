"""The session cookie: read from a request, set and deleted in a response."""

from __future__ import annotations

from starlette.requests import HTTPConnection
from starlette.responses import Response

PATH_PREFIX = "beltscape.path_prefix"
"""Key of the ASGI scope under which the server stores the path, such as "/belt4", of a trusted proxy's page."""
TOKEN_HEADER = "x-beltscape-token"
"""Header in which the page sends its token with every request that changes something."""
_LONGEST = 100
"""Characters of a token; a longer one is none: 32 bytes have 43 characters in base64."""


def read_session_token(connection: HTTPConnection) -> str | None:
    """Return a request's session token, or None."""
    token = connection.cookies.get(_cookie_name(connection))
    return token if token and len(token) <= _LONGEST else None


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
