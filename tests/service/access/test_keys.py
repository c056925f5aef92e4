"""A program's key allows a viewer's reads and no changes."""

from __future__ import annotations

import asyncio
from collections.abc import MutableMapping
from typing import Any

import pytest

from beltscape.core.errors import InputError
from tests.service.access.sample_app import Browser, make_application


def make_header(key: str) -> dict[str, str]:
    return {"authorization": f"Bearer {key}"}


def test_a_key_allows_reading_only(access, app):
    key = access.keys.create("Prometheus")
    browser = Browser(app)
    assert browser("GET", "/look", make_header(key)).json() == {"name": "key prometheus", "role": "viewer"}
    assert browser("GET", "/look", {"authorization": f"bearer  {key}"}).status_code == 200
    reply = browser("POST", "/alarms/a/acknowledge", make_header(key))
    assert reply.status_code == 403
    assert "allows reading only" in reply.json()["detail"]
    assert browser("GET", "/api/access/users", make_header(key)).status_code == 403
    assert browser("GET", "/look").status_code == 401


def test_a_key_takes_precedence_over_a_session(access, app):
    browser = Browser(app)
    browser.log_in("the-engineer")
    assert browser("POST", "/alarms/a/acknowledge", make_header(access.keys.create("a"))).status_code == 403


def test_a_key_opens_no_live_channel(access):
    headers = {"host": "localhost", "origin": "http://localhost", **make_header(access.keys.create("a"))}
    scope = {
        "type": "websocket", "scheme": "ws", "path": "/live", "raw_path": b"/live", "query_string": b"",
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
        "client": ("10.0.0.1", 5000), "server": ("localhost", 80), "subprotocols": [],
    }  # fmt: skip
    sent: list[MutableMapping[str, Any]] = []

    async def receive() -> dict:
        return {"type": "websocket.connect"}

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    asyncio.run(make_application(access)(scope, receive, send))
    assert [message["type"] for message in sent] == ["websocket.close"]
    assert "allows reading only" in sent[0]["reason"]


@pytest.mark.parametrize("key", ["", "x", "ü" * 40, "A" * 3000])
def test_unknown_keys_are_refused(app, key):
    reply = Browser(app)("GET", "/look", {"authorization": f"Bearer {key}".encode("latin-1")})
    assert reply.status_code == 401


def test_other_authorization_schemes_are_ignored(access, app):
    browser = Browser(app)
    assert browser("GET", "/look", {"authorization": "Basic YTpi"}).status_code == 401
    browser.log_in("the-viewer")
    assert browser("GET", "/look", {"authorization": "Basic YTpi"}).status_code == 200


def test_replacing_or_removing_a_key_ends_the_old_one(access, app):
    old, browser = access.keys.create("a"), Browser(app)
    new = access.keys.create("A")
    assert browser("GET", "/look", make_header(old)).status_code == 401
    assert browser("GET", "/look", make_header(new)).status_code == 200
    access.keys.remove("a")
    assert browser("GET", "/look", make_header(new)).status_code == 401
    assert access.keys.list() == ()
    with pytest.raises(InputError, match="there is none"):
        access.keys.remove("a")


def test_keys_are_stored_as_hashes(access, tmp_path):
    key = access.keys.create("a")
    kept = b"".join(path.read_bytes() for path in tmp_path.glob("users.db*"))
    assert b"users" in kept
    assert key.encode() not in kept


def test_keys_are_rate_limited(make):
    access = make(requests_per_s=1, requests_burst=5)
    browser, key = Browser(make_application(access)), access.keys.create("a")
    assert 429 in {browser("GET", "/look", make_header(key)).status_code for _ in range(8)}
