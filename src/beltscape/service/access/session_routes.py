"""/api/access: the setup, logging in and out, one's own password."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import JSONResponse

from beltscape.service.access.access import Access
from beltscape.service.access.accounts import known_as
from beltscape.service.access.bodies import Credentials, FirstEngineer, NewPassword, Viewer
from beltscape.service.access.cookie import give, session_of, take_away
from beltscape.service.access.depends import USER, address_of
from beltscape.service.access.roles import ANONYMOUS
from beltscape.service.access.sessions import page_token


class SessionRoutes:
    """The routes by which somebody comes and goes."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def add_to(self, routes: APIRouter) -> None:
        """Put them under ``routes``."""
        routes.add_api_route("/state", self.state, methods=["GET"])
        routes.add_api_route("/setup", self.set_up, methods=["POST"], status_code=201)
        routes.add_api_route("/login", self.log_in, methods=["POST"])
        routes.add_api_route("/logout", self.log_out, methods=["POST"])
        routes.add_api_route("/password", self.password, methods=["POST"])

    def state(self, request: Request) -> dict[str, Any]:
        """Who one is, whether the setup is open, and the token to send with changes."""
        user, token = request.scope.get(USER), session_of(request)
        named = user is not None and user.name != ANONYMOUS
        return {
            "setup": self._access.setup_token is not None,
            "user": {"name": user.name, "role": user.role} if user else None,
            "named": named,
            "token": page_token(token) if named and token else None,
        }

    async def set_up(self, body: FirstEngineer, request: Request) -> Response:
        """Create the first engineer and log him in."""
        access, address = self._access, address_of(request)

        def first() -> str | None:
            access.set_up(body.token, body.name, body.password, address)
            return access.log_in(body.name, body.password, address)

        token = await access.passwords.guess(first, "", address)
        return self._welcome(request, token, 201)

    async def log_in(self, body: Credentials, request: Request) -> Response:
        """Open a session."""
        access, address = self._access, address_of(request)

        def enter() -> str | None:
            return access.log_in(body.name, body.password, address)

        token = await access.passwords.guess(enter, known_as(body.name), address)
        return self._welcome(request, token, 200)

    def log_out(self, request: Request, user: Viewer) -> Response:
        """End the session."""
        token = session_of(request)
        if token and user.name != ANONYMOUS:
            self._access.sessions.close(token)
            self._access.audit.write("logout", user.name, address_of(request))
        response = JSONResponse({"user": None})
        take_away(response, request)
        return response

    async def password(self, body: NewPassword, request: Request, user: Viewer) -> Response:
        """Change one's own password; all sessions end but a new one."""
        access, address = self._access, address_of(request)

        def change() -> str | None:
            return access.change_password(user, body.old, body.new, address)

        token = await access.passwords.guess(change, user.name, address)
        return self._welcome(request, token, 200)

    def _welcome(self, request: Request, token: str | None, status: int) -> Response:
        if token is None:
            raise HTTPException(401, "name or password is wrong")
        old = session_of(request)
        if old:
            self._access.sessions.close(old)
        user = self._access.who(token)
        named = {"name": user.name, "role": user.role} if user else None
        response = JSONResponse({"user": named, "token": page_token(token)}, status_code=status)
        give(response, request, token, self._access.settings.session_days * 86_400)
        return response
