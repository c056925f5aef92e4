"""The web server over real sockets: listening, stopping, limits."""

from __future__ import annotations

import re
import socket
import ssl
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from beltscape.core.errors import OutputError, SettingsError
from beltscape.service.access import Access, AccessSettings, LimitSettings
from beltscape.service.server import serve
from tests.service.access.certificates import make_certificate
from tests.service.access.sample_app import CHEAP, PASSWORD, make_application


@dataclass(frozen=True)
class Web:
    """Settings of the server, as WebSettings has them."""

    host: str = "127.0.0.1"
    port: int = 0
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    limits: LimitSettings = field(default_factory=LimitSettings)


@pytest.fixture
def start(tmp_path):
    """Return a function that serves the sample application; servers are stopped at the end."""
    opened = []

    def start_server(web: Web | None = None, **access: Any):
        access_control = Access(tmp_path, AccessSettings(**access), CHEAP)
        opened.append(access_control)
        if access_control.accounts.is_setup_open:
            access_control.accounts.add("anna", "operator", PASSWORD)
        running = serve(make_application(access_control), web or Web())
        opened.append(running)
        return running

    yield start_server
    for one in reversed(opened):
        one.close()


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
def open_session(running, **more: Any) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=running.address, **more) as client:
        reply = client.post("/api/access/login", json={"name": "anna", "password": PASSWORD})
        assert reply.status_code == 200
        client.headers["x-beltscape-token"] = reply.json()["token"]
        yield client


def make_cookie_header(client: httpx.Client) -> dict[str, str]:
    return {"Cookie": "; ".join(f"{name}={value}" for name, value in client.cookies.items())}


def test_server_answers_and_stops_in_time(start):
    running = start()
    with open_session(running) as client:
        assert client.get("/look").json()["name"] == "anna"
        assert "server" not in client.get("/look").headers
        before = time.monotonic()
        running.close()
        assert time.monotonic() - before < 2
        assert not running.is_alive
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(get_host_and_port(running), timeout=1)


def test_server_stops_in_time_with_open_pages_and_a_slow_reader(start):
    running = start()
    with open_session(running) as client, ExitStack() as pages:
        live = running.address.replace("http", "ws") + "/live"
        opened = [
            pages.enter_context(connect(live, additional_headers=make_cookie_header(client)))
            for _ in range(3)
        ]
        assert opened[0].recv() == "anna"
        slow = pages.enter_context(socket.create_connection(get_host_and_port(running)))
        slow.sendall(b"POST /api/access/login HTTP/1.1\r\nhost: localhost\r\ncontent-length: 50\r\n\r\n{")
        before = time.monotonic()
        running.close()
        assert time.monotonic() - before < 2
        assert not running.is_alive
        for one in opened:
            with pytest.raises(ConnectionClosed):
                while True:
                    one.recv(timeout=2)


def test_sessions_survive_a_restart(start):
    running = start()
    with open_session(running) as client:
        running.close()
        again = start()
        client.base_url = again.address
        assert client.get("/look").json()["name"] == "anna"


def test_a_port_in_use_is_refused(start):
    host, port = get_host_and_port(start())
    with pytest.raises(SettingsError) as raised:
        serve(FastAPI(), Web(host, port))
    assert str(raised.value) == (
        f"host = '127.0.0.1', port = {port}: cannot listen (Address already in use): another program listens there; "
        "stop it, or choose another port (0: any free one)"
    )


@pytest.mark.parametrize("host", ["no-such-host.invalid", "192.0.2.1", "x" * 300])
def test_a_foreign_address_is_refused(host):
    with pytest.raises(SettingsError, match="host = "):
        serve(FastAPI(), Web(host, limits=LimitSettings(allow_plain_http=True)))


def test_plain_http_over_a_network_needs_a_setting(start):
    with pytest.raises(
        SettingsError, match="without TLS passwords can be read on the way; give tls_certificate"
    ):
        start(Web("0.0.0.0"))
    running = start(Web("0.0.0.0", limits=LimitSettings(allow_plain_http=True)))
    assert running.warnings == (
        "host = '0.0.0.0': served without TLS, passwords and figures can be read on the way",
    )
    assert socket.gethostname() in running.address


def test_an_application_that_fails_to_start_is_reported():
    async def app(scope, receive, send):
        await receive()
        await send({"type": "lifespan.startup.failed", "message": "no"})

    with pytest.raises(OutputError, match="did not start"):
        serve(app, Web())


def test_tls_is_served(start, tmp_path):
    cert, key = make_certificate(tmp_path, days=10)
    running = start(Web(tls_certificate=cert, tls_key=key, limits=LimitSettings(header_timeout_s=0.5)))
    assert running.address.startswith("https://127.0.0.1:")
    assert "ends in 10 days" in running.warnings[0]
    trusting = ssl.create_default_context(cafile=str(cert))
    with open_session(running, verify=trusting) as client:
        reply = client.get("/look")
        assert reply.json()["name"] == "anna"
        assert reply.headers["strict-transport-security"]
        assert list(client.cookies) == ["__Host-beltscape"]
        with connect(
            running.address.replace("https", "wss") + "/live", ssl=trusting,
            additional_headers={**make_cookie_header(client), "Origin": running.address},
        ) as page:  # fmt: skip
            assert page.recv() == "anna"
    old = ssl.create_default_context(cafile=str(cert))
    with pytest.warns(DeprecationWarning):
        old.minimum_version = ssl.TLSVersion.TLSv1
        old.maximum_version = ssl.TLSVersion.TLSv1_1
    with (
        pytest.raises((ssl.SSLError, ConnectionResetError)),
        socket.create_connection(get_host_and_port(running)) as plain,
    ):
        old.wrap_socket(plain, server_hostname="localhost")
    assert send_raw(running, b"GET / HTTP/1.1\r\nhost: localhost\r\n\r\n") == b"", "no plain HTTP there"
    with closing(socket.create_connection(get_host_and_port(running), timeout=5)) as silent:
        before = time.monotonic()
        assert silent.recv(10) == b"", "who does not shake hands is cut off"
        assert time.monotonic() - before < 2


def test_slow_headers_are_disconnected(start):
    running = start(Web(limits=LimitSettings(header_timeout_s=0.4)))
    for beginning in (b"", b"GET", b"GET /look HTTP/1.1\r\nhost: localhost\r\nx"):
        with closing(socket.create_connection(get_host_and_port(running), timeout=5)) as slow:
            before = time.monotonic()
            slow.sendall(beginning)
            with pytest.raises((ConnectionError, EOFError)):
                for _ in range(100):  # a byte now and then does not help
                    time.sleep(0.05)
                    slow.sendall(b"a")
                    if beginning == b"" and time.monotonic() - before > 2:
                        raise EOFError
            assert time.monotonic() - before < 3


def test_an_idle_connection_is_closed_and_a_busy_one_kept(start):
    running = start(Web(limits=LimitSettings(keep_alive_s=1, header_timeout_s=0.5)))
    with closing(socket.create_connection(get_host_and_port(running), timeout=5)) as connection:
        for _ in range(3):
            connection.sendall(b"GET /page/x HTTP/1.1\r\nhost: localhost\r\n\r\n")
            reply = b""
            while not reply.endswith(b'"Not Found"}'):
                reply += connection.recv(65_536)
            assert reply.startswith(b"HTTP/1.1 404")
            time.sleep(0.6)
        before = time.monotonic()
        assert connection.recv(10) == b""
        assert time.monotonic() - before < 2


def test_a_client_that_does_not_read_is_disconnected(tmp_path):
    """A client that reads nothing must not hold memory or a connection forever."""

    async def endless(scope, receive, send):
        if scope["type"] != "http":
            return
        await send({"type": "http.response.start", "status": 200, "headers": []})
        for _ in range(2000):
            await send({"type": "http.response.body", "body": b"x" * 65_536, "more_body": True})

    running = serve(endless, Web(limits=LimitSettings(write_timeout_s=0.5)))
    with closing(socket.create_connection(get_host_and_port(running))) as reader:
        reader.sendall(b"GET / HTTP/1.1\r\nhost: localhost\r\n\r\n")
        time.sleep(1.5)
        received = 0
        while part := reader.recv(65_536):
            received += len(part)
        assert received < 30_000_000, "of 131 MB, what the system's buffers held"
    running.close()


def test_connections_are_limited(start):
    running = start(Web(limits=LimitSettings(connections_per_address=8, connections_max=8)))
    held = [socket.create_connection(get_host_and_port(running), timeout=5) for _ in range(8)]
    time.sleep(0.2)
    assert send_raw(running, b"GET /look HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n") == b""
    for one in held:
        one.close()
    time.sleep(0.2)
    assert send_raw(
        running, b"GET /look HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n"
    ).startswith(b"HTTP/1.1 401")


def test_sockets_are_limited(start):
    running = start(sockets_per_address=2)
    live = running.address.replace("http", "ws") + "/live"
    with open_session(running) as client:
        with (
            connect(live, additional_headers=make_cookie_header(client)) as one,
            connect(live, additional_headers=make_cookie_header(client)),
        ):
            assert one.recv() == "anna"
            with pytest.raises(InvalidStatus, match="403"):
                connect(live, additional_headers=make_cookie_header(client))
        time.sleep(0.2)
        with connect(live, additional_headers=make_cookie_header(client)) as one:
            assert one.recv() == "anna"


@pytest.mark.parametrize("headers", [{}, {"Cookie": "beltscape=nonsense"}])
def test_sockets_require_login(start, headers):
    with pytest.raises(InvalidStatus, match="403"):
        connect(start().address.replace("http", "ws") + "/live", additional_headers=headers)


def test_sockets_require_the_own_origin(start):
    running = start()
    live = running.address.replace("http", "ws") + "/live"
    with open_session(running) as client:
        for origin in ("http://evil.example", "null", running.address + ".evil.example"):
            with pytest.raises(InvalidStatus, match="403"):
                connect(live, additional_headers={**make_cookie_header(client), "Origin": origin})
        with connect(
            live, additional_headers={**make_cookie_header(client), "Origin": running.address}
        ) as page:
            assert page.recv() == "anna"


def test_logging_out_closes_the_sockets(start):
    running = start()
    with open_session(running) as client:
        with connect(
            running.address.replace("http", "ws") + "/live", additional_headers=make_cookie_header(client)
        ) as page:
            assert page.recv() == "anna"
            assert client.post("/api/access/logout").status_code == 200
            with pytest.raises(ConnectionClosed) as closed:
                while True:
                    page.recv(timeout=3)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4401


def test_only_trusted_proxies_forward_addresses(start):
    headers = {"X-Forwarded-Proto": "https", "X-Forwarded-For": "192.0.2.9", "Host": "127.0.0.1"}
    login = {"name": "anna", "password": PASSWORD}
    proxied = start(Web(limits=LimitSettings(trusted_proxies=("127.0.0.1",))))
    reply = httpx.post(proxied.address + "/api/access/login", json=login, headers=headers)
    assert "Secure" in reply.headers["set-cookie"]
    assert reply.headers["strict-transport-security"]
    direct = start()
    reply = httpx.post(direct.address + "/api/access/login", json=login, headers=headers)
    assert "Secure" not in reply.headers["set-cookie"]
