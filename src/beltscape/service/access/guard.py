"""The guard at the door: every request passes it before any route sees it."""

from __future__ import annotations

import asyncio
import hmac
import json
import math
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from beltscape.service.access.access import Access
from beltscape.service.access.checks import (
    HEADERS_MAX,
    HEADERS_MAX_BYTES,
    METHODS,
    TARGET_MAX,
    UNSAFE,
    host_allowed,
    own_names,
    path_allowed,
    same_origin,
)
from beltscape.service.access.cookie import TOKEN_HEADER, session_of
from beltscape.service.access.deeds import noting_deeds
from beltscape.service.access.depends import USER, address_of
from beltscape.service.access.headers import adding_headers
from beltscape.service.access.keys import key_of
from beltscape.service.access.roles import User
from beltscape.service.access.sessions import page_token
from beltscape.service.access.sockets import Sockets


class Refused(Exception):  # noqa: N818
    """The guard's answer to a request that goes no further."""

    def __init__(self, status: int, text: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(text)
        self.status, self.text, self.headers = status, text, headers or {}


class Guard:
    """ASGI middleware. ``public``: paths, or with a slash at the end folders, that decide for themselves.

    ``policy``: the content security policy. ``audited``: paths that are written down though they only read.
    """

    def __init__(
        self, app: ASGIApp, access: Access, public: tuple[str, ...], policy: str, audited: tuple[str, ...]
    ) -> None:
        self._app, self._access, self._public = app, access, public
        self._policy, self._audited = policy, audited
        self._names = own_names(access.settings.allowed_hosts)
        self._sockets = Sockets(access)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Judge one request, then pass it on or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        if scope["type"] == "http":
            send = adding_headers(send, self._policy, https=scope["scheme"] == "https")
        try:
            self._judge(scope)
            await self._identify(scope)
            if scope["type"] == "http":
                receive = await self._whole_body(scope, receive)
        except Refused as refused:
            await _answer(refused, scope, receive, send)
            return
        if scope["type"] == "websocket":
            await self._sockets.run(self._app, scope, receive, send)
        else:
            await self._app(scope, receive, noting_deeds(scope, send, self._access.audit, self._audited))

    def _judge(self, scope: Scope) -> None:
        """Refuse what is wrong in itself."""
        headers = Headers(scope=scope)
        method = scope.get("method", "GET")
        self._pace("from " + address_of(HTTPConnection(scope)))
        if not host_allowed(headers.get("host", ""), self._names) or len(headers.getlist("host")) != 1:
            raise Refused(
                400, "unknown host name; call the service by its address, or list the name in allowed_hosts"
            )
        if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > TARGET_MAX:
            raise Refused(414, f"address longer than {TARGET_MAX} bytes")
        if len(headers.raw) > HEADERS_MAX or sum(len(n) + len(v) for n, v in headers.raw) > HEADERS_MAX_BYTES:
            raise Refused(431, f"more than {HEADERS_MAX} headers, or {HEADERS_MAX_BYTES} bytes of them")
        if not path_allowed(scope["path"], scope.get("raw_path") or b""):
            raise Refused(404, "not found")
        if method not in METHODS:
            raise Refused(405, "method not allowed", {"allow": ", ".join(sorted(METHODS))})
        unsafe = method in UNSAFE or scope["type"] == "websocket"
        if not same_origin(headers, scope["scheme"], unsafe=unsafe):
            raise Refused(403, "this request comes from another site")

    def _pace(self, who: str) -> None:
        """Refuse whoever asks too often."""
        wait_s = self._access.requests.take(who)
        if wait_s:
            raise Refused(429, "too many requests", {"retry-after": str(math.ceil(wait_s))})

    async def _identify(self, scope: Scope) -> None:
        """Find out who it is; refuse strangers, strangers' pages and whoever asks too often."""
        connection = HTTPConnection(scope)
        key = key_of(connection)
        if key is not None:
            scope[USER] = await self._program(scope, key)
            return
        token = session_of(connection)
        user = scope[USER] = (
            await run_in_threadpool(self._access.who, token) if token else self._access.who(None)
        )
        path = scope["path"]
        public = any(path.startswith(p) if p.endswith("/") else path == p for p in self._public)
        if user is None and not public:
            raise self._strange(scope)
        if user is None or token is None or self._access.anonymous(user):
            return
        self._pace("by " + user.name)
        given = connection.headers.get(TOKEN_HEADER, "")
        right = hmac.compare_digest(given.encode(), page_token(token).encode())
        if scope.get("method") in UNSAFE and not right and not public:
            raise Refused(403, f"the header {TOKEN_HEADER} is missing or old; load the page anew")

    async def _program(self, scope: Scope, key: str) -> User:
        """Whose key it is; it only reads."""
        user = await run_in_threadpool(self._access.keys.find, key)
        if user is None:
            raise Refused(401, "no such key; make one by `beltscape users key`")
        if scope["type"] != "http" or scope["method"] in UNSAFE:
            raise Refused(403, "a key only reads; sign in to change something, and for the live channel")
        self._pace("by " + user.name)
        return user

    def _strange(self, scope: Scope) -> Refused:
        wants_page = "text/html" in Headers(scope=scope).get("accept", "")
        if scope["type"] == "http" and scope["method"] == "GET" and wants_page:
            door = "/setup" if self._access.setup_token else f"/login?next={quote(scope['path'])}"
            return Refused(303, "log in first", {"location": door})
        return Refused(401, "log in first")

    async def _whole_body(self, scope: Scope, receive: Receive) -> Receive:
        """Read the body before any route does; refuse a long or slow one."""
        headers, settings = Headers(scope=scope), self._access.settings
        length = headers.get("content-length")
        if length is None and "transfer-encoding" not in headers:
            return receive
        if length is not None and (not length.isdecimal() or int(length[:18]) > settings.body_max_bytes):
            raise Refused(413, f"body longer than {settings.body_max_bytes} bytes")
        body = bytearray()
        try:
            async with asyncio.timeout(settings.body_timeout_s):
                more = True
                while more:
                    message = await receive()
                    if message["type"] == "http.disconnect":
                        return _replayed([message], receive)
                    body += message.get("body", b"")
                    more = message.get("more_body", False)
                    if len(body) > settings.body_max_bytes:
                        raise Refused(413, f"body longer than {settings.body_max_bytes} bytes")
        except TimeoutError:
            raise Refused(408, f"the body took longer than {settings.body_timeout_s:g} s") from None
        return _replayed([{"type": "http.request", "body": bytes(body), "more_body": False}], receive)


def _replayed(messages: list[Message], receive: Receive) -> Receive:
    async def again() -> Message:
        return messages.pop(0) if messages else await receive()

    return again


async def _answer(refused: Refused, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": refused.text})
        return
    body = json.dumps({"detail": refused.text}).encode()
    # what is left of the body is not read
    headers = {"content-type": "application/json", "content-length": str(len(body)), "connection": "close"}
    pairs = [(k.encode(), v.encode("latin-1", "replace")) for k, v in {**headers, **refused.headers}.items()]
    await send({"type": "http.response.start", "status": refused.status, "headers": pairs})
    await send({"type": "http.response.body", "body": b"" if scope["method"] == "HEAD" else body})
