"""Installation of access control in an application: routes, pages, error handlers and the guard.

The pages are /login, /setup and /account; their texts, colours and fonts come from the operator's page.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles

from beltscape.core.errors import OutputError
from beltscape.service.access.access import Access
from beltscape.service.access.database import UsersUnreadableError
from beltscape.service.access.guard import UNREADABLE_USERS, Guard, build_policy
from beltscape.service.access.routes import SessionRoutes, UserRoutes

PAGES_FOLDER = Path(__file__).parent / "page"
PAGES = ("login", "setup", "account")


def add_pages(app: FastAPI) -> None:
    """Serve the pages, and their files at /access/."""
    app.mount("/access", StaticFiles(directory=PAGES_FOLDER), name="access-page")
    for name in PAGES:
        _add_page(app, name)


def _add_page(app: FastAPI, name: str) -> None:
    def page() -> FileResponse:
        return FileResponse(PAGES_FOLDER / f"{name}.html")

    app.add_api_route(f"/{name}", page, methods=["GET"], include_in_schema=False, name=f"{name}-page")


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
