"""Limits on connections: their number, their rate of reads, time limits that uvicorn lacks, unambiguous requests.

uvicorn limits neither the time for headers nor that for clients that do not read; asyncio allows 60 s for TLS.
Requests whose length is ambiguous are refused (request smuggling, RFC 9112 sections 6.1 and 6.3): h11 merges equal
repetitions of Content-Length and prefers Transfer-Encoding where both are given, so the fields are checked in the
lines as received, before h11 reads them.
"""

from __future__ import annotations

import asyncio
import ssl
from collections import Counter
from collections.abc import Sequence
from typing import ClassVar, cast

import h11
from h11 import LocalProtocolError
from h11._receivebuffer import ReceiveBuffer
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from beltscape.service.access.throttle import WorkLimiter, normalise_address
from beltscape.service.settings import LimitSettings


class StrictReceiveBuffer(ReceiveBuffer):
    """The receive buffer of a server's connection; it refuses ambiguous heads."""

    def maybe_extract_lines(self) -> list[bytearray] | None:
        """Return the lines of the next head, None if it is incomplete; LocalProtocolError if it is ambiguous."""
        lines = super().maybe_extract_lines()
        fault = find_framing_fault(lines or ())
        if fault:
            raise LocalProtocolError(fault, error_status_hint=400)  # h11 reports it as the remote's error
        return lines


def find_framing_fault(lines: Sequence[bytes | bytearray]) -> str:
    """Return why the length of a request with these lines is ambiguous; empty if it is not."""
    values: dict[bytes, list[bytes]] = {b"content-length": [], b"transfer-encoding": []}
    for line in lines:
        name, _, value = bytes(line).partition(b":")
        if name.strip().lower() in values:
            values[name.strip().lower()].append(value)
    lengths, codings = values.values()
    if lengths and codings:
        return "Content-Length and Transfer-Encoding together"
    if len(lengths) > 1 or any(b"," in value for value in lengths):
        return "Content-Length more than once"
    if len(codings) > 1:
        return "Transfer-Encoding more than once"
    if codings and lines[0].rstrip().endswith(b"HTTP/1.0"):
        return "Transfer-Encoding in HTTP/1.0"
    return ""


PIECE_BYTES = 4096
"""Bytes that count as one more read: a page of memory. Chosen."""


class ConnectionCounter:
    """Counts and paces the open connections; used from the event loop only."""

    def __init__(self, limits: LimitSettings) -> None:
        self.limits = limits
        self._open: dict[asyncio.BaseTransport, str] = {}
        self._per_address: Counter[str] = Counter()
        self._total_limiter = WorkLimiter(limits.reads_per_s)
        self._address_limiter = WorkLimiter(limits.reads_per_s_per_address)

    def add(self, transport: asyncio.BaseTransport) -> bool:
        """Count a new connection; return False, without counting it, if there are too many."""
        peer = transport.get_extra_info("peername")
        address = normalise_address(peer[0]) if peer else ""
        limits = self.limits
        if len(self._open) >= limits.connections_max:
            return False
        is_proxy = address in limits.trusted_proxies
        if self._per_address[address] >= limits.connections_per_address and not is_proxy:
            return False
        self._open[transport] = address
        self._per_address[address] += 1
        return True

    def count_read(self, transport: asyncio.BaseTransport, size: int) -> float:
        """Count ``size`` bytes read; return the seconds until the next read is allowed."""
        address, cost = self._open.get(transport, ""), 1 + size / PIECE_BYTES
        total_wait_s = self._total_limiter.spend("all", cost)
        return (
            total_wait_s
            if address in self.limits.trusted_proxies
            else max(total_wait_s, self._address_limiter.spend(address, cost))
        )

    def replace(self, old: asyncio.BaseTransport, new: asyncio.BaseTransport) -> None:
        """Continue a connection under another transport."""
        self._open[new] = self._open.pop(old)

    def remove(self, transport: asyncio.BaseTransport) -> None:
        """Stop counting a closed connection."""
        address = self._open.pop(transport, None)
        if address is not None:
            self._per_address[address] -= 1
            if not self._per_address[address]:
                del self._per_address[address]


class _WriteTimeLimit(asyncio.Protocol):
    """Disconnects a client that does not read what is written to it."""

    counter: ClassVar[ConnectionCounter]
    loop: asyncio.AbstractEventLoop
    transport: asyncio.Transport
    _write_timer: asyncio.TimerHandle | None = None

    def pause_writing(self) -> None:
        """Start the time limit of a client that does not read."""
        super().pause_writing()
        self._write_timer = self.loop.call_later(self.counter.limits.write_timeout_s, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop that time limit."""
        self._stop_write_timer()
        super().resume_writing()

    def _stop_write_timer(self) -> None:
        self._write_timer = _cancel(self._write_timer)


class LimitedHttpProtocol(_WriteTimeLimit, H11Protocol):
    """uvicorn's HTTP with limits. TLS starts inside, so that handshakes count as connections."""

    tls: ClassVar[ssl.SSLContext | None]
    _header_timer: asyncio.TimerHandle | None = None
    _handshake: asyncio.Task[None] | None = None
    _early_data = b""  # received between the handshake and the switch to it

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyrefly: ignore[bad-override]
        """Accept the connection, or close it if there are too many."""
        if not self.counter.add(transport):
            transport.abort()
        elif self.tls is None:
            self._start_http(transport)
        else:
            transport.pause_reading()
            self._handshake = self.loop.create_task(self._encrypt(transport, self.tls))

    async def _encrypt(self, plain: asyncio.Transport, context: ssl.SSLContext) -> None:
        limit_s = self.counter.limits.header_timeout_s
        encrypted = None
        try:
            encrypted = await self.loop.start_tls(
                plain, self, context, server_side=True, ssl_handshake_timeout=limit_s
            )
        except OSError:  # SSLError, TimeoutError and a reset are OSErrors
            plain.abort()
        if encrypted is None or encrypted.is_closing():
            self.counter.remove(plain)
        else:
            self.counter.replace(plain, encrypted)
            self._start_http(encrypted)

    def _is_unconnected(self) -> bool:
        return cast("asyncio.Transport | None", self.transport) is None  # until connection_made

    def _start_http(self, transport: asyncio.Transport) -> None:
        super().connection_made(transport)
        self.conn._receive_buffer = StrictReceiveBuffer()
        self._start_header_timer()
        self._throttle_reading(0)
        if self._early_data:
            early_data, self._early_data = self._early_data, b""
            self.data_received(early_data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop counting the connection."""
        if self._is_unconnected():  # refused, or still in its handshake
            return
        self.counter.remove(self.transport)
        self._stop_header_timer()
        self.resume_writing()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Process data; the headers of a request that has begun must arrive in time."""
        if self._is_unconnected():
            self._early_data += data
            return
        self._throttle_reading(len(data))
        super().data_received(data)
        idle = self.timeout_keep_alive_task is not None
        if self.conn.their_state is h11.IDLE and not idle and not self.transport.is_closing():
            self._start_header_timer()
        else:
            self._stop_header_timer()

    def _throttle_reading(self, size: int) -> None:
        wait_s = self.counter.count_read(self.transport, size)
        if wait_s:
            self.transport.pause_reading()
            self.loop.call_later(wait_s, self._resume_reading)

    def _resume_reading(self) -> None:
        # after an upgrade the WebSocket protocol resumes reading itself
        if (
            self.transport.get_protocol() is self
            and not self.flow.read_paused
            and not self.transport.is_closing()
        ):
            self.transport.resume_reading()

    def _start_header_timer(self) -> None:
        if self._header_timer is None:
            limit_s = self.counter.limits.header_timeout_s
            self._header_timer = self.loop.call_later(limit_s, self.transport.abort)

    def _stop_header_timer(self) -> None:
        self._header_timer = _cancel(self._header_timer)


class LimitedWebSocketProtocol(_WriteTimeLimit, WebSocketsSansIOProtocol):
    """uvicorn's WebSockets with limits; a client that does not read is disconnected."""

    def data_received(self, data: bytes) -> None:
        """Process data, no faster than the limits allow."""
        wait_s = self.counter.count_read(self.transport, len(data))
        if wait_s:
            self.transport.pause_reading()
            self.loop.call_later(wait_s, self._resume_reading)
        super().data_received(data)

    def _resume_reading(self) -> None:
        if not self.read_paused and not self.transport.is_closing():
            self.transport.resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop counting the connection."""
        self.counter.remove(self.transport)
        self._stop_write_timer()
        super().connection_lost(exc)


def make_protocols(
    limits: LimitSettings, tls: ssl.SSLContext | None
) -> tuple[type[LimitedHttpProtocol], type[LimitedWebSocketProtocol]]:
    """Return the HTTP and the WebSocket protocol with one common counter."""
    shared = {"counter": ConnectionCounter(limits), "tls": tls}
    return type("CountedHttp", (LimitedHttpProtocol,), shared), type(
        "CountedWebSocket", (LimitedWebSocketProtocol,), shared
    )


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
