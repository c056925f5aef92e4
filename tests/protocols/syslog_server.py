"""A syslog server for tests: it takes datagrams or streams apart as RFC 5424, 5425, 5426 and 6587 demand."""

from __future__ import annotations

import re
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass

_HEADER = re.compile(
    rb"<(?P<pri>0|[1-9]\d{0,2})>1 "
    rb"(?P<time>\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d{1,6})?(?:Z|[+-]\d\d:\d\d)) "
    rb"(?P<host>[!-~]{1,255}) (?P<app>[!-~]{1,48}) (?P<proc>[!-~]{1,128}) (?P<msgid>[!-~]{1,32}) "
)
_ELEMENT = re.compile(rb'\[([!#-<>-\\^-~]{1,32})((?: [!#-<>-\\^-~]{1,32}="(?:\\["\\\]]|[^"\\\]])*")*)\]')
_PARAMETER = re.compile(rb' ([!#-<>-\\^-~]{1,32})="((?:\\["\\\]]|[^"\\\]])*)"')


@dataclass(frozen=True)
class Received:
    """A message that was taken apart."""

    severity: int
    facility: int
    host: str
    app: str
    msgid: str
    data: dict[str, dict[str, str]]
    text: str
    raw: bytes

    @property
    def number(self) -> int:
        return int(self.data["meta"]["sequenceId"])

    @property
    def alarm(self) -> dict[str, str]:
        return self.data["alarm@32473"]


def parse(raw: bytes) -> Received:
    """Take a message apart by the grammar of RFC 5424, section 6; AssertionError where it is not one."""
    head = _HEADER.match(raw)
    assert head is not None, raw
    at, data = head.end(), {}
    while element := _ELEMENT.match(raw, at):
        values = {
            key.decode(): re.sub(rb'\\(["\\\]])', rb"\1", value).decode()
            for key, value in _PARAMETER.findall(element[2])
        }
        assert element[1].decode() not in data, "an element twice"
        data[element[1].decode()] = values
        at = element.end()
    assert data and raw[at : at + 1] in (b" ", b""), raw
    body = raw[at + 1 :]
    if body.startswith(b"\xef\xbb\xbf"):
        body = body[3:]
    else:
        assert body.isascii(), "a text beyond ASCII needs the byte order mark"
    text = body.decode()
    assert not re.search(r"[\x00-\x1f\x7f]", raw.decode()), "a control character"
    pri = int(head["pri"])
    assert pri < 192
    return Received(
        pri % 8,
        pri // 8,
        head["host"].decode(),
        head["app"].decode(),
        head["msgid"].decode(),
        data,
        text,
        raw,
    )


def split_frames(stream: bytearray) -> Iterator[bytes]:
    """Take whole messages off a stream with octet counting."""
    while match := re.match(rb"([1-9]\d*) ", stream):
        length = int(match[1])
        if len(stream) < match.end() + length:
            return
        yield bytes(stream[match.end() : match.end() + length])
        del stream[: match.end() + length]
    assert re.fullmatch(rb"([1-9]\d*)?", stream), stream


class Server:
    """Listens on a port of its own; messages are in ``received``."""

    def __init__(self, kind: str, port: int = 0, context: ssl.SSLContext | None = None) -> None:
        self.kind, self._context = kind, context
        self.received: list[Received] = []
        self.failures: list[str] = []
        self._connections: list[socket.socket] = []
        is_stream = kind != "udp"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM if is_stream else socket.SOCK_DGRAM)
        if is_stream:  # for datagrams, two servers could share a port
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(("127.0.0.1", port))
        self.port = self._socket.getsockname()[1]
        if is_stream:
            self._socket.listen()
        self._is_open = True
        work = self._accept if is_stream else self._take_datagrams
        threading.Thread(target=work, daemon=True).start()

    def close(self) -> None:
        """Stop, as a server that dies."""
        self._is_open = False
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        for connection in self._connections:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def _take_datagrams(self) -> None:
        with suppress(OSError):
            while self._is_open:
                if datagram := self._socket.recv(65_536):  # empty: the socket was shut down
                    self._keep(datagram)

    def _accept(self) -> None:
        with suppress(OSError):
            while self._is_open:
                connection = self._socket.accept()[0]
                threading.Thread(target=self._read, args=(connection,), daemon=True).start()

    def _read(self, connection: socket.socket) -> None:
        stream = bytearray()
        with suppress(OSError), closing(connection):
            if self._context is not None:
                connection = self._context.wrap_socket(connection, server_side=True)
            self._connections.append(connection)
            with closing(connection):
                while part := connection.recv(65_536):
                    stream += part
                    for message in split_frames(stream):
                        self._keep(message)

    def _keep(self, message: bytes) -> None:
        try:
            self.received.append(parse(message))
        except (AssertionError, UnicodeDecodeError) as error:
            self.failures.append(repr(error))
