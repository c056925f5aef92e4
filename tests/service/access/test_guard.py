"""The guard: roles, other sites, limits and headers of every request."""

from __future__ import annotations

import asyncio
import json

import pytest

from tests.service.access.sample_app import PASSWORD, Browser, make_application


def test_every_path_requires_login(app):
    browser = Browser(app)
    for path in ("/look", "/api/openapi.json", "/docs", "/openapi.json", "/nothing"):
        assert browser("GET", path).status_code == 401, path
    assert browser("POST", "/alarms/a/acknowledge").status_code == 401
    reply = browser("GET", "/look", headers={"accept": "text/html,*/*"}, follow_redirects=False)
    assert (reply.status_code, reply.headers["location"]) == (303, "login?next=look")


@pytest.mark.parametrize(("role", "status"), [("viewer", 403), ("operator", 200), ("engineer", 200)])
def test_roles_are_enforced(app, role, status):
    browser = Browser(app)
    assert browser.log_in(f"the-{role}").status_code == 200
    assert browser("GET", "/look").json() == {"name": f"the-{role}", "role": role}
    assert browser("POST", "/alarms/a/acknowledge").status_code == status
    users = browser("GET", "/api/access/users").status_code
    assert users == (200 if role == "engineer" else 403)


def test_anonymous_viewers_are_allowed_by_setting(make):
    access = make(anonymous_role="viewer")
    access.accounts.add("the-engineer", "engineer", PASSWORD)
    browser = Browser(make_application(access))
    assert browser("GET", "/look").json() == {"name": "anonymous", "role": "viewer"}
    assert browser("POST", "/alarms/a/acknowledge").status_code == 403
    assert browser("POST", "/api/access/logout").status_code == 200
    assert browser("POST", "/api/access/password", json={"old": "x", "new": "y"}).status_code == 401
    assert browser.log_in("the-engineer").status_code == 200
    assert browser("GET", "/look").json()["role"] == "engineer"


def test_public_paths_need_no_login(access):
    app = make_application(access, public=("/open", "/files/"))
    for path in ("/open", "/files/x"):
        app.add_api_route(path, lambda: {}, methods=["GET"])
    browser = Browser(app)
    assert browser("GET", "/open").status_code == browser("GET", "/files/x").status_code == 200
    assert browser("GET", "/open/x").status_code == browser("GET", "/opener").status_code == 401


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"x-beltscape-token": ""},
        {"x-beltscape-token": "0" * 64},
        {"x-beltscape-token": "\u00fc"},
    ],
)
def test_another_site_cannot_act_for_a_user(app, headers):
    browser = Browser(app)
    browser.log_in("the-operator")
    encoded = {name: value.encode("latin-1") for name, value in headers.items()}
    assert browser("POST", "/alarms/a/acknowledge", headers=encoded).status_code == 403
    own = {"origin": "http://localhost", "sec-fetch-site": "same-origin"}
    assert browser("POST", "/alarms/a/acknowledge", headers=own).status_code == 200


def test_another_site_cannot_log_a_user_in(app):
    reply = Browser(app)(
        "POST", "/api/access/login", headers={"origin": "http://evil.example"},
        json={"name": "the-viewer", "password": PASSWORD},
    )  # fmt: skip
    assert reply.status_code == 403
    assert "set-cookie" not in reply.headers


def test_tokens_of_two_sessions_differ(app):
    one, other = Browser(app), Browser(app)
    one.log_in("the-operator")
    other.log_in("the-operator")
    one.token = other.token
    assert one("POST", "/alarms/a/acknowledge").status_code == 403


def test_foreign_host_names_are_refused(app):
    assert Browser(app, base="http://rebound.evil.example")("GET", "/look").status_code == 400
    assert Browser(app, base="http://192.0.2.1:8460")("GET", "/look").status_code == 401


def test_every_response_has_security_headers(app):
    browser = Browser(app, base="https://localhost")
    browser.log_in("the-viewer")
    for path in ("/look", "/nothing", "/a/../b", "/login"):
        headers = browser("GET", path).headers
        assert "'unsafe" not in headers["content-security-policy"]
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["strict-transport-security"].startswith("max-age=")
        assert "camera=()" in headers["permissions-policy"]
        assert "server" not in headers
    assert "strict-transport-security" not in Browser(app)("GET", "/look").headers


def test_inline_scripts_need_their_hash(access):
    app = make_application(access, script_hashes=("sha256-abc=",))
    assert (
        "script-src 'self' 'sha256-abc=';" in Browser(app)("GET", "/look").headers["content-security-policy"]
    )


def test_cookie_is_hidden_from_scripts_and_other_sites(app):
    cookie = Browser(app).log_in("the-viewer").headers["set-cookie"]
    assert cookie.startswith("beltscape=")
    assert {"HttpOnly", "SameSite=strict", "Path=/", "Max-Age=604800"} <= set(cookie.split("; "))
    cookie = Browser(app, base="https://localhost").log_in("the-viewer").headers["set-cookie"]
    assert cookie.startswith("__Host-beltscape=")
    assert "Secure" in cookie.split("; ")


def test_an_address_is_rate_limited(make):
    access = make(requests_per_s=0.1, requests_burst=5)
    app = make_application(access)
    eager, other = Browser(app, "10.0.0.1"), Browser(app, "10.0.0.2")
    statuses = [eager("GET", "/look").status_code for _ in range(8)]
    assert statuses == [401] * 5 + [429] * 3
    assert int(eager("GET", "/look").headers["retry-after"]) >= 1
    assert other("GET", "/look").status_code == 401


def test_a_user_is_rate_limited_over_all_addresses(make):
    access = make(requests_per_s=0.1, requests_burst=5)
    access.accounts.add("anna", "engineer", PASSWORD)
    app = make_application(access)
    browser = Browser(app)
    browser.log_in("anna")
    statuses = []
    for i in range(8):
        browser.address = f"10.0.1.{i}"
        statuses.append(browser("GET", "/look").status_code)
    assert statuses == [200] * 5 + [429] * 3


def call_asgi(app, messages: list[dict], **scope) -> list[dict]:
    """Return the application's response to a request given as ASGI messages."""
    sent: list[dict] = []

    async def receive() -> dict:
        if messages:
            return messages.pop(0)
        await asyncio.sleep(60)
        raise AssertionError

    async def send(message: dict) -> None:
        sent.append(message)

    full = {
        "type": "http", "method": "POST", "scheme": "http", "path": "/api/access/login", "query_string": b"",
        "raw_path": b"/api/access/login", "client": ("10.0.0.1", 1), "server": ("localhost", 80), "root_path": "",
        "http_version": "1.1", "headers": [(b"host", b"localhost")], **scope,
    }  # fmt: skip
    asyncio.run(app(full, receive, send))
    return sent


def test_a_long_body_is_refused_before_and_while_it_arrives(access):
    app = make_application(access)
    headers = [(b"host", b"localhost"), (b"content-length", b"70000")]
    assert call_asgi(app, [], headers=headers)[0]["status"] == 413
    part = {"type": "http.request", "body": b"x" * 40_000, "more_body": True}
    untold = [(b"host", b"localhost"), (b"transfer-encoding", b"chunked")]
    messages = [part, part, part, part]
    assert call_asgi(app, messages, headers=untold)[0]["status"] == 413
    assert len(messages) == 2, "the rest is not read"
    for length in (b"9" * 400, b"-1", b"1e3", "²".encode()):
        assert (
            call_asgi(app, [], headers=[(b"host", b"localhost"), (b"content-length", length)])[0]["status"]
            == 413
        )


def test_a_slow_body_is_refused(make):
    app = make_application(make(body_timeout_s=0.05))
    headers = [(b"host", b"localhost"), (b"content-length", b"100")]
    part = {"type": "http.request", "body": b"x", "more_body": True}
    sent = call_asgi(app, [part], headers=headers)
    assert sent[0]["status"] == 408
    assert (b"connection", b"close") in sent[0]["headers"]


def test_two_host_headers_are_refused(access):
    headers = [(b"host", b"localhost"), (b"host", b"evil.example")]
    assert call_asgi(make_application(access), [], headers=headers)[0]["status"] == 400


def test_unknown_methods_and_long_addresses_are_refused(app):
    browser = Browser(app)
    for method in ("TRACE", "CONNECT", "BREW", "get"):
        assert call_asgi(app, [], method=method)[0]["status"] == 405
    assert browser("GET", "/look?" + "x" * 5000).status_code == 414
    browser.log_in("the-engineer")
    for method in ("HEAD", "OPTIONS", "PUT", "DELETE"):
        assert browser(method, "/look").status_code == 405


def test_changes_are_audited_automatically(app, access):
    browser = Browser(app)
    browser.log_in("the-operator")
    browser("POST", "/alarms/overload/acknowledge")
    browser("GET", "/api/export?since_ms=1&until_ms=2")
    browser("GET", "/look")
    browser("POST", "/alarms/overload/none")
    newest, older = access.audit.read_last(2)
    assert newest["what"] == "export"
    assert newest["query"] == "since_ms=1&until_ms=2"
    assert older["what"] == "acknowledge"
    assert (older["who"], older["from"]) == ("the-operator", "10.0.0.1")
    assert older["request"] == "POST /alarms/overload/acknowledge"


def test_refused_values_are_not_repeated(app, access):
    browser = Browser(app)
    secret = "x" * 5000
    reply = browser("POST", "/api/access/login", json={"name": "a", "password": secret})
    assert reply.status_code == 422
    assert secret not in reply.text
    for raw in (
        b'{"name": NaN}',
        b'{"name": "\\ud800"}',
        b'{"\\ud800": 1}',
        b"[" * 50_000,
        b"\xff",
        b"1e999",
    ):
        reply = browser(
            "POST", "/api/access/login", content=raw, headers={"content-type": "application/json"}
        )
        assert reply.status_code in (400, 422), raw[:20]
        json.loads(reply.content)
