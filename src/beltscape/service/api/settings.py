"""Endpoints for engineers: what project.toml would change, and its taking over while the plant runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Protocol

from fastapi import APIRouter, Depends, HTTPException, Request

from beltscape.core.errors import BeltscapeError
from beltscape.service.access import User, require_role
from beltscape.service.access.accounts import get_address
from beltscape.service.api.common import ResponseModel, describe_refusals
from beltscape.service.changes import Changed
from beltscape.service.reloader import Reload


class Reloader(Protocol):
    """A reader of changed settings; ``SettingsReloader`` is one."""

    def find_changes(self) -> Reload:
        """Return what a reload would change now; BeltscapeError where the project cannot be read."""
        ...

    def reload(self, by: str, address: str = "") -> Reload:
        """Take over what changed; BeltscapeError where the project is refused."""
        ...


class ChangedOut(ResponseModel):
    """A setting that differs between project.toml and the running plant."""

    key: str
    before: str
    after: str


class ReloadOut(ResponseModel):
    """The changes that take effect at once, and those that need a restart."""

    at_once: list[ChangedOut]
    restart: list[ChangedOut]


def make_router(reloader: Reloader) -> APIRouter:
    """Return the routes of the settings."""
    router = APIRouter(prefix="/api/settings", tags=["settings"])

    @router.get("/changes", responses=describe_refusals(409))
    def find_changes(_user: Annotated[User, Depends(require_role("engineer"))]) -> ReloadOut:
        """Return what reading project.toml again would change now; nothing changes."""
        return _describe(reloader.find_changes)

    @router.post("/reload", responses=describe_refusals(409))
    def reload(request: Request, user: Annotated[User, Depends(require_role("engineer"))]) -> ReloadOut:
        """Read project.toml, and the files that it names, again; all is checked before anything changes."""
        return _describe(lambda: reloader.reload(user.name, get_address(request)))

    return router


def _describe(call: Callable[[], Reload]) -> ReloadOut:
    try:
        done = call()
    except BeltscapeError as error:
        raise HTTPException(409, str(error)) from error
    return ReloadOut(at_once=_list(done.at_once), restart=_list(done.restart))


def _list(changes: tuple[Changed, ...]) -> list[ChangedOut]:
    return [ChangedOut(key=one.key, before=one.before, after=one.after) for one in changes]
