"""Routes of /api/access: setup, login, logout and one's own password; user management and the audit log."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, HTTPException, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field

from beltscape.service.access.access import Access
from beltscape.service.access.accounts import (
    ANONYMOUS,
    USER,
    Role,
    User,
    get_address,
    normalise_name,
    require_role,
)
from beltscape.service.access.passwords import MAX_LENGTH, convert_input_errors
from beltscape.service.access.sessions import (
    delete_session_cookie,
    derive_page_token,
    read_session_token,
    set_session_cookie,
)

Name = Annotated[str, Field(min_length=1, max_length=64)]
Password = Annotated[str, Field(min_length=1, max_length=MAX_LENGTH)]
Viewer = Annotated[User, Depends(require_role("viewer"))]
Engineer = Annotated[User, Depends(require_role("engineer"))]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Credentials(_Body):
    """Name and password of a login."""

    name: Name
    password: Password


class FirstEngineer(Credentials):
    """The engineer that the setup creates."""

    token: Annotated[str, Field(min_length=1, max_length=64)]
    """Setup token that the program printed at its start."""


class NewPassword(_Body):
    """A change of one's own password."""

    old: Password
    new: Password


class NewUser(Credentials):
    """A user to add."""

    role: Role


class Changes(_Body):
    """Changes of a user; fields left out stay as they are."""

    role: Role | None = None
    password: Password | None = None


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


class UserRoutes:
    """The routes of user management; for engineers."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def add_to(self, routes: APIRouter) -> None:
        """Add the routes to ``routes``."""
        routes.add_api_route("/users", self.users, methods=["GET"])
        routes.add_api_route("/users", self.add, methods=["POST"], status_code=201)
        routes.add_api_route("/users/{name}", self.change, methods=["PATCH"])
        routes.add_api_route("/users/{name}", self.remove, methods=["DELETE"])
        routes.add_api_route("/audit", self.audit, methods=["GET"])

    def users(self, _: Engineer) -> list[dict[str, Any]]:
        """Return all users: name, role, times of creation and last password change, open sessions."""
        return [asdict(account) for account in self._access.accounts.list()]

    async def add(self, body: NewUser, request: Request, user: Engineer) -> dict[str, str]:
        """Add a user."""
        access, address = self._access, get_address(request)
        new = await access.passwords.run(lambda: access.accounts.add(body.name, body.role, body.password))
        access.audit.write("user added", user.name, address, {"user": new.name, "role": new.role})
        return {"name": new.name, "role": new.role}

    async def change(self, name: Name, body: Changes, request: Request, user: Engineer) -> dict[str, str]:
        """Change a user's role or password; a new password ends the user's sessions."""
        access, address, kept = self._access, get_address(request), normalise_name(name)

        def apply() -> None:
            access.accounts.find(name)
            if body.role is not None:
                access.accounts.set_role(name, body.role)
                access.audit.write("role changed", user.name, address, {"user": kept, "role": body.role})
            if body.password is not None:
                access.accounts.set_password(name, body.password)
                access.audit.write("password changed", user.name, address, {"user": kept})

        await access.passwords.run(apply)
        return {"name": kept}

    def remove(self, name: Name, request: Request, user: Engineer) -> dict[str, str]:
        """Remove a user with all sessions."""
        convert_input_errors(lambda: self._access.accounts.remove(name))
        self._access.audit.write(
            "user removed", user.name, get_address(request), {"user": normalise_name(name)}
        )
        return {"name": normalise_name(name)}

    def audit(self, _: Engineer, most: Annotated[int, Query(ge=1, le=1000)] = 200) -> list[dict[str, Any]]:
        """Return the last entries of the audit log, newest first."""
        return self._access.audit.read_last(most)
