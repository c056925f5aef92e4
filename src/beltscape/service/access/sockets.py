"""Open WebSockets: how many there may be, and that none outlives its session."""

from __future__ import annotations

import time
from collections import Counter
from contextlib import suppress

from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect

from beltscape.service.access.access import Access
from beltscape.service.access.cookie import session_of
from beltscape.service.access.depends import USER, address_of
from beltscape.service.access.throttle import Buckets

LOOK_S = 1.0
"""How often an open socket's session is looked at."""
OVER = 4401
"""Code with which a socket is closed when its session has ended."""


SAID_HZ, SAID_AT_ONCE = 5.0, 50
"""How much a page may say; ours says nothing."""


class Sockets:
    """Counts them and watches over them; used from the event loop only."""

    def __init__(self, access: Access) -> None:
        self._access = access
        self._open: Counter[str] = Counter()

    async def run(self, app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> None:
        """Let ``app`` have a socket, while there are not too many and its session lasts."""
        address, settings = address_of(HTTPConnection(scope)), self._access.settings
        if self._open.total() >= settings.sockets_max or self._open[address] >= settings.sockets_per_address:
            await receive()
            await send({"type": "websocket.close", "code": 1013, "reason": "too many pages are open"})
            return
        self._open[address] += 1
        try:
            with suppress(WebSocketDisconnect):  # the page has gone while it was sent something
                await app(scope, _unhurried(receive), self._watched(scope, send))
        finally:
            self._open[address] -= 1
            if not self._open[address]:
                del self._open[address]

    def _watched(self, scope: Scope, send: Send) -> Send:
        """``send`` that closes the socket instead once its session has ended or its role has changed."""
        token, user = session_of(HTTPConnection(scope)), scope[USER]
        looked = time.monotonic()

        async def sending(message: Message) -> None:
            nonlocal looked
            if message["type"] == "websocket.send" and time.monotonic() - looked >= LOOK_S:
                looked = time.monotonic()
                if await run_in_threadpool(self._access.who, token, touch=False) != user:
                    await send({"type": "websocket.close", "code": OVER, "reason": "log in again"})
                    raise WebSocketDisconnect(OVER)
            await send(message)

        return sending


def _unhurried(receive: Receive) -> Receive:
    """``receive`` that ends where a page says too much."""
    said = Buckets(SAID_HZ, SAID_AT_ONCE)

    async def receiving() -> Message:
        message = await receive()
        if message["type"] == "websocket.receive" and said.take(""):
            return {"type": "websocket.disconnect", "code": 1008}
        return message

    return receiving
