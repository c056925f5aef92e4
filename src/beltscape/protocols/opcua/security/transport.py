"""The listening socket: a connection that sends more than a message holds is closed; a lost one ends its session."""

from __future__ import annotations

import asyncio
import socket

from asyncua import Server
from asyncua.common.connection import TransportLimits
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer

_CHUNK_BYTES = 65_535
"""Largest part of a message (OPC 10000-6: at least 8192); the library's own."""
_CHUNKS = 64
"""Parts of one request: 4 MiB, far more than reads, calls and subscriptions need."""
_BACKLOG = 64
"""Connections that may wait to be accepted. Chosen."""


def _make_limits() -> TransportLimits:
    """Return the limits that the server states to clients."""
    return TransportLimits(
        max_recv_buffer=_CHUNK_BYTES,
        max_send_buffer=_CHUNK_BYTES,
        max_chunk_count=_CHUNKS,
        max_message_size=_CHUNKS * _CHUNK_BYTES,
    )


class BoundedProtocol(OPCUAProtocol):
    """A connection whose unread bytes are bounded, also before anybody has signed in."""

    def data_received(self, data: bytes) -> None:
        """Handle bytes; close the connection where they are no message that could still become complete."""
        if self.transport is None or self.transport.is_closing():
            return
        super().data_received(data)
        if len(self._buffer) > _CHUNK_BYTES:
            self._buffer = b""
            self.transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the session with its subscriptions: no other channel can go on with it."""
        session = None if self.processor is None else self.processor.session
        super().connection_lost(exc)
        if session is not None:
            self.closing_tasks.append(asyncio.create_task(session.close_session()))


class _BoundedListener(BinaryServer):
    listener: socket.socket

    def _make_protocol(self) -> OPCUAProtocol:
        return BoundedProtocol(
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(self._make_protocol, sock=self.listener)
        self.cleanup_task = asyncio.create_task(self._close_task_loop())


class BoundedServer(Server):
    """A server whose connections are bounded, on a socket that is bound already."""

    def __init__(self, server: InternalServer, listener: socket.socket) -> None:
        """Take the socket; it is closed with the server."""
        super().__init__(iserver=server)
        self._listener = listener
        self.limits = _make_limits()

    async def start(self) -> None:
        """Answer clients."""
        await self._setup_server_nodes()
        await self.iserver.start()
        host, port = self._listener.getsockname()[:2]
        listener = _BoundedListener(self.iserver, host, port, self.limits)
        listener.listener = self._listener
        listener.set_policies(self._policies)
        self.bserver = listener
        await listener.start()


def open_listener(host: str, port: int) -> socket.socket:
    """Return a listening socket; OSError if the address cannot be had."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return socket.create_server((host, port), family=family, backlog=_BACKLOG)
