"""/api/access: what engineers do about users, and the audit log."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

from beltscape.service.access.access import Access
from beltscape.service.access.accounts import known_as
from beltscape.service.access.bodies import Changes, Engineer, Name, NewUser
from beltscape.service.access.depends import address_of
from beltscape.service.access.queue import or_conflict


class UserRoutes:
    """The routes about users; for engineers."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def add_to(self, routes: APIRouter) -> None:
        """Put them under ``routes``."""
        routes.add_api_route("/users", self.users, methods=["GET"])
        routes.add_api_route("/users", self.add, methods=["POST"], status_code=201)
        routes.add_api_route("/users/{name}", self.change, methods=["PATCH"])
        routes.add_api_route("/users/{name}", self.remove, methods=["DELETE"])
        routes.add_api_route("/audit", self.audit, methods=["GET"])

    def users(self, _: Engineer) -> list[dict[str, Any]]:
        """All users: name, role, when created and given their password, open sessions."""
        return [asdict(account) for account in self._access.accounts.list()]

    async def add(self, body: NewUser, request: Request, user: Engineer) -> dict[str, str]:
        """Add one."""
        access, address = self._access, address_of(request)
        new = await access.passwords.run(lambda: access.accounts.add(body.name, body.role, body.password))
        access.audit.write("user added", user.name, address, {"user": new.name, "role": new.role})
        return {"name": new.name, "role": new.role}

    async def change(self, name: Name, body: Changes, request: Request, user: Engineer) -> dict[str, str]:
        """Another role or password for one; a new password ends his sessions."""
        access, address, kept = self._access, address_of(request), known_as(name)

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
        """Take one away, with his sessions."""
        or_conflict(lambda: self._access.accounts.remove(name))
        self._access.audit.write("user removed", user.name, address_of(request), {"user": known_as(name)})
        return {"name": known_as(name)}

    def audit(self, _: Engineer, most: Annotated[int, Query(ge=1, le=1000)] = 200) -> list[dict[str, Any]]:
        """What was done last, newest first."""
        return self._access.audit.last(most)
