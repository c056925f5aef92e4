"""Putting the door into an application."""

from __future__ import annotations

import json
import logging
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response

from beltscape.core.errors import OutputError
from beltscape.service.access.access import Access
from beltscape.service.access.guard import Guard
from beltscape.service.access.headers import policy
from beltscape.service.access.pages import add_pages
from beltscape.service.access.session_routes import SessionRoutes
from beltscape.service.access.user_routes import UserRoutes

PUBLIC = (
    "/login", "/setup", "/page/", "/access/", "/favicon.ico",
    "/api/access/state", "/api/access/login", "/api/access/setup",
)  # fmt: skip
"""What everybody may call: the files that pages are made of, and the way in."""
_REFUSALS: dict[int | str, dict[str, Any]] = {
    401: {"description": "Not logged in, or name or password is wrong"},
    403: {"description": "The role does not allow it, or the request comes from another site"},
    409: {"description": "What is asked for does not fit; the answer says why"},
    429: {"description": "Too many requests or passwords; Retry-After says when to try again"},
}
AUDITED_READS = ("/api/export",)
"""Reads that go into the audit log, as every change does."""


def install(
    app: FastAPI, access: Access, *, public: tuple[str, ...] = (), script_hashes: tuple[str, ...] = ()
) -> None:
    """Add the routes and, around everything else, the guard. Call it last.

    Without a user every path is refused but the door's own and those of ``public`` ("/metrics", or "/static/" for all
    below it), which decide for themselves. ``script_hashes``: of inline scripts that the pages may have ("sha256-…").
    """
    routes = APIRouter(prefix="/api/access", tags=["access"], responses=_REFUSALS)
    SessionRoutes(access).add_to(routes)
    UserRoutes(access).add_to(routes)
    app.include_router(routes)
    add_pages(app)
    app.add_exception_handler(RequestValidationError, _unfit)
    app.add_exception_handler(OutputError, _unwritable)
    app.add_middleware(
        Guard,
        access=access,
        public=(*PUBLIC, *public),
        policy=policy(script_hashes),
        audited=AUDITED_READS,
    )
    if access.invitation:
        logging.getLogger("beltscape.access").warning(access.invitation)


def _unfit(_request: Request, error: Exception) -> Response:
    """What does not fit, without saying the value again: it may be a password, or no valid JSON (NaN)."""
    errors = error.errors() if isinstance(error, RequestValidationError) else []
    detail = [
        {"loc": [str(p)[:100] for p in e["loc"]], "msg": e["msg"], "type": e["type"]} for e in errors[:20]
    ]
    return Response(json.dumps({"detail": detail}), 422, media_type="application/json")


def _unwritable(_request: Request, error: Exception) -> Response:
    return Response(json.dumps({"detail": str(error)}), 507, media_type="application/json")
