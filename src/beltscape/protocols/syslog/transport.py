"""One connection to a syslog server: datagrams, or a stream with or without TLS."""

from __future__ import annotations

import select
import socket
import ssl
from contextlib import suppress

from beltscape.protocols.client_tls import make_client_context
from beltscape.protocols.syslog.rfc5424 import UDP_BYTES, frame_octets
from beltscape.protocols.syslog.settings import SyslogSettings

_TIMEOUT_S = 5.0
"""Time to connect, and to send one message. Chosen: a server that takes longer is as good as away."""


class SyslogConnection:
    """A connection; OSError where it cannot be made or is lost."""

    def __init__(self, settings: SyslogSettings) -> None:
        """Connect; OSError with the reason otherwise."""
        self.limit = UDP_BYTES if settings.transport == "udp" else None
        """Longest message in bytes; None: any."""
        address = settings.host, settings.server_port
        if settings.transport == "udp":
            family, kind, protocol, _, place = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.connect(place)
            return
        plain = socket.create_connection(address, _TIMEOUT_S)
        try:
            plain.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            self._socket = plain if settings.transport == "tcp" else _encrypt(plain, settings)
        except BaseException:
            plain.close()
            raise

    def send(self, message: bytes) -> None:
        """Send a message; OSError if the connection is lost."""
        if self.limit is not None:
            try:
                self._socket.send(message)
            except ConnectionRefusedError:  # the answer to an earlier datagram; this one was not sent
                with suppress(ConnectionRefusedError):
                    self._socket.send(message)
            return
        self._require_open()
        self._socket.sendall(frame_octets(message))

    def close(self) -> None:
        """End the connection."""
        with suppress(OSError):
            if self.limit is None:
                self._socket.shutdown(socket.SHUT_WR)
        self._socket.close()

    def _require_open(self) -> None:
        """Raise OSError where the server has closed the stream: what is sent after that is lost without notice."""
        while select.select([self._socket], [], [], 0)[0]:
            self._socket.settimeout(0.0)
            try:
                if not self._socket.recv(4096):
                    raise ConnectionResetError("the server has closed the connection")
            except (BlockingIOError, ssl.SSLWantReadError):
                return
            finally:
                self._socket.settimeout(_TIMEOUT_S)


def _encrypt(plain: socket.socket, settings: SyslogSettings) -> ssl.SSLSocket:
    context = make_client_context(settings.tls_ca, settings.tls_certificate, settings.tls_key)
    return context.wrap_socket(plain, server_hostname=settings.host)
