"""What happens on a connection before there is a request: how many there may be, and how slow they may be.

uvicorn has no time limit for headers, for readers who do not read, and none for TLS handshakes but asyncio's 60 s.
"""

from __future__ import annotations

import asyncio
import ssl
from collections import Counter
from typing import ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from beltscape.service.access.settings import LimitSettings
from beltscape.service.access.throttle import Pace, network

PIECE_BYTES = 4096
"""What counts as one more read."""


class Connections:
    """Those that are open; used from the event loop only."""

    def __init__(self, limits: LimitSettings) -> None:
        self.limits = limits
        self._open: dict[asyncio.BaseTransport, str] = {}
        self._of: Counter[str] = Counter()
        self._pace = Pace(limits.reads_per_s)
        self._pace_of = Pace(limits.reads_per_s_per_address)

    def enter(self, transport: asyncio.BaseTransport) -> bool:
        """Count a new one; False: there are too many, and it is not counted."""
        peer = transport.get_extra_info("peername")
        address = network(peer[0]) if peer else ""
        limits = self.limits
        if len(self._open) >= limits.connections_max:
            return False
        for_many = address in limits.trusted_proxies
        if self._of[address] >= limits.connections_per_address and not for_many:
            return False
        self._open[transport] = address
        self._of[address] += 1
        return True

    def read(self, transport: asyncio.BaseTransport, size: int) -> float:
        """So many bytes were read; seconds until more may be."""
        address, cost = self._open.get(transport, ""), 1 + size / PIECE_BYTES
        of_all = self._pace.spend("all", cost)
        return (
            of_all
            if address in self.limits.trusted_proxies
            else max(of_all, self._pace_of.spend(address, cost))
        )

    def change(self, old: asyncio.BaseTransport, new: asyncio.BaseTransport) -> None:
        """The same connection, by another transport from now on."""
        self._open[new] = self._open.pop(old)

    def leave(self, transport: asyncio.BaseTransport) -> None:
        """It is closed."""
        address = self._open.pop(transport, None)
        if address is not None:
            self._of[address] -= 1
            if not self._of[address]:
                del self._of[address]


class Door(H11Protocol):
    """HTTP as uvicorn speaks it, with limits; TLS inside, so that handshakes count as connections."""

    counted: ClassVar[Connections]
    tls: ClassVar[ssl.SSLContext | None]
    _deadline: asyncio.TimerHandle | None = None
    _stuck: asyncio.TimerHandle | None = None
    _handshake: asyncio.Task[None] | None = None
    _early = b""  # what came between the handshake and its being noticed

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Let it in, or cut it off."""
        if not self.counted.enter(transport):
            transport.abort()
        elif self.tls is None:
            self._ready(transport)
        else:
            transport.pause_reading()
            self._handshake = self.loop.create_task(self._encrypt(transport, self.tls))

    async def _encrypt(self, plain: asyncio.Transport, context: ssl.SSLContext) -> None:
        limit_s = self.counted.limits.header_timeout_s
        encrypted = None
        try:
            encrypted = await self.loop.start_tls(
                plain, self, context, server_side=True, ssl_handshake_timeout=limit_s
            )
        except OSError:  # SSLError, TimeoutError and a reset are OSErrors
            plain.abort()
        if encrypted is None or encrypted.is_closing():
            self.counted.leave(plain)
        else:
            self.counted.change(plain, encrypted)
            self._ready(encrypted)

    def _ready(self, transport: asyncio.Transport) -> None:
        super().connection_made(transport)
        self._expect_headers()
        self._rest(0)
        if self._early:
            early, self._early = self._early, b""
            self.data_received(early)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        if self.transport is None:  # refused, or in its handshake
            return
        self.counted.leave(self.transport)
        self._no_longer_expected()
        self.resume_writing()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take it; whoever has begun a request must finish its headers in time."""
        if self.transport is None:
            self._early += data
            return
        self._rest(len(data))
        super().data_received(data)
        idle = self.timeout_keep_alive_task is not None
        if self.conn.their_state is h11.IDLE and not idle and not self.transport.is_closing():
            self._expect_headers()
        else:
            self._no_longer_expected()

    def pause_writing(self) -> None:
        """He does not read."""
        super().pause_writing()
        self._stuck = self.loop.call_later(self.counted.limits.write_timeout_s, self.transport.abort)

    def resume_writing(self) -> None:
        """He reads."""
        self._stuck = _cancelled(self._stuck)
        super().resume_writing()

    def _rest(self, size: int) -> None:
        wait_s = self.counted.read(self.transport, size)
        if wait_s:
            self.transport.pause_reading()
            self.loop.call_later(wait_s, self._go_on)

    def _go_on(self) -> None:
        # after an upgrade the socket decides
        if (
            self.transport.get_protocol() is self
            and not self.flow.read_paused
            and not self.transport.is_closing()
        ):
            self.transport.resume_reading()

    def _expect_headers(self) -> None:
        if self._deadline is None:
            limit_s = self.counted.limits.header_timeout_s
            self._deadline = self.loop.call_later(limit_s, self.transport.abort)

    def _no_longer_expected(self) -> None:
        self._deadline = _cancelled(self._deadline)


class Socket(WebSocketsSansIOProtocol):
    """WebSockets as uvicorn speaks them; who does not read is cut off."""

    counted: ClassVar[Connections]
    _stuck: asyncio.TimerHandle | None = None

    def data_received(self, data: bytes) -> None:
        """Take it; not too often."""
        wait_s = self.counted.read(self.transport, len(data))
        if wait_s:
            self.transport.pause_reading()
            self.loop.call_later(wait_s, self._go_on)
        super().data_received(data)

    def _go_on(self) -> None:
        if not self.read_paused and not self.transport.is_closing():
            self.transport.resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self.counted.leave(self.transport)
        self._stuck = _cancelled(self._stuck)
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """He does not read."""
        super().pause_writing()
        self._stuck = self.loop.call_later(self.counted.limits.write_timeout_s, self.transport.abort)

    def resume_writing(self) -> None:
        """He reads."""
        self._stuck = _cancelled(self._stuck)
        super().resume_writing()


def protocols(limits: LimitSettings, tls: ssl.SSLContext | None) -> tuple[type[Door], type[Socket]]:
    """Both, counting together."""
    shared = {"counted": Connections(limits), "tls": tls}
    return type("CountedDoor", (Door,), shared), type("CountedSocket", (Socket,), shared)


def _cancelled(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
