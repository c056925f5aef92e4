"""Endpoints of the reports of shifts and days: their list and their files."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Depends, HTTPException, Path, Query
from fastapi.responses import FileResponse

from beltscape.core.errors import InputError
from beltscape.report.production.summary import make_title
from beltscape.service.access import User, require_role
from beltscape.service.api.common import AppContext, ResponseModel, describe_refusals
from beltscape.service.production.reports import ReportWriter

Viewer = Annotated[User, Depends(require_role("viewer"))]
Key = Annotated[str, Path(pattern=r"^\d{8}T\d{4}Z_(shift|day)$", description="Name of a report")]
Form = Literal["html", "pdf", "json"]
_MEDIA: dict[Form, str] = {
    "html": "text/html; charset=utf-8",
    "pdf": "application/pdf",
    "json": "application/json",
}

_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
"""A report is complete in itself, with its style inside; it runs no script and reaches nothing of the page."""


class ReportOut(ResponseModel):
    """A report that was written."""

    key: str
    title: str
    since_ms: int
    until_ms: int
    has_pdf: bool
    is_mailed: bool
    is_printed: bool


def make_router(context: AppContext) -> APIRouter:
    """Return the routes below /api/reports; none where the system counts no production."""
    router = APIRouter(prefix="/api/reports", tags=["production"])
    production = context.production
    if production is None:
        return router

    def require_writer() -> ReportWriter:
        if production.reports is None:
            raise HTTPException(404, "the settings have no [reports]")
        return production.reports

    @router.get("", responses=describe_refusals(404))
    def list_reports(_: Viewer, limit: Annotated[int, Query(ge=1, le=500)] = 60) -> list[ReportOut]:
        """The newest reports, newest first."""
        writer = require_writer()
        return [found for key in writer.list_keys()[:limit] if (found := _describe(writer, key)) is not None]

    @router.get(
        "/{key}",
        response_class=FileResponse,
        responses=describe_refusals(404)
        | {200: {"content": {kind: {} for kind in _MEDIA.values()}, "description": "The report"}},
    )
    def report(_: Viewer, key: Key, form: Annotated[Form, Query(alias="format")] = "html") -> FileResponse:
        """A report as HTML, PDF or its figures as JSON."""
        path = require_writer().find_file(key, f".{form}")
        if path is None:
            raise HTTPException(404, "there is no such report")
        return FileResponse(
            path,
            media_type=_MEDIA[form],
            filename=path.name,
            content_disposition_type="inline",
            headers={"content-security-policy": _POLICY} if form == "html" else None,
        )

    return router


def _describe(writer: ReportWriter, key: str) -> ReportOut | None:
    """Return a report of the list; None where its file is damaged."""
    try:
        document = writer.read(key)
    except InputError:
        return None
    return ReportOut(
        key=key,
        title=make_title(document),
        since_ms=document.period.since_ms,
        until_ms=document.period.until_ms,
        has_pdf=writer.find_file(key, ".pdf") is not None,
        is_mailed=writer.is_mailed(key),
        is_printed=writer.is_printed(key),
    )
