"""The server: an event loop in a thread of its own, which reads the plant's ready state and answers clients.

No frame waits for it: it shares nothing with the measurement but the state's lock, which is held for microseconds. A
connection that sends more than a message holds is closed; a lost one ends its session.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer

from beltscape.core.supervision import describe_failure
from beltscape.protocols.listening import ListeningThread
from beltscape.protocols.opcua.address_space import URIS, Builder
from beltscape.protocols.opcua.belt import add_belt
from beltscape.protocols.opcua.certificates import ClientCertificates, open_own_certificate
from beltscape.protocols.opcua.commands import CommandMethods
from beltscape.protocols.opcua.conditions import Conditions
from beltscape.protocols.opcua.history import RecordHistory
from beltscape.protocols.opcua.publication import Findings, Publication
from beltscape.protocols.opcua.sessions import GuardedServer
from beltscape.protocols.opcua.types import add_types, add_weight_type
from beltscape.protocols.plant import Plant, PlantCommands, PlantState, PlantUsers, Provenance
from beltscape.protocols.settings import OpcUaSettings

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


Update = Callable[[PlantState], Awaitable[None]]

_START_S = 60.0
"""Time for the server to listen: the standard nodes take a second of a free core."""
_USERS_S = 5.0
"""Interval at which sessions of removed users are ended."""
_POLICIES = {
    "encrypt": [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt],
    "sign": [
        ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
        ua.SecurityPolicyType.Basic256Sha256_Sign,
    ],
    "none": [
        ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
        ua.SecurityPolicyType.Basic256Sha256_Sign,
        ua.SecurityPolicyType.NoSecurity,
    ],
}
"""Policies by the least security of the settings."""


class ControlledPlant(Plant, PlantCommands, Protocol):
    """The running system, its commands and its users."""

    @property
    def users(self) -> PlantUsers:
        """Return the users of the service."""
        ...

    @property
    def provenance(self) -> Provenance:
        """Return what the values come from."""
        ...


class OpcUaServer:
    """Serves a plant until it is closed."""

    def __init__(
        self,
        settings: OpcUaSettings,
        plant: ControlledPlant,
        data: Path,
        on_message: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Prepare; ``data`` is the service's data folder.

        Raises
        ------
        InputError
            If the certificate or key of the settings cannot be used.
        OutputError
            If the certificate that the service makes cannot be written.
        """
        self._settings, self._plant, self._on_message = settings, plant, on_message
        self.own = open_own_certificate(settings, data, on_message)
        """The server's certificate."""
        self._clients = ClientCertificates(data, any_valid=settings.clients == "any")
        self._listening = ListeningThread("opcua", self._serve, on_message, _START_S)
        self._guarded: GuardedServer | None = None
        self.port = settings.port
        """TCP port that is listened on, once it is."""

    def start(self) -> None:
        """Start listening.

        Raises
        ------
        InputError
            If the address is in use or not allowed.
        """
        # the library logs every malformed request with its traceback, which would let anybody fill the log
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)
        self._listening.start(self._settings.host, self._settings.port, "choose another port or address")
        if self.own.ends_soon:
            self._on_message(f"opcua: {self.own.describe()}: make a new one, and have the clients trust it")
        if missing := self.own.list_missing_hosts(self._settings):
            self._on_message(
                f"opcua: the certificate does not name {', '.join(missing)}, which some clients demand: make a new "
                "one (where the service made it, remove opcua/certificate.der from the data folder), and have the "
                "clients trust it"
            )
        self._on_message(f"opcua: opc.tcp://{self._settings.host}:{self.port}/, {self.own.describe()}")

    @property
    def sessions(self) -> int:
        """Return the number of sessions that are open."""
        return 0 if self._guarded is None else len(self._guarded.sessions)

    def close(self, patience_s: float = 5.0) -> None:
        """Stop listening; the sessions end."""
        self._listening.close(patience_s)

    async def _serve(self) -> None:
        try:
            listener = open_listener(self._settings.host, self._settings.port)
        except OSError as error:
            self._listening.fail(error)
            return
        with closing(listener):
            guarded = GuardedServer(self._settings, self._clients, self._plant.users)
            self._guarded = guarded
            guarded.history_manager = RecordHistory(self._plant)
            server = BoundedServer(guarded, listener)
            await self._configure(server)
            publication, updates = await self._add_nodes(guarded)
            await self._update(publication, updates)
            await server.start()
            self.port = listener.getsockname()[1]
            self._listening.confirm()
            try:
                await self._run_updates(guarded, publication, updates)
            finally:
                await server.stop()

    async def _add_nodes(self, guarded: GuardedServer) -> tuple[Publication, list[Update]]:
        """Add all nodes, and return what shows a new state."""
        builder = Builder(guarded)
        await add_weight_type(guarded, builder)
        add_types(builder)
        add_belt(builder, self._settings, self.own.application, self._plant.provenance)
        commands = CommandMethods(guarded, builder, self._plant, self._plant.users)
        publication = Publication(guarded, self._plant, lambda: self._plant.provenance)
        conditions, findings = Conditions(guarded, builder, commands), Findings(guarded, builder)
        return publication, [
            publication.update, publication.show_records, conditions.update, findings.update,
        ]  # fmt: skip

    async def _update(self, publication: Publication, updates: list[Update]) -> str:
        """Show the present state; return what failed, in one line. A failure of one part leaves the others."""
        try:
            state = self._plant.read_state()
        except Exception as error:
            await publication.withdraw()
            return describe_failure(error)
        failure = ""
        for update in updates:
            try:
                await update(state)
            except Exception as error:
                failure = describe_failure(error)
        return failure

    async def _run_updates(
        self, guarded: GuardedServer, publication: Publication, updates: list[Update]
    ) -> None:
        reported, users_s = "", 0.0
        while not self._listening.is_stopped:
            failure = await self._update(publication, updates)
            if failure and failure != reported:
                self._on_message(f"opcua: {failure}; what it concerns is old until it passes")
            reported = failure
            users_s += self._settings.update_every_s
            if users_s >= _USERS_S:
                users_s = 0.0
                await guarded.end_orphaned_sessions()
            await self._pause()

    async def _configure(self, server: BoundedServer) -> None:
        """Set names, certificate and policies, and register the namespaces in their order."""
        from beltscape import __version__

        await server.init()
        await server.set_application_uri(self.own.application)
        server.set_server_name(f"Beltscape {self._settings.name}")
        server.product_uri, server.manufacturer_name = "urn:beltscape", "Beltscape"
        server.application_type = ua.ApplicationType.Server
        name = f"Beltscape {self._settings.name}"
        await server.set_build_info(
            "urn:beltscape", "Beltscape", name, __version__, __version__, datetime.now(UTC)
        )
        server.set_endpoint(f"opc.tcp://{self._settings.host}:{self._settings.port}/")
        server.iserver.certificate, server.iserver.private_key = self.own.certificate, self.own.key
        server.set_security_policy(_POLICIES[self._settings.security])
        tokens: list[type] = [ua.UserNameIdentityToken]
        if self._settings.anonymous_role is not None:
            tokens.append(ua.AnonymousIdentityToken)
        server.set_identity_tokens(tokens)
        for uri in URIS.values():
            await server.register_namespace(uri)

    async def _pause(self) -> None:
        """Wait for the period, or until the end."""
        left_s = self._settings.update_every_s
        while left_s > 0 and not self._listening.is_stopped:
            step_s = min(left_s, 0.5)
            await asyncio.sleep(step_s)
            left_s -= step_s
