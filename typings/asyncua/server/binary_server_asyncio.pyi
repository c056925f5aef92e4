import asyncio
from typing import Any

from asyncua.common.connection import TransportLimits
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession

class _Processor:
    session: InternalSession | None

class OPCUAProtocol(asyncio.Protocol):
    processor: _Processor | None
    closing_tasks: list[asyncio.Task[Any]]
    transport: asyncio.Transport | None
    _buffer: bytes
    def __init__(
        self,
        iserver: InternalServer,
        policies: list[Any],
        clients: list[OPCUAProtocol],
        closing_tasks: list[asyncio.Task[Any]],
        limits: TransportLimits,
    ) -> None: ...

class BinaryServer:
    iserver: InternalServer
    port: int
    limits: TransportLimits
    clients: list[OPCUAProtocol]
    closing_tasks: list[asyncio.Task[Any]]
    cleanup_task: asyncio.Task[Any] | None
    _policies: list[Any]
    _server: asyncio.AbstractServer | None
    def __init__(
        self, internal_server: InternalServer, hostname: str, port: int, limits: TransportLimits
    ) -> None: ...
    def set_policies(self, policies: list[Any]) -> None: ...
    def _make_protocol(self) -> OPCUAProtocol: ...
    async def start(self) -> None: ...
    async def _close_task_loop(self) -> None: ...
