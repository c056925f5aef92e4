"""The session's cookie."""

from __future__ import annotations

from starlette.requests import HTTPConnection
from starlette.responses import Response

TOKEN_HEADER = "x-beltscape-token"
"""Header in which the page sends its token with everything that changes something."""


def session_of(connection: HTTPConnection) -> str | None:
    """The session's token that a request brings, or None."""
    token = connection.cookies.get(_name(connection))
    return token if token and len(token) <= 100 else None


def give(response: Response, connection: HTTPConnection, token: str, life_s: float) -> None:
    """Have the browser keep a token: no script sees it, no other site sends it."""
    https = connection.scope["scheme"] == "https"
    response.set_cookie(
        _name(connection),
        token,
        max_age=int(life_s),
        path="/",
        secure=https,
        httponly=True,
        samesite="strict",
    )


def take_away(response: Response, connection: HTTPConnection) -> None:
    """Have the browser forget it."""
    https = connection.scope["scheme"] == "https"
    response.delete_cookie(_name(connection), path="/", secure=https, httponly=True, samesite="strict")


def _name(connection: HTTPConnection) -> str:
    # the prefix binds the cookie to this host and to TLS
    return "__Host-beltscape" if connection.scope["scheme"] in ("https", "wss") else "beltscape"
