"""Routes of /api/access for setup, login, logout and one's own password."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import JSONResponse

from beltscape.service.access.access import Access
from beltscape.service.access.identity.accounts import normalise_name
from beltscape.service.access.identity.cookie import (
    delete_session_cookie,
    read_session_token,
    set_session_cookie,
)
from beltscape.service.access.identity.roles import ANONYMOUS
from beltscape.service.access.identity.sessions import derive_page_token
from beltscape.service.access.requests.dependencies import USER, get_address
from beltscape.service.access.routes.bodies import Credentials, FirstEngineer, NewPassword, Viewer


class SessionRoutes:
    """The routes of setup, login, logout and password change."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def add_to(self, routes: APIRouter) -> None:
        """Add the routes to ``routes``."""
        routes.add_api_route("/state", self.state, methods=["GET"])
        routes.add_api_route("/setup", self.set_up, methods=["POST"], status_code=201)
        routes.add_api_route("/login", self.log_in, methods=["POST"])
        routes.add_api_route("/logout", self.log_out, methods=["POST"])
        routes.add_api_route("/password", self.password, methods=["POST"])

    def state(self, request: Request) -> dict[str, Any]:
        """Return the user, whether the setup is open, and the token to send with changes."""
        user, token = request.scope.get(USER), read_session_token(request)
        is_named = user is not None and user.name != ANONYMOUS
        return {
            "setup": self._access.setup_token is not None,
            "user": {"name": user.name, "role": user.role} if user else None,
            "named": is_named,
            "token": derive_page_token(token) if is_named and token else None,
        }

    async def set_up(self, body: FirstEngineer, request: Request) -> Response:
        """Create the first engineer and open a session."""
        access, address = self._access, get_address(request)

        def create_and_log_in() -> str | None:
            access.set_up(body.token, body.name, body.password, address)
            return access.log_in(body.name, body.password, address)

        token = await access.passwords.run_throttled(create_and_log_in, "", address)
        return self._respond_with_session(request, token, 201)

    async def log_in(self, body: Credentials, request: Request) -> Response:
        """Open a session."""
        access, address = self._access, get_address(request)

        def check_password() -> str | None:
            return access.log_in(body.name, body.password, address)

        token = await access.passwords.run_throttled(check_password, normalise_name(body.name), address)
        return self._respond_with_session(request, token, 200)

    def log_out(self, request: Request, user: Viewer) -> Response:
        """End the session."""
        token = read_session_token(request)
        if token and user.name != ANONYMOUS:
            self._access.sessions.close(token)
            self._access.audit.write("logout", user.name, get_address(request))
        response = JSONResponse({"user": None})
        delete_session_cookie(response, request)
        return response

    async def password(self, body: NewPassword, request: Request, user: Viewer) -> Response:
        """Change one's own password, end all sessions and open a new one."""
        access, address = self._access, get_address(request)

        def change() -> str | None:
            return access.change_password(user, body.old, body.new, address)

        token = await access.passwords.run_throttled(change, user.name, address)
        return self._respond_with_session(request, token, 200)

    def _respond_with_session(self, request: Request, token: str | None, status: int) -> Response:
        if token is None:
            raise HTTPException(401, "name or password is wrong")
        old = read_session_token(request)
        if old:
            self._access.sessions.close(old)
        user = self._access.identify(token)
        named = {"name": user.name, "role": user.role} if user else None
        response = JSONResponse({"user": named, "token": derive_page_token(token)}, status_code=status)
        set_session_cookie(response, request, token, self._access.settings.session_days * 86_400)
        return response
