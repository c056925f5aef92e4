"""The listening socket: a connection that announces or sends more than one message may hold is closed."""

from __future__ import annotations

from asyncua import Server
from asyncua.common.connection import TransportLimits
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol

_CHUNK_BYTES = 65_535
"""Largest part of a message (OPC 10000-6: at least 8192); the library's own."""
_CHUNKS = 64
"""Parts of one request: 4 MiB, far more than reads, calls and subscriptions need."""


def make_limits() -> TransportLimits:
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


class _BoundedServer(BinaryServer):
    def _make_protocol(self) -> OPCUAProtocol:
        return BoundedProtocol(
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )


class BoundedServer(Server):
    """A server whose connections are bounded."""

    async def start(self) -> None:
        """Listen; OSError if the address cannot be had."""
        await self._setup_server_nodes()
        await self.iserver.start()
        host, port = self._get_bind_socket_info()
        self.bserver = _BoundedServer(self.iserver, host or "", port or 0, self.limits)
        self.bserver.set_policies(self._policies)
        try:
            await self.bserver.start()
        except OSError:
            await self.iserver.stop()
            raise
