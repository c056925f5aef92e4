"""A service as a process: its web server, uvicorn in a thread of its own, and its start and end.

A run in a terminal or under systemd has a log, stop signals, a watchdog and a summary. The plant's service and the
page of several plants share this.
"""

from __future__ import annotations

import logging
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from ssl import SSLContext
from time import monotonic
from typing import Any, Protocol

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn import Config, Server
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from beltscape.core.errors import OutputError, SettingsError
from beltscape.core.supervision import log_uncaught_errors, make_supervised_thread
from beltscape.core.system_calls import notify, watchdog_s
from beltscape.service.access.connections import make_protocols
from beltscape.service.access.sessions import PATH_PREFIX
from beltscape.service.settings import LimitSettings
from beltscape.service.tls import create_tls_context, describe_expiry

STOP_S = 2.0
"""Time limit for stopping, far below systemd's 90 s. Three quarters are for running requests."""
_BACKLOG = 128
"""Connections that may wait to be accepted: few enough for a process's limit of open files."""
_PREFIX = re.compile(r"(/[A-Za-z0-9._~-]{1,64}){1,8}")
"""A path below which a proxy serves the page, without the slash at its end."""


class ListenSettings(Protocol):
    """Settings of a listening server; ``WebSettings`` has them."""

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
        """Limits on connections."""
        ...


@dataclass(frozen=True, slots=True)
class RunningServer:
    """A web server that runs until it is closed."""

    address: str
    """Address of the server, such as "https://127.0.0.1:8460"."""
    warnings: tuple[str, ...]
    """Warnings about its settings, one line each."""
    _server: Server
    _thread: threading.Thread
    _tls: SSLContext | None = None

    @property
    def is_alive(self) -> bool:
        """True while the server answers requests."""
        return self._thread.is_alive()

    def exchange_certificate(self, certificate: Path, key: Path) -> None:
        """Serve new connections with another certificate; open ones go on. InputError if it cannot be used."""
        create_tls_context(certificate, key)
        if self._tls is not None:
            self._tls.load_cert_chain(certificate, key)

    def close(self) -> None:
        """Stop within two seconds: WebSockets are closed, running requests are finished."""
        self._server.should_exit = True
        self._thread.join(STOP_S * 0.75)
        if self._thread.is_alive():
            self._server.force_exit = True
            self._thread.join(STOP_S * 0.25)


def check_listening(settings: ListenSettings) -> None:
    """Raise the error that `serve` would raise with these settings, without leaving anything open."""
    _check_encryption(settings.host, settings.limits, encrypted=settings.tls_certificate is not None)
    if settings.tls_certificate and settings.tls_key:
        create_tls_context(settings.tls_certificate, settings.tls_key)
    bind_socket(settings.host, settings.port).close()


def serve(app: ASGIApp, settings: ListenSettings) -> RunningServer:
    """Start to serve ``app``. InputError, SettingsError or OutputError with one line if that fails."""
    limits, tls = settings.limits, None
    warnings = _check_encryption(settings.host, limits, encrypted=settings.tls_certificate is not None)
    if settings.tls_certificate and settings.tls_key:
        tls = create_tls_context(settings.tls_certificate, settings.tls_key)
        expiry = describe_expiry(settings.tls_certificate, settings.tls_key)
        warnings += (expiry,) if expiry else ()
    listener = bind_socket(settings.host, settings.port)
    http, websocket = make_protocols(limits, tls)
    if limits.trusted_proxies:
        app = _TrustedProxies(app, limits.trusted_proxies)
    config = Config(
        app, loop="asyncio", http=http, ws=websocket, lifespan="auto",
        log_config=None, log_level="error", access_log=False, server_header=False, backlog=_BACKLOG,
        proxy_headers=False,
        h11_max_incomplete_event_size=limits.header_max_bytes, timeout_keep_alive=limits.keep_alive_s,
        ws_max_size=limits.socket_max_bytes, ws_max_queue=8, ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )  # fmt: skip
    server = Server(config)
    thread = make_supervised_thread(
        "beltscape-web", lambda: _run(server, listener), lambda _: None, lambda s: _wait_to_stop(server, s)
    )
    thread.start()
    while not server.started and thread.is_alive():
        time.sleep(0.005)
    if not thread.is_alive():
        listener.close()
        raise OutputError(f"web server on {settings.host}: did not start; its log says why")
    host, port = listener.getsockname()[:2]
    if ip_address(host).is_unspecified:
        host = socket.gethostname()
    host_part = f"[{host}]" if ":" in host else host
    return RunningServer(f"{'https' if tls else 'http'}://{host_part}:{port}", warnings, server, thread, tls)


class _TrustedProxies:
    """Takes client, scheme and path prefix of a request from the headers of a trusted proxy."""

    def __init__(self, app: ASGIApp, addresses: tuple[str, ...]) -> None:
        self._app: Any = ProxyHeadersMiddleware(app, list(addresses))  # pyrefly: ignore[bad-argument-type]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        client = scope.get("client")
        if client and client[0] in self._app.trusted_hosts:
            prefix = Headers(scope=scope).get("x-forwarded-prefix", "").rstrip("/")
            if _PREFIX.fullmatch(prefix):
                scope[PATH_PREFIX] = prefix
        await self._app(scope, receive, send)


def _run(server: Server, listener: socket.socket) -> None:
    # uvicorn exits if the application does not start; here that only ends the thread, which `serve` notices
    with suppress(SystemExit):
        server.run([listener])


def _wait_to_stop(server: Server, seconds: float) -> bool:
    time.sleep(seconds)
    return server.should_exit


def bind_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens on host and port."""
    address_text = f"host = {host!r}, port = {port}"
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SettingsError(
            f"{address_text}: no such address ({reason}); give one of this machine's, or 127.0.0.1"
        ) from error
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        fix = "another program listens there; stop it, or choose another port (0: any free one)"
        if not _is_address_in_use(error):
            fix = "choose an address of this machine, and a port from 1024 on or that the service may have"
        raise SettingsError(f"{address_text}: cannot listen ({error.strerror}): {fix}") from error
    return listener


def _is_address_in_use(error: OSError) -> bool:
    import errno

    return error.errno == errno.EADDRINUSE


def _check_encryption(host: str, limits: LimitSettings, *, encrypted: bool) -> tuple[str, ...]:
    """Refuse to serve passwords over a network without TLS, or warn if the settings allow it."""
    try:
        is_local = ip_address(host).is_loopback
    except ValueError:
        is_local = host == "localhost"
    if is_local or encrypted:
        return ()
    if not limits.allow_plain_http:
        raise SettingsError(
            f"host = {host!r}: without TLS passwords can be read on the way; give tls_certificate and tls_key, "
            "listen on 127.0.0.1, or set allow_plain_http = true under [web.limits]"
        )
    return (f"host = {host!r}: served without TLS, passwords and figures can be read on the way",)


def log_to_stderr() -> None:
    """Write the log to standard error, with date and level."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log = logging.getLogger("beltscape")
    log.handlers[:] = [handler]
    log.setLevel(logging.INFO)
    log.propagate = False
    # a line for every answer to a client that has left, which would let anybody fill the log
    logging.getLogger("asyncio").setLevel(logging.ERROR)
    log_uncaught_errors()


def make_stop_event() -> threading.Event:
    """Return an event that SIGINT and SIGTERM set."""
    event = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: event.set())
    return event


def log_address(page: RunningServer | None) -> None:
    """Log the page's address, if there is a page, and its warnings."""
    log = logging.getLogger("beltscape")
    for warning in () if page is None else page.warnings:
        log.warning("%s", warning)
    log.info("measuring%s", "" if page is None else f"; the page is at {page.address}")


def make_watchdog() -> Callable[[], None]:
    """Return a function that notifies systemd's watchdog, three times in its interval."""
    interval_s = watchdog_s()
    if interval_s is None:
        return lambda: None
    last_s = [float("-inf")]

    def notify_watchdog() -> None:
        if monotonic() - last_s[0] > interval_s / 3:
            last_s[0] = monotonic()
            notify("WATCHDOG=1")

    return notify_watchdog


def format_summary(result: Mapping[str, Any]) -> str:
    """Return the summary of a run in a few lines."""
    valid, degraded, missing = (result[f"{name}_mm"] * 1e-3 for name in ("valid", "degraded", "missing"))
    lines = [
        f"volume {result['volume_mm3'] * 1e-6:.3f} l on {valid + degraded + missing:.3f} m of belt in "
        f"{result['records']} records",
        f"belt   {valid:.3f} m valid, {degraded:.3f} m degraded, {missing:.3f} m missing",
    ]
    if result["mass_kg"] == result["mass_kg"]:
        lines.append(f"mass   {result['mass_kg']:.2f} kg")
    for key, start in (("latency", "delay "), ("latency_after_view", "  after the last view")):
        latency = result[key]
        if latency["records"]:
            parts = (latency[f"{name}_s"] for name in ("median", "most_90", "most_99", "worst"))
            words = "{:.2f} s median, {:.2f} s 90 %, {:.2f} s 99 %, {:.2f} s worst".format(*parts)
            lines.append(f"{start} {words}")
    if result["unwritten_records"]:
        lines.append(
            f"{result['unwritten_records']} records could not be written to disk; see the log for the reason"
        )
    return "\n".join([*lines, f"history in {result['data']}"])
