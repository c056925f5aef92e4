"""The web server over real sockets: listening, stopping, TLS."""

from __future__ import annotations

import socket
import ssl
import time
from contextlib import ExitStack, closing

import pytest
from fastapi import FastAPI
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from beltscape.core.errors import OutputError, SettingsError
from beltscape.service.access import LimitSettings
from beltscape.service.hosting import serve
from tests.service.access.certificates import make_certificate
from tests.service.running import Web, get_host_and_port, make_cookie_header, open_session, send_raw


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
    running = start(Web(tls_certificate=cert, tls_key=key, limits=LimitSettings(header_timeout_s=2)))
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
    with closing(socket.create_connection(get_host_and_port(running), timeout=60)) as silent:
        assert silent.recv(10) == b"", "who does not shake hands is cut off"
