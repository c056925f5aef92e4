"""Installation of access control in an application: routes, pages, error handlers and the guard."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response

from beltscape.core.errors import OutputError
from beltscape.service.access.access import Access
from beltscape.service.access.identity.database import UsersUnreadableError
from beltscape.service.access.requests.guard import UNREADABLE_USERS, Guard
from beltscape.service.access.requests.headers import build_policy
from beltscape.service.access.routes.pages import add_pages
from beltscape.service.access.routes.session_routes import SessionRoutes
from beltscape.service.access.routes.user_routes import UserRoutes

PUBLIC_PATHS = (
    "/login", "/setup", "/page/", "/access/", "/favicon.ico",
    "/api/access/state", "/api/access/login", "/api/access/setup",
)  # fmt: skip
"""Paths without login: files of the pages, login and setup."""
_REFUSALS: dict[int | str, dict[str, Any]] = {
    401: {"description": "Not logged in, or name or password is wrong"},
    403: {"description": "The role does not allow it, or the request comes from another site"},
    409: {"description": "The request does not fit the current state; the answer says why"},
    429: {"description": "Too many requests or passwords; Retry-After says when to try again"},
}
AUDITED_READS = ("/api/export",)
"""Reads that are logged in the audit log, as every change is."""


def install_access(
    app: FastAPI, access: Access, *, public: tuple[str, ...] = (), script_hashes: tuple[str, ...] = ()
) -> None:
    """Add the routes of access and, around everything else, the guard. Call it last.

    Without login only ``PUBLIC_PATHS`` and ``public`` ("/metrics", or "/static/" with all below it) are served, which
    check access themselves. ``script_hashes``: hashes of inline scripts that the pages may have ("sha256-…").
    """
    routes = APIRouter(prefix="/api/access", tags=["access"], responses=_REFUSALS)
    SessionRoutes(access).add_to(routes)
    UserRoutes(access).add_to(routes)
    app.include_router(routes)
    add_pages(app)
    app.add_exception_handler(RequestValidationError, _describe_invalid_request)
    app.add_exception_handler(OutputError, _describe_write_error)
    app.add_exception_handler(UsersUnreadableError, _describe_unreadable_users)
    app.add_middleware(
        Guard,
        access=access,
        public=(*PUBLIC_PATHS, *public),
        policy=build_policy(script_hashes),
        audited=AUDITED_READS,
    )
    if access.trouble:
        logging.getLogger("beltscape.access").error(access.trouble)
    _ = access.setup_token  # logs it while there is no user


def _describe_invalid_request(_request: Request, error: Exception) -> Response:
    """Return the validation errors without the values, which may be passwords or no valid JSON (NaN)."""
    errors: Sequence[Any] = error.errors() if isinstance(error, RequestValidationError) else []
    detail = [
        {"loc": [str(p)[:100] for p in e["loc"]], "msg": e["msg"], "type": e["type"]} for e in errors[:20]
    ]
    return Response(json.dumps({"detail": detail}), 422, media_type="application/json")


def _describe_write_error(_request: Request, error: Exception) -> Response:
    return Response(json.dumps({"detail": str(error)}), 507, media_type="application/json")


def _describe_unreadable_users(_request: Request, _error: Exception) -> Response:
    return Response(json.dumps({"detail": UNREADABLE_USERS}), 503, media_type="application/json")
