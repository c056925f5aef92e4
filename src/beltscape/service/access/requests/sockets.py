"""Limits on WebSockets: their number, their incoming messages, and the end of their session."""

from __future__ import annotations

import time
from collections import Counter
from contextlib import suppress

from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect

from beltscape.service.access.access import Access
from beltscape.service.access.identity.cookie import read_session_token
from beltscape.service.access.identity.database import UsersUnreadableError
from beltscape.service.access.limits.throttle import TokenBuckets
from beltscape.service.access.requests.dependencies import USER, get_address

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
