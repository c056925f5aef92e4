"""The web server: uvicorn in a thread of its own."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Protocol

from starlette.types import ASGIApp
from uvicorn import Config, Server

from beltscape.core.errors import OutputError, SettingsError
from beltscape.service.access.connections import make_protocols
from beltscape.service.access.settings import LimitSettings
from beltscape.service.access.tls import create_tls_context, describe_expiry

STOP_S = 2.0
"""How long stopping may take."""
_BACKLOG = (
    128  # so many connections are accepted before the first is judged: few enough for a process's files
)


class ListenSettings(Protocol):
    """Where to listen; WebSettings has it."""

    @property
    def host(self) -> str:
        """An address or name of this machine."""
        ...

    @property
    def port(self) -> int:
        """TCP port; 0: any free one."""
        ...

    @property
    def tls_certificate(self) -> Path | None:
        """PEM file with the certificate chain."""
        ...

    @property
    def tls_key(self) -> Path | None:
        """PEM file with its key."""
        ...

    @property
    def limits(self) -> LimitSettings:
        """What is put up with."""
        ...


@dataclass(frozen=True, slots=True)
class RunningServer:
    """A server that runs until it is closed."""

    address: str
    """Where it is reached, such as "https://127.0.0.1:8460"."""
    warnings: tuple[str, ...]
    """What somebody should know, a line each."""
    _server: Server
    _thread: threading.Thread

    @property
    def alive(self) -> bool:
        """Whether it still answers."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Stop within two seconds: pages are told, what is being answered is finished."""
        self._server.should_exit = True
        self._thread.join(STOP_S * 0.75)
        if self._thread.is_alive():
            self._server.force_exit = True
            self._thread.join(STOP_S * 0.25)


def check_listening(settings: ListenSettings) -> None:
    """Raise what `serve` would where the page cannot be served as ``settings`` say; nothing is left open."""
    _check_encryption(settings.host, settings.limits, encrypted=settings.tls_certificate is not None)
    if settings.tls_certificate and settings.tls_key:
        create_tls_context(settings.tls_certificate, settings.tls_key)
    _bind_socket(settings.host, settings.port).close()


def serve(app: ASGIApp, settings: ListenSettings) -> RunningServer:
    """Serve ``app`` from now on. InputError, SettingsError or OutputError in one line where that cannot be."""
    limits, tls = settings.limits, None
    warnings = _check_encryption(settings.host, limits, encrypted=settings.tls_certificate is not None)
    if settings.tls_certificate and settings.tls_key:
        tls = create_tls_context(settings.tls_certificate, settings.tls_key)
        ending = describe_expiry(settings.tls_certificate, settings.tls_key)
        warnings += (ending,) if ending else ()
    listener = _bind_socket(settings.host, settings.port)
    http, websocket = make_protocols(limits, tls)
    config = Config(
        app, loop="asyncio", http=http, ws=websocket, lifespan="auto",
        log_config=None, log_level="error", access_log=False, server_header=False, backlog=_BACKLOG,
        proxy_headers=bool(limits.trusted_proxies), forwarded_allow_ips=list(limits.trusted_proxies),
        h11_max_incomplete_event_size=limits.header_max_bytes, timeout_keep_alive=limits.keep_alive_s,
        ws_max_size=limits.socket_max_bytes, ws_max_queue=8, ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )  # fmt: skip
    server = Server(config)
    thread = threading.Thread(target=_run, args=(server, listener), name="beltscape-web", daemon=True)
    thread.start()
    while not server.started and thread.is_alive():
        time.sleep(0.005)
    if not thread.is_alive():
        listener.close()
        raise OutputError(f"web server on {settings.host}: did not start; its log says why")
    host, port = listener.getsockname()[:2]
    if ip_address(host).is_unspecified:
        host = socket.gethostname()
    named = f"[{host}]" if ":" in host else host
    return RunningServer(f"{'https' if tls else 'http'}://{named}:{port}", warnings, server, thread)


def _run(server: Server, listener: socket.socket) -> None:
    # uvicorn leaves the program where the application does not start; here that ends the thread, and is seen
    with suppress(SystemExit):
        server.run([listener])


def _bind_socket(host: str, port: int) -> socket.socket:
    """A bound socket."""
    place = f"host = {host!r}, port = {port}"
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (OSError, UnicodeError) as error:
        raise SettingsError(
            f"{place}: no such address ({error}); give one of this machine's, or 127.0.0.1"
        ) from error
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        mend = "another program listens there; stop it, or choose another port (0: any free one)"
        if not _is_address_in_use(error):
            mend = "choose an address of this machine, and a port from 1024 on"
        raise SettingsError(f"{place}: cannot listen ({error.strerror}): {mend}") from error
    return listener


def _is_address_in_use(error: OSError) -> bool:
    import errno

    return error.errno == errno.EADDRINUSE


def _check_encryption(host: str, limits: LimitSettings, *, encrypted: bool) -> tuple[str, ...]:
    """Refuse to send passwords over a network as they are, unless told to; then warn."""
    try:
        local = ip_address(host).is_loopback
    except ValueError:
        local = host == "localhost"
    if local or encrypted:
        return ()
    if not limits.allow_plain_http:
        raise SettingsError(
            f"host = {host!r}: without TLS passwords can be read on the way; give tls_certificate and tls_key, "
            "listen on 127.0.0.1, or set allow_plain_http = true under [web.limits]"
        )
    return (f"host = {host!r}: served without TLS, passwords and figures can be read on the way",)
