"""ASGI middleware that checks, authenticates and rate-limits every request before any route handles it.

It also adds the security headers to every response, writes every successful change into the audit log, whatever its
route does, and limits WebSockets: their number, their incoming messages, and the end of their session.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import math
import re
import socket
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from urllib.parse import quote, unquote_plus

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect

from beltscape.service.access.access import Access
from beltscape.service.access.accounts import ANONYMOUS, USER, User, get_address
from beltscape.service.access.audit import Audit
from beltscape.service.access.database import UsersUnreadableError
from beltscape.service.access.sessions import TOKEN_HEADER, derive_page_token, read_key, read_session_token
from beltscape.service.access.throttle import TokenBuckets

UNSAFE = frozenset({"POST", "PUT", "PATCH", "DELETE"})
METHODS = UNSAFE | {"GET", "HEAD", "OPTIONS"}
HEADERS_MAX, HEADERS_MAX_BYTES = 100, 16_384
"""Most headers, and their total length; the connection's own limit holds only for headers in several pieces."""
TARGET_MAX = 4096
"""Longest path and query together, bytes."""
_HOST_NAME = re.compile(r"(?P<name>\[[0-9a-fA-F:.]{2,45}\]|[A-Za-z0-9._-]{1,253})(?::\d{1,5})?")


def is_host_allowed(host: str, names: frozenset[str]) -> bool:
    """Return whether the Host header names this service.

    IP addresses are always allowed, since no foreign name server can redirect one (DNS rebinding); else ``names``.
    """
    match = _HOST_NAME.fullmatch(host)
    if match is None:
        return False
    name = match["name"].lower().rstrip(".")
    if name in names:
        return True
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def list_own_names(allowed: tuple[str, ...]) -> frozenset[str]:
    """Return ``allowed``, localhost and this machine's own name, in lower case."""
    return frozenset(n.lower().rstrip(".") for n in (*allowed, "localhost", socket.gethostname()))


def is_path_allowed(path: str, raw: bytes) -> bool:
    """Return whether a path is plain.

    A plain path has no "..", no empty or hidden part, no encoded separator, no control character, no double encoding.
    """
    if not path.startswith("/") or not path.isprintable() or any(c in path for c in "\\%\ufffd"):
        return False
    lowered = raw.lower()
    if b"%2f" in lowered or b"%5c" in lowered:
        return False
    parts = path[1:].split("/")
    return all(part and not part.startswith(".") for part in parts[:-1]) and not parts[-1].startswith(".")


def is_same_origin(headers: Mapping[str, str], scheme: str, *, unsafe: bool) -> bool:
    """Return whether a request comes from the service's own page, or from no page at all.

    ``unsafe``: the request may change something. Other requests may also follow a link from another site.
    """
    own = f"{ {'ws': 'http', 'wss': 'https'}.get(scheme, scheme) }://{headers.get('host', '')}"
    origin, site = headers.get("origin"), headers.get("sec-fetch-site")
    if origin is not None and origin.lower() != own.lower():
        return False
    if site in (None, "same-origin"):
        return True
    if unsafe:
        return False
    return site == "none" or headers.get("sec-fetch-mode") == "navigate"


_SECURITY_HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), payment=(), usb=(), serial=()",
}


def build_policy(script_hashes: tuple[str, ...] = ()) -> str:
    """Return the content security policy: own resources only, inline scripts only with the given sha256-… hashes."""
    scripts = " ".join(["'self'", *(f"'{h}'" for h in script_hashes)])
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
        "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    )


def add_security_headers(send: Send, content_policy: str, *, https: bool) -> Send:
    """Return ``send`` that adds the headers to every response; its own caching header and content policy are kept."""
    policy = (b"content-security-policy", content_policy.encode())
    added = dict(_SECURITY_HEADERS)
    if https:
        added["strict-transport-security"] = "max-age=31536000"
    pairs = [(name.encode(), value.encode()) for name, value in added.items()]

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = [(name, value) for name, value in message.get("headers", []) if name.lower() != b"server"]
            if not any(name.lower() == b"cache-control" for name, _ in own):
                own.append((b"cache-control", b"no-store"))
            if not any(name.lower() == policy[0] for name, _ in own):
                own.append(policy)
            message = {**message, "headers": [*own, *pairs]}
        await send(message)

    return send_with_headers


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


SESSION_CHECK_S = 1.0
"""Interval at which an open socket's session is checked; an ended session sees no more than this. Chosen."""
SESSION_ENDED_CODE = 4401
"""WebSocket close code after the end of the session: HTTP's 401 in the private range (RFC 6455, 7.4.2)."""
INCOMING_HZ, INCOMING_BURST = 5.0, 50
"""Rate and burst of messages from a page; the operator's page sends none."""


class WebSocketLimiter:
    """Counts open WebSockets and ends those without a valid session; used from the event loop only."""

    def __init__(self, access: Access) -> None:
        self._access = access
        self._open: Counter[str] = Counter()

    async def run(self, app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> None:
        """Run ``app`` on a WebSocket if there are not too many, until its session ends."""
        address, settings = get_address(HTTPConnection(scope)), self._access.settings
        if self._open.total() >= settings.sockets_max or self._open[address] >= settings.sockets_per_address:
            await receive()
            await send({"type": "websocket.close", "code": 1013, "reason": "too many pages are open"})
            return
        self._open[address] += 1
        try:
            with suppress(WebSocketDisconnect):  # the page closed while a message was sent
                await app(scope, _limit_incoming(receive), self._check_session_on_send(scope, send))
        finally:
            self._open[address] -= 1
            if not self._open[address]:
                del self._open[address]

    def _check_session_on_send(self, scope: Scope, send: Send) -> Send:
        """Return ``send`` that closes the socket once its session has ended or its role has changed."""
        token, user = read_session_token(HTTPConnection(scope)), scope[USER]
        checked_s = time.monotonic()

        async def send_checked(message: Message) -> None:
            nonlocal checked_s
            if message["type"] == "websocket.send" and time.monotonic() - checked_s >= SESSION_CHECK_S:
                checked_s = time.monotonic()
                try:
                    present = await run_in_threadpool(self._access.identify, token, touch=False)
                except UsersUnreadableError:  # the end of a session cannot be told from damage
                    present = None
                if present != user:
                    await send(
                        {"type": "websocket.close", "code": SESSION_ENDED_CODE, "reason": "log in again"}
                    )
                    raise WebSocketDisconnect(SESSION_ENDED_CODE)
            await send(message)

        return send_checked


def _limit_incoming(receive: Receive) -> Receive:
    """Return ``receive`` that disconnects a page that sends too much."""
    buckets = TokenBuckets(INCOMING_HZ, INCOMING_BURST)

    async def receive_limited() -> Message:
        message = await receive()
        if message["type"] == "websocket.receive" and buckets.take(""):
            return {"type": "websocket.disconnect", "code": 1008}
        return message

    return receive_limited


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
