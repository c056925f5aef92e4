"""/api/access: logging in and out, the setup, users, the audit log."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Depends, HTTPException, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import InputError
from beltscape.service.access.access import Access
from beltscape.service.access.accounts import known_as
from beltscape.service.access.cookie import give, session_of, take_away
from beltscape.service.access.depends import USER, address_of, needs
from beltscape.service.access.passwords import MOST
from beltscape.service.access.roles import ANONYMOUS, Role, User
from beltscape.service.access.sessions import page_token

WAITING = 8
"""Passwords that may wait to be looked at; whoever comes then is sent away."""

Name = Annotated[str, Field(min_length=1, max_length=64)]
Password = Annotated[str, Field(min_length=1, max_length=MOST)]
Result = TypeVar("Result")


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Credentials(_Body):
    """Who logs in."""

    name: Name
    password: Password


class Setup(Credentials):
    """The first engineer."""

    token: Annotated[str, Field(min_length=1, max_length=64)]


class NewPassword(_Body):
    """One's own password."""

    old: Password
    new: Password


class NewUser(Credentials):
    """A further user."""

    role: Role


class Changes(_Body):
    """What becomes different about a user; what is left out stays."""

    role: Role | None = None
    password: Password | None = None


def router(access: Access) -> APIRouter:
    """The routes of one door."""
    routes = APIRouter(prefix="/api/access", tags=["access"])
    queue = _Queue(access)
    viewer, engineer = Depends(needs("viewer")), Depends(needs("engineer"))

    @routes.get("/state")
    def state(request: Request) -> dict[str, Any]:
        """Who one is, whether the setup is open, and the token to send with changes."""
        user, token = request.scope.get(USER), session_of(request)
        named = user is not None and user.name != ANONYMOUS
        return {
            "setup": access.setup_token is not None,
            "user": {"name": user.name, "role": user.role} if user else None,
            "named": named,
            "token": page_token(token) if named and token else None,
        }

    @routes.post("/setup", status_code=201)
    async def setup(body: Setup, request: Request) -> Response:
        """Create the first engineer and log him in."""
        address = address_of(request)

        def first() -> str | None:
            access.set_up(body.token, body.name, body.password, address)
            return access.log_in(body.name, body.password, address)

        return _welcome(access, request, await queue.run(first, "", address), 201)

    @routes.post("/login")
    async def login(body: Credentials, request: Request) -> Response:
        """Open a session."""
        address = address_of(request)

        def enter() -> str | None:
            return access.log_in(body.name, body.password, address)

        return _welcome(access, request, await queue.run(enter, known_as(body.name), address), 200)

    @routes.post("/logout")
    def logout(request: Request, user: User = viewer) -> Response:
        """End the session."""
        token = session_of(request)
        if token:
            access.sessions.close(token)
            access.audit.write("logout", user.name, address_of(request))
        response = JSONResponse({"user": None})
        take_away(response, request)
        return response

    @routes.post("/password")
    async def password(body: NewPassword, request: Request, user: User = viewer) -> Response:
        """Change one's own password; all sessions end but a new one."""
        address = address_of(request)

        def change() -> str | None:
            if access.log_in(user.name, body.old, address) is None:
                return None
            access.accounts.set_password(user.name, body.new)
            access.audit.write("password changed", user.name, address, {"user": user.name})
            return access.log_in(user.name, body.new, address)

        return _welcome(access, request, await queue.run(change, user.name, address), 200)

    @routes.get("/users")
    def users(_: User = engineer) -> list[dict[str, Any]]:
        """All users."""
        return [
            {"name": u.name, "role": u.role, "created_s": u.created_s, "changed_s": u.changed_s, "sessions": u.sessions}
            for u in access.accounts.list()
        ]  # fmt: skip

    @routes.post("/users", status_code=201)
    async def add(body: NewUser, request: Request, user: User = engineer) -> dict[str, str]:
        """Add one."""
        address = address_of(request)
        new = await queue.run(lambda: access.accounts.add(body.name, body.role, body.password), "", address)
        access.audit.write("user added", user.name, address, {"user": new.name, "role": new.role})
        return {"name": new.name, "role": new.role}

    @routes.patch("/users/{name}")
    async def change(name: Name, body: Changes, request: Request, user: User = engineer) -> dict[str, str]:
        """Another role or password for one."""
        address = address_of(request)

        def apply() -> None:
            if body.role is not None:
                access.accounts.set_role(name, body.role)
                access.audit.write(
                    "role changed", user.name, address, {"user": known_as(name), "role": body.role}
                )
            if body.password is not None:
                access.accounts.set_password(name, body.password)
                access.audit.write("password changed", user.name, address, {"user": known_as(name)})

        await queue.run(apply, "", address)
        return {"name": known_as(name)}

    @routes.delete("/users/{name}")
    def remove(name: Name, request: Request, user: User = engineer) -> dict[str, str]:
        """Take one away."""
        with_answer(lambda: access.accounts.remove(name))
        access.audit.write("user removed", user.name, address_of(request), {"user": known_as(name)})
        return {"name": known_as(name)}

    @routes.get("/audit")
    def audit(
        most: Annotated[int, Field(ge=1, le=1000)] = 200, _: User = engineer
    ) -> list[dict[str, str | int | float]]:
        """What was done last, newest first."""
        return access.audit.last(most)

    return routes


class _Queue:
    """Slow work on passwords: one at a time, few waiting, and none for whoever guesses."""

    def __init__(self, access: Access) -> None:
        self._access = access
        self._waiting = 0

    async def run(self, work: Callable[[], Result], name: str, address: str) -> Result:
        """``work`` in the thread for passwords; ``name``: the account it may be guessing."""

        def unless_guessing() -> Result:
            wait_s = self._access.throttle.wait_s(name, address)
            if wait_s:
                raise _wait(wait_s)
            return with_answer(work)

        if self._waiting >= WAITING:
            raise _wait(2)
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._access.guesses, unless_guessing)
        finally:
            self._waiting -= 1


def with_answer(work: Callable[[], Result]) -> Result:
    """What ``work`` gives; where its input does not do, the answer 409 with its message."""
    try:
        return work()
    except InputError as error:
        raise HTTPException(409, str(error)) from error


def _wait(wait_s: float) -> HTTPException:
    seconds = math.ceil(wait_s)
    return HTTPException(429, f"try again in {seconds} s", {"retry-after": str(seconds)})


def _welcome(access: Access, request: Request, token: str | None, status: int) -> Response:
    if token is None:
        raise HTTPException(401, "name or password is wrong")
    user = access.who(token)
    old = session_of(request)
    if old and old != token:
        access.sessions.close(old)
    named = {"name": user.name, "role": user.role} if user else None
    response = JSONResponse({"user": named, "token": page_token(token)}, status_code=status)
    give(response, request, token, access.settings.session_days * 86_400)
    return response
