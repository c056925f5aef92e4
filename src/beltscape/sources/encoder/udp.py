"""Encoder readings received as UDP datagrams."""

from __future__ import annotations

import socket
from threading import Event
from time import monotonic_ns

from beltscape.core.errors import InputError
from beltscape.core.supervision import make_supervised_thread
from beltscape.sources.encoder.readings import EncoderOffset, ReadingStream
from beltscape.sources.encoder.settings import EncoderSettings

_LARGEST = 2048
"""Bytes of a datagram: more than an Ethernet frame carries (1500)."""
_PATIENCE_S = 0.2
"""Longest wait for a datagram before the end is checked, and pause after a failure of the socket."""


class UdpEncoder(ReadingStream):
    """Receives text datagrams ``position`` or ``timestamp,position``, one or several lines each."""

    def __init__(
        self, settings: EncoderSettings, offset: EncoderOffset | None = None, resume_mm: float | None = None
    ) -> None:
        """Start receiving; InputError if the address cannot be opened."""
        super().__init__(settings, offset, resume_mm)
        self._socket = _open_socket(settings.host, settings.port)
        self._stop = Event()
        self._thread = make_supervised_thread("encoder", self._run, self.add_failure, self._stop.wait)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                data, sender = self._socket.recvfrom(_LARGEST)
            except TimeoutError:
                continue
            except OSError as error:
                now_ns = monotonic_ns()
                self.add_notice(
                    "socket", f"datagrams cannot be received ({error}); check the network", now_ns
                )
                self._stop.wait(_PATIENCE_S)
                continue
            now_ns = monotonic_ns()
            if self._settings.sender and sender[0] != self._settings.sender:
                self.add_notice(
                    "sender", f"datagrams of {sender[0]} are left out; set sender to accept them", now_ns
                )
                continue
            for line in data.decode("utf-8", "replace").splitlines():
                self.add_line(line, now_ns)

    def close(self) -> None:
        """Stop receiving."""
        super().close()
        self._stop.set()
        self._thread.join()
        self._socket.close()


def _open_socket(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0][0]
        sock = socket.socket(family, socket.SOCK_DGRAM)
    except OSError as error:
        raise InputError(
            f"encoder: host = {host!r} is no address ({error.strerror}); give one of this machine"
        ) from error
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise InputError(
            f"encoder: cannot listen at {host} port {port} ({error.strerror}); give a free port of this machine"
        ) from error
    sock.settimeout(_PATIENCE_S)
    return sock
