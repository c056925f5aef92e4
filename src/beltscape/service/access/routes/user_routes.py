"""Routes of /api/access for user management and the audit log."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

from beltscape.service.access.access import Access
from beltscape.service.access.identity.accounts import normalise_name
from beltscape.service.access.limits.queue import convert_input_errors
from beltscape.service.access.requests.dependencies import get_address
from beltscape.service.access.routes.bodies import Changes, Engineer, Name, NewUser


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
