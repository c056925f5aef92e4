"""ASGI middleware that checks, authenticates and rate-limits every request before any route handles it."""

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
from beltscape.service.access.identity.cookie import TOKEN_HEADER, read_session_token
from beltscape.service.access.identity.database import UsersUnreadableError
from beltscape.service.access.identity.keys import read_key
from beltscape.service.access.identity.roles import User
from beltscape.service.access.identity.sessions import derive_page_token
from beltscape.service.access.requests.audit_middleware import add_audit
from beltscape.service.access.requests.checks import (
    HEADERS_MAX,
    HEADERS_MAX_BYTES,
    METHODS,
    TARGET_MAX,
    UNSAFE,
    is_host_allowed,
    is_path_allowed,
    is_same_origin,
    list_own_names,
)
from beltscape.service.access.requests.dependencies import USER, get_address
from beltscape.service.access.requests.headers import add_security_headers
from beltscape.service.access.requests.sockets import WebSocketLimiter

UNREADABLE_USERS = (
    "users.db cannot be read, so nobody can sign in; measuring continues; restore it from a backup, or remove it and "
    "set up again"
)
"""Answer while the users' database is damaged; the log has its path and the error."""


class RequestRefused(Exception):  # noqa: N818
    """The answer to a request that is refused."""

    def __init__(self, status: int, text: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(text)
        self.status, self.text, self.headers = status, text, headers or {}


class Guard:
    """Checks and authenticates requests. ``public``: paths, or folders ending in a slash, that need no login.

    ``policy``: the content security policy. ``audited``: paths whose reads are logged as well.
    """

    def __init__(
        self, app: ASGIApp, access: Access, public: tuple[str, ...], policy: str, audited: tuple[str, ...]
    ) -> None:
        self._app, self._access, self._public = app, access, public
        self._policy, self._audited = policy, audited
        self._allowed_hosts = access.settings.allowed_hosts
        self._names = list_own_names(self._allowed_hosts)
        self._sockets = WebSocketLimiter(access)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one request, then pass it on or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        if scope["type"] == "http":
            send = add_security_headers(send, self._policy, https=scope["scheme"] == "https")
        try:
            self._check_form(scope)
            await self._identify(scope)
            if scope["type"] == "http":
                receive = await self._read_body(scope, receive)
        except RequestRefused as refused:
            await _send_refusal(refused, scope, receive, send)
            return
        except UsersUnreadableError:
            await _send_refusal(RequestRefused(503, UNREADABLE_USERS), scope, receive, send)
            return
        if scope["type"] == "websocket":
            await self._sockets.run(self._app, scope, receive, send)
        else:
            await self._app(scope, receive, add_audit(scope, send, self._access.audit, self._audited))

    def _check_form(self, scope: Scope) -> None:
        """Refuse a request whose rate, host, size, path, method or origin is not allowed."""
        headers = Headers(scope=scope)
        method = scope.get("method", "GET")
        self._check_rate("from " + get_address(HTTPConnection(scope)))
        if self._allowed_hosts != self._access.settings.allowed_hosts:
            self._allowed_hosts = self._access.settings.allowed_hosts
            self._names = list_own_names(self._allowed_hosts)
        if not is_host_allowed(headers.get("host", ""), self._names) or len(headers.getlist("host")) != 1:
            raise RequestRefused(
                400, "unknown host name; call the service by its address, or list the name in allowed_hosts"
            )
        if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > TARGET_MAX:
            raise RequestRefused(414, f"address longer than {TARGET_MAX} bytes")
        if len(headers.raw) > HEADERS_MAX or sum(len(n) + len(v) for n, v in headers.raw) > HEADERS_MAX_BYTES:
            raise RequestRefused(
                431, f"more than {HEADERS_MAX} headers, or {HEADERS_MAX_BYTES} bytes of them"
            )
        if not is_path_allowed(scope["path"], scope.get("raw_path") or b""):
            raise RequestRefused(404, "not found")
        if method not in METHODS:
            raise RequestRefused(405, "method not allowed", {"allow": ", ".join(sorted(METHODS))})
        unsafe = method in UNSAFE or scope["type"] == "websocket"
        if not is_same_origin(headers, scope["scheme"], unsafe=unsafe):
            raise RequestRefused(403, "this request comes from another site")

    def _check_rate(self, key: str) -> None:
        """Refuse a request beyond the rate limit of ``key``."""
        wait_s = self._access.requests.take(key)
        if wait_s:
            raise RequestRefused(429, "too many requests", {"retry-after": str(math.ceil(wait_s))})

    async def _identify(self, scope: Scope) -> None:
        """Identify the user; refuse unknown callers, other sites' pages and callers beyond the rate limit."""
        connection = HTTPConnection(scope)
        key = read_key(connection)
        if key is not None:
            scope[USER] = await self._identify_program(scope, key)
            return
        token = read_session_token(connection)
        path = scope["path"]
        is_public = any(path.startswith(p) if p.endswith("/") else path == p for p in self._public)
        try:
            user = await run_in_threadpool(self._access.identify, token) if token else None
        except UsersUnreadableError:
            user, token = None, None
            if not is_public and self._access.identify(None) is None:
                raise
        user = scope[USER] = user or self._access.identify(None)
        if user is None and not is_public:
            raise self._make_login_refusal(scope)
        if user is None or token is None or self._access.is_anonymous(user):
            return
        self._check_rate("by " + user.name)
        given = connection.headers.get(TOKEN_HEADER, "")
        is_right = hmac.compare_digest(given.encode(), derive_page_token(token).encode())
        if scope.get("method") in UNSAFE and not is_right and not is_public:
            raise RequestRefused(403, f"the header {TOKEN_HEADER} is missing or old; reload the page")

    async def _identify_program(self, scope: Scope, key: str) -> User:
        """Return the user of a program's key, which allows reading only."""
        user = await run_in_threadpool(self._access.keys.find, key)
        if user is None:
            raise RequestRefused(401, "no such key; make one by `beltscape users key`")
        if scope["type"] != "http" or scope["method"] in UNSAFE:
            raise RequestRefused(
                403, "a key allows reading only; sign in for changes and for the live channel"
            )
        self._check_rate("by " + user.name)
        return user

    def _make_login_refusal(self, scope: Scope) -> RequestRefused:
        wants_page = "text/html" in Headers(scope=scope).get("accept", "")
        if scope["type"] == "http" and scope["method"] == "GET" and wants_page:
            path = scope["path"][1:]
            query = f"?next={quote(path)}" if path else ""
            page = "setup" if self._access.setup_token else f"login{query}"
            location = "../" * path.count("/") + page  # holds below a proxy's path, too
            return RequestRefused(303, "log in first", {"location": location})
        return RequestRefused(401, "log in first")

    async def _read_body(self, scope: Scope, receive: Receive) -> Receive:
        """Read the whole body before any route does; refuse a long or slow one."""
        headers, settings = Headers(scope=scope), self._access.settings
        length = headers.get("content-length")
        if length is None and "transfer-encoding" not in headers:
            return receive
        if length is not None and (not length.isdecimal() or int(length[:18]) > settings.body_max_bytes):
            raise RequestRefused(413, f"body longer than {settings.body_max_bytes} bytes")
        body = bytearray()
        try:
            async with asyncio.timeout(settings.body_timeout_s):
                more = True
                while more:
                    message = await receive()
                    if message["type"] == "http.disconnect":
                        return _replay([message], receive)
                    body += message.get("body", b"")
                    more = message.get("more_body", False)
                    if len(body) > settings.body_max_bytes:
                        raise RequestRefused(413, f"body longer than {settings.body_max_bytes} bytes")
        except TimeoutError:
            raise RequestRefused(408, f"the body took longer than {settings.body_timeout_s:g} s") from None
        return _replay([{"type": "http.request", "body": bytes(body), "more_body": False}], receive)


def _replay(messages: list[Message], receive: Receive) -> Receive:
    async def receive_replayed() -> Message:
        return messages.pop(0) if messages else await receive()

    return receive_replayed


async def _send_refusal(refused: RequestRefused, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": refused.text})
        return
    body = json.dumps({"detail": refused.text}).encode()
    # the rest of the body is not read
    headers = {"content-type": "application/json", "content-length": str(len(body)), "connection": "close"}
    pairs = [(k.encode(), v.encode("latin-1", "replace")) for k, v in {**headers, **refused.headers}.items()]
    await send({"type": "http.response.start", "status": refused.status, "headers": pairs})
    await send({"type": "http.response.body", "body": b"" if scope["method"] == "HEAD" else body})
