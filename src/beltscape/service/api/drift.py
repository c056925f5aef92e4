"""Endpoints for engineers: the drift of the rig, its report, and its proposal, taken or undone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Protocol, TypeVar

from fastapi import APIRouter, Depends, HTTPException, Query, Request
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import BeltscapeError
from beltscape.service.access import User, require_role
from beltscape.service.access.accounts import get_address
from beltscape.service.api.common import ResponseModel, describe_refusals

Result = TypeVar("Result")
Engineer = Annotated[User, Depends(require_role("engineer"))]
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
"""The report is complete in itself; it runs no script and reaches nothing of the page."""


class DriftControl(Protocol):
    """The drift of a rig; ``ServedDrift`` is one. Each raises a BeltscapeError with one line."""

    def read(self) -> dict[str, Any]:
        """Return the drift as plain values."""
        ...

    def render(self, language: str) -> str:
        """Return its report."""
        ...

    def take(self, number: int, by: str, address: str) -> Sequence[str]:
        """Take the proposal of an estimate; return what else holds now."""
        ...

    def undo(self, by: str, address: str) -> Sequence[str]:
        """Put the former rig back; return what else holds now."""
        ...


class DriftOut(ResponseModel):
    """The newest estimate of the rig's drift; what is not known is null."""

    has_reference: bool
    estimates: int
    newest: int | None
    """Number of the newest estimate."""
    moved: str | None
    """Camera that moved, "all" or "none"."""
    has_proposal: bool
    needs_new_belt: bool
    """Whether the core moved, so that the empty belt has to be learned again."""
    is_significant: bool
    """Whether the change of the volume exceeds twice its standard deviation."""
    change_litres: float | None
    """Change of the last week's volume by the proposal."""
    change_sigma_litres: float | None
    change_percent: float | None
    change_sigma_percent: float | None
    can_undo: bool
    window_s: float
    """Running time that an estimate is of; 0: none is made."""
    also: list[str]
    """Other settings whose changed files were read with the rig when it was taken or put back."""


class TakeDrift(BaseModel):
    """The estimate whose proposal is taken; it must be the newest one."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    number: Annotated[int, Field(ge=1)]


def make_router(drift: DriftControl) -> APIRouter:
    """Return the routes of the drift."""
    router = APIRouter(prefix="/api/drift", tags=["drift"])

    @router.get("", responses=describe_refusals(409))
    def read(_user: Engineer) -> DriftOut:
        """Return how the rig has drifted; nothing changes."""
        return _describe(_refuse(drift.read))

    @router.get("/report", response_class=HTMLResponse, responses=describe_refusals(409))
    def report(
        _user: Engineer, language: Annotated[str, Query(pattern="^(en|de|es|zh)$")] = "en"
    ) -> HTMLResponse:
        """Return the report: drift over the weeks with σ, the proposal, what was changed before."""
        page = _refuse(lambda: drift.render(language))
        return HTMLResponse(page, headers={"content-security-policy": _POLICY})

    @router.post("/take", responses=describe_refusals(409))
    def take(body: TakeDrift, request: Request, user: Engineer) -> DriftOut:
        """Measure with the proposed rig from the next record on."""
        also = _refuse(lambda: drift.take(body.number, user.name, get_address(request)))
        return _describe(_refuse(drift.read), also)

    @router.post("/undo", responses=describe_refusals(409))
    def undo(request: Request, user: Engineer) -> DriftOut:
        """Measure with the rig before the last one taken from the next record on."""
        also = _refuse(lambda: drift.undo(user.name, get_address(request)))
        return _describe(_refuse(drift.read), also)

    return router


def _refuse(call: Callable[[], Result]) -> Result:
    try:
        return call()
    except BeltscapeError as error:
        raise HTTPException(409, str(error)) from error


def _describe(document: dict[str, Any], also: Sequence[str] = ()) -> DriftOut:
    last = document["estimates"][-1] if document["estimates"] else {}
    changes = document["changes"]
    return DriftOut(
        has_reference=document["reference_ns"] is not None,
        estimates=len(document["estimates"]),
        change_percent=last.get("volume_percent"),
        change_sigma_percent=last.get("volume_sigma_percent"),
        can_undo=bool(changes) and changes[-1]["action"] == "taken",
        also=list(also),
        **{name: document[name] for name in (
            "newest", "moved", "has_proposal", "needs_new_belt", "is_significant",
            "change_litres", "change_sigma_litres", "window_s",
        )},
    )  # fmt: skip
