"""The web server's limits of connections and sockets, and who may open them."""

from __future__ import annotations

import socket
import time
from contextlib import closing

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from beltscape.service.access import LimitSettings
from beltscape.service.hosting import serve
from tests.service.access.sample_app import PASSWORD
from tests.service.running import Web, get_host_and_port, make_cookie_header, open_session, send_raw


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
