"""A running server's settings, and clients of it."""

from __future__ import annotations

import re
import socket
from collections.abc import Generator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from beltscape.service.access import LimitSettings
from tests.service.access.sample_app import PASSWORD


@dataclass(frozen=True)
class Web:
    """Settings of the server, as WebSettings has them."""

    host: str = "127.0.0.1"
    port: int = 0
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    limits: LimitSettings = field(default_factory=LimitSettings)


def get_host_and_port(running) -> tuple[str, int]:
    host, port = running.address.rpartition("//")[2].rsplit(":", 1)
    return host, int(port)


def send_raw(running, request: bytes, timeout_s: float = 5) -> bytes:
    """Send bytes; return the first response, or everything received until the connection was closed."""
    with closing(socket.create_connection(get_host_and_port(running), timeout=timeout_s)) as connection:
        received = b""
        try:
            connection.sendall(request)
            while part := connection.recv(65_536):
                received += part
                head, _, body = received.partition(b"\r\n\r\n")
                length = re.search(rb"content-length: (\d+)", head.lower())
                if length and len(body) >= int(length[1]):
                    break
        except ConnectionError:
            pass
        return received


@contextmanager
def open_session(running, **more: Any) -> Generator[httpx.Client]:
    with httpx.Client(base_url=running.address, **more) as client:
        reply = client.post("/api/access/login", json={"name": "anna", "password": PASSWORD})
        assert reply.status_code == 200
        client.headers["x-beltscape-token"] = reply.json()["token"]
        yield client


def make_cookie_header(client: httpx.Client) -> dict[str, str]:
    return {"Cookie": "; ".join(f"{name}={value}" for name, value in client.cookies.items())}
