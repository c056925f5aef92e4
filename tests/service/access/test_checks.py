"""Checks of a request's host, path and origin."""

from __future__ import annotations

from urllib.parse import quote, unquote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.service.access.guard import is_host_allowed, is_path_allowed, is_same_origin, list_own_names

NAMES = list_own_names(("Belt.Plant.example",))


def is_allowed(target: str) -> bool:
    """Check a path as uvicorn passes it on."""
    return is_path_allowed(unquote(target), target.encode())


@pytest.mark.parametrize(
    "target",
    [
        "/../users.db", "/..", "/page/../../users.db", "/page/..%2f..%2fusers.db", "/%2e%2e/users.db",
        "/%2E%2e%2Fusers.db", "/page/%252e%252e/users.db", "/..%5c..%5cusers.db", "/page\\..\\users.db",
        "//etc/passwd", "/page//x", "/page/./x", "/.git/config", "/page/.env", "/a%00.png", "/a%0d%0aX: y",
        "/%c0%ae%c0%ae/users.db",
        "/%ff", "", "page", "*", "http://elsewhere/", "/a\tb", "/%e2%80%ae", "/..;/x", "/page/..%c0%af", "/%2f",
    ],
)  # fmt: skip
def test_disguised_paths_are_refused(target):
    assert not is_allowed(target)


@pytest.mark.parametrize(
    "target", ["/", "/page/app.js", "/api/access/users/anna", "/page/", "/api/users/%E7%8E%8B"]
)
def test_plain_paths_are_allowed(target):
    assert is_allowed(target)


@given(st.text(min_size=1, max_size=30))
def test_allowed_paths_never_lead_upwards(text):
    target = quote("/page/" + text, safe="/.%;\\")
    if is_allowed(target):
        decoded = unquote(target)
        assert ".." not in decoded.split("/")
        assert decoded.isprintable()
        assert unquote(decoded) == decoded, "nothing is left to decode"


@pytest.mark.parametrize(
    "host",
    ["localhost", "localhost:8460", "127.0.0.1:8460", "192.0.2.7", "[::1]:80", "[2001:db8::1]", "belt.plant.example",
     "BELT.plant.example.:443"],
)  # fmt: skip
def test_own_hosts_are_allowed(host):
    assert is_host_allowed(host, NAMES)


@pytest.mark.parametrize(
    "host",
    ["", "evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "belt.plant.example@evil.example",
     "localhost:80:80", "localhost:port", "localhost/x", "local host", "[::1", "[nonsense]", "1.2.3",
     "localhost\r\nX: y"],
)  # fmt: skip
def test_foreign_hosts_are_refused(host):
    assert not is_host_allowed(host, NAMES)


OWN = {"host": "belt.example:8460"}


@pytest.mark.parametrize(
    ("headers", "unsafe", "fine"),
    [
        ({}, True, True),
        ({"origin": "http://belt.example:8460"}, True, True),
        ({"origin": "HTTP://Belt.example:8460", "sec-fetch-site": "same-origin"}, True, True),
        ({"origin": "https://belt.example:8460"}, True, False),
        ({"origin": "http://belt.example"}, True, False),
        ({"origin": "http://evil.example"}, False, False),
        ({"origin": "null"}, True, False),
        ({"origin": ""}, True, False),
        ({"sec-fetch-site": "cross-site"}, True, False),
        ({"sec-fetch-site": "same-site"}, True, False),
        ({"sec-fetch-site": "none"}, True, False),
        ({"sec-fetch-site": "none"}, False, True),
        ({"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}, False, True),
        ({"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"}, False, False),
        ({"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}, True, False),
    ],
)
def test_changes_are_allowed_from_the_own_page_only(headers, unsafe, fine):
    assert is_same_origin({**OWN, **headers}, "http", unsafe=unsafe) == fine


def test_a_socket_must_have_the_origin_of_its_page():
    assert is_same_origin({**OWN, "origin": "https://belt.example:8460"}, "wss", unsafe=True)
    assert not is_same_origin({**OWN, "origin": "http://belt.example:8460"}, "wss", unsafe=True)
