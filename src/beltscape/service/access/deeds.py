"""Whatever changes something goes into the audit log by itself; no route can forget it."""

from __future__ import annotations

from urllib.parse import unquote_plus

from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection
from starlette.types import Message, Scope, Send

from beltscape.service.access.audit import Audit
from beltscape.service.access.checks import UNSAFE
from beltscape.service.access.depends import USER, address_of
from beltscape.service.access.roles import ANONYMOUS

OWN = "/api/access/"
"""Below it the routes write better entries themselves."""


def noting_deeds(scope: Scope, send: Send, audit: Audit, audited: tuple[str, ...]) -> Send:
    """``send`` that first writes down what was done: every successful change, and reads of the ``audited`` paths."""
    if scope["path"].startswith(OWN) or not (scope["method"] in UNSAFE or scope["path"] in audited):
        return send

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start" and message["status"] < 400:
            user, route = scope.get(USER), scope.get("route")
            detail = {"request": f"{scope['method']} {scope['path']}", "status": message["status"]}
            if scope["query_string"]:
                detail["query"] = unquote_plus(scope["query_string"].decode("latin-1"))
            what, who = getattr(route, "name", "request"), user.name if user else ANONYMOUS
            await run_in_threadpool(audit.write, what, who, address_of(HTTPConnection(scope)), detail)
        await send(message)

    return sending
