"""Audit middleware: every successful change goes into the audit log, whatever its route does."""

from __future__ import annotations

from urllib.parse import unquote_plus

from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection
from starlette.types import Message, Scope, Send

from beltscape.service.access.audit import Audit
from beltscape.service.access.identity.roles import ANONYMOUS
from beltscape.service.access.requests.checks import UNSAFE
from beltscape.service.access.requests.dependencies import USER, get_address

SELF_AUDITED = "/api/access/"
"""Routes below this path write more specific entries themselves."""


def add_audit(scope: Scope, send: Send, audit: Audit, audited: tuple[str, ...]) -> Send:
    """Return ``send`` that first logs every successful change, and successful reads of the ``audited`` paths."""
    if scope["path"].startswith(SELF_AUDITED) or not (scope["method"] in UNSAFE or scope["path"] in audited):
        return send

    async def send_audited(message: Message) -> None:
        if message["type"] == "http.response.start" and message["status"] < 400:
            user, route = scope.get(USER), scope.get("route")
            detail = {"request": f"{scope['method']} {scope['path']}", "status": message["status"]}
            if scope["query_string"]:
                detail["query"] = unquote_plus(scope["query_string"].decode("latin-1"))
            action, actor = getattr(route, "name", "request"), user.name if user else ANONYMOUS
            await run_in_threadpool(audit.write, action, actor, get_address(HTTPConnection(scope)), detail)
        await send(message)

    return send_audited
