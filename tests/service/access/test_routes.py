"""The routes of setup, login, logout and user management."""

from __future__ import annotations

import pytest

from tests.service.access.sample_app import PASSWORD, Browser, make_application


def set_up(browser: Browser, token: str | None, name: str = "Anna", password: str = PASSWORD):
    return browser("POST", "/api/access/setup", json={"token": token, "name": name, "password": password})


def test_setup_creates_the_first_engineer(make):
    access = make()
    browser = Browser(make_application(access))
    assert browser("GET", "/api/access/state").json() == {
        "setup": True,
        "user": None,
        "named": False,
        "token": None,
    }
    page = browser("GET", "/", headers={"accept": "text/html"}, follow_redirects=False)
    assert page.headers["location"] == "setup"
    reply = set_up(browser, access.setup_token)
    assert reply.status_code == 201
    assert reply.json()["user"] == {"name": "anna", "role": "engineer"}
    assert browser("GET", "/look").json() == {"name": "anna", "role": "engineer"}
    assert browser("GET", "/api/access/state").json()["setup"] is False
    assert access.setup_token is None
    assert access.setup_token is None


def test_setup_token_is_printed_and_never_stored(make, tmp_path, caplog):
    access = make()
    make_application(access)
    token = access.setup_token
    assert token is not None
    assert len(token.replace("-", "")) == 20
    assert token in caplog.text
    assert all(token.encode() not in file.read_bytes() for file in tmp_path.iterdir())
    assert make().setup_token != token


def test_setup_token_is_accepted_in_every_spelling(make):
    access = make()
    token = access.setup_token or ""
    assert (
        set_up(Browser(make_application(access)), f" {token.upper().replace('-', ' ')} ").status_code == 201
    )


def test_setup_requires_the_token(make):
    access = make()
    browser = Browser(make_application(access))
    for wrong in ("0000-0000-0000-0000-0000", (access.setup_token or "")[:-1], "\u0660" * 20):
        assert set_up(browser, wrong).status_code == 409
    assert access.accounts.list() == ()
    assert [e["what"] for e in access.audit.read_last(9)] == ["setup failed"] * 3


def test_setup_cannot_be_repeated(make):
    access = make()
    token = access.setup_token
    app = make_application(access)
    assert set_up(Browser(app), token).status_code == 201
    again = set_up(Browser(app), token, "Eve")
    assert again.status_code == 409
    assert "setup is over" in again.json()["detail"]
    later = make()
    assert later.setup_token is None
    assert set_up(Browser(make_application(later)), token, "Eve").status_code == 409
    assert [a.name for a in later.accounts.list()] == ["anna"]


def test_guessing_the_setup_token_is_throttled(make):
    access = make()
    browser = Browser(make_application(access))
    statuses = [set_up(browser, f"{i:020}").status_code for i in range(14)]
    assert statuses == [409] * 10 + [429] * 4
    assert set_up(Browser(make_application(access), "10.0.0.2"), access.setup_token).status_code == 201


def test_wrong_passwords_are_throttled_and_reveal_no_user(app):
    browser = Browser(app)
    replies = [browser.log_in(name, "not this one") for name in ("the-viewer", "nobody")]
    assert [r.status_code for r in replies] == [401, 401]
    assert replies[0].json() == replies[1].json()
    statuses = [browser.log_in("the-viewer", "not this one").status_code for _ in range(6)]
    assert statuses == [401] * 4 + [429] * 2
    refused = browser.log_in("the-viewer", PASSWORD)
    assert refused.status_code == 429, "even the right one must wait"
    assert int(refused.headers["retry-after"]) >= 1


def test_guesses_from_elsewhere_do_not_lock_out_known_users(app):
    here = Browser(app, "10.0.0.1")
    assert here.log_in("the-viewer").status_code == 200
    for i in range(60):
        Browser(app, f"10.0.9.{i}").log_in("the-viewer", "not this one")
    assert Browser(app, "10.0.9.200").log_in("the-viewer").status_code == 429
    assert Browser(app, "10.0.0.1").log_in("the-viewer").status_code == 200


def test_login_replaces_the_session_and_logout_ends_it(app):
    browser = Browser(app)
    browser.log_in("the-viewer")
    first = browser.cookies["beltscape"]
    browser.log_in("the-viewer")
    second = browser.cookies["beltscape"]
    assert first != second
    assert browser("POST", "/api/access/logout").status_code == 200
    for token in (first, second):
        browser.cookies.set("beltscape", token)
        assert browser("GET", "/look").status_code == 401


def test_a_new_password_ends_all_other_sessions(app, access):
    here, there = Browser(app), Browser(app)
    here.log_in("the-operator")
    there.log_in("the-operator")
    wrong = here("POST", "/api/access/password", json={"old": "not this one", "new": "ore on the belt"})
    assert wrong.status_code == 401
    weak = here("POST", "/api/access/password", json={"old": PASSWORD, "new": "short"})
    assert weak.status_code == 409
    assert there("GET", "/look").status_code == 200
    assert (
        here("POST", "/api/access/password", json={"old": PASSWORD, "new": "ore on the belt"}).status_code
        == 200
    )
    assert here("GET", "/look").status_code == 200
    assert there("GET", "/look").status_code == 401
    assert there.log_in("the-operator", PASSWORD).status_code == 401
    assert "ore on the belt" not in access.audit.path.read_text()


def test_engineers_manage_users(app, access):
    browser = Browser(app)
    browser.log_in("the-engineer")
    new = {"name": "王伟", "role": "viewer", "password": PASSWORD}
    assert browser("POST", "/api/access/users", json=new).json() == {"name": "王伟", "role": "viewer"}
    assert browser("POST", "/api/access/users", json=new).status_code == 409
    theirs = Browser(app)
    assert theirs.log_in("王伟").status_code == 200
    assert browser("PATCH", "/api/access/users/王伟", json={"role": "operator"}).status_code == 200
    assert theirs("GET", "/look").json()["role"] == "operator", "from the next request on"
    assert browser("PATCH", "/api/access/users/王伟", json={"password": "ore on the belt"}).status_code == 200
    assert theirs("GET", "/look").status_code == 401
    assert theirs.log_in("王伟", "ore on the belt").status_code == 200
    assert browser("DELETE", "/api/access/users/王伟").status_code == 200
    assert theirs("GET", "/look").status_code == 401
    assert browser("DELETE", "/api/access/users/王伟").status_code == 409
    assert browser("PATCH", "/api/access/users/王伟", json={}).status_code == 409
    assert browser("DELETE", "/api/access/users/the-engineer").status_code == 409
    assert [u["name"] for u in browser("GET", "/api/access/users").json()] == [
        "the-engineer", "the-operator", "the-viewer",
    ]  # fmt: skip
    done = [e["what"] for e in browser("GET", "/api/access/audit").json()]
    assert done[:6] == ["user removed", "login", "password changed", "role changed", "login", "user added"]


@pytest.mark.parametrize(
    "method_path", ["GET /users", "POST /users", "PATCH /users/a", "DELETE /users/a", "GET /audit"]
)
@pytest.mark.parametrize("role", ["viewer", "operator"])
def test_user_management_requires_an_engineer(app, role, method_path):
    method, path = method_path.split()
    browser = Browser(app)
    browser.log_in(f"the-{role}")
    body = {"name": "eve", "role": "engineer", "password": PASSWORD} if method == "POST" else {}
    assert browser(method, f"/api/access{path}", json=body).status_code == 403


@pytest.mark.parametrize("path", ["/login", "/setup", "/access/common.js", "/access/access.css"])
def test_login_pages_are_public(app, path):
    reply = Browser(app)("GET", path)
    assert reply.status_code == 200
    if path in ("/login", "/setup"):
        assert "<script>" not in reply.text
        assert " style=" not in reply.text


def test_the_account_page_requires_login(app):
    assert Browser(app)("GET", "/account").status_code == 401


def test_login_works_on_a_full_disk(app, access):
    access._database.select("PRAGMA query_only = 1")
    browser = Browser(app)
    assert browser.log_in("the-engineer").status_code == 200
    assert browser("GET", "/look").status_code == 200
    reply = browser(
        "POST", "/api/access/users", json={"name": "bert", "role": "viewer", "password": PASSWORD}
    )
    assert reply.status_code == 507
    assert "users.db: not written" in reply.json()["detail"]
    assert browser("POST", "/api/access/logout").status_code == 200
    assert browser("GET", "/look").status_code == 401
