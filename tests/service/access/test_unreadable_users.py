"""A users' database that is damaged before or while the service runs: nobody signs in, everything else continues."""

from __future__ import annotations

import os
import shutil

import pytest

from beltscape.service.access import database
from beltscape.service.access.guard import UNREADABLE_USERS
from tests.service.access.sample_app import PASSWORD, Browser, make_application


@pytest.fixture(autouse=True)
def _checked_at_once(monkeypatch):
    monkeypatch.setattr(database, "_CHECK_S", 0.0)


def damage(folder, how: str = "noise") -> None:
    path = folder / "users.db"
    data = path.read_bytes()
    for name in ("users.db-wal", "users.db-shm"):
        (folder / name).unlink(missing_ok=True)
    if how == "noise":
        data = os.urandom(20_000)
    elif how == "text":
        data = b"this is no database, but long enough to look at" * 30
    elif how == "middle":
        data = data[:4096] + os.urandom(len(data) - 4096)
    elif how == "cut":
        data = data[: len(data) // 2]
    path.unlink()
    path.write_bytes(data)


@pytest.fixture
def users(make, tmp_path):
    """A closed database with an engineer."""
    access = make()
    access.accounts.add("anna", "engineer", PASSWORD)
    access.close()
    shutil.copy(tmp_path / "users.db", tmp_path / "users.backup")
    return tmp_path


@pytest.mark.parametrize("how", ["noise", "text", "middle", "cut"])
def test_a_database_damaged_before_the_start_refuses_sign_in_only(make, users, how):
    damage(users, how)
    access = make()
    assert "users.db" in access.trouble and "restore it from a backup" in access.trouble
    assert "\n" not in access.trouble
    browser = Browser(make_application(access))
    reply = browser.log_in("anna")
    assert (reply.status_code, reply.json()) == (503, {"detail": UNREADABLE_USERS})
    assert access.setup_token is None  # nobody may become the first engineer of a plant that has users
    assert browser(
        "POST", "/api/access/setup", json={"token": "a", "name": "eve", "password": PASSWORD}
    ).status_code in (409, 503)
    assert browser("GET", "/login").status_code == 200
    assert browser("GET", "/api/access/state").json()["user"] is None
    assert browser("GET", "/look").status_code == 401


def test_damage_while_it_runs_is_noticed_without_a_request(make, users):
    access = make()
    assert access.trouble == ""
    damage(users)
    assert "nobody can sign in" in access.trouble


def test_open_sessions_are_refused_and_a_restored_file_is_used_at_once(make, users):
    access = make()
    browser = Browser(make_application(access))
    assert browser.log_in("anna").status_code == 200
    damage(users)
    reply = browser("GET", "/look")
    assert (reply.status_code, reply.json()) == (503, {"detail": UNREADABLE_USERS})
    assert browser("GET", "/login").status_code == 200
    key = browser("GET", "/look", headers={"authorization": "Bearer abc"})
    assert key.status_code == 503
    (users / "users.db").unlink()
    shutil.copy(users / "users.backup", users / "users.db")
    assert access.trouble == ""
    assert browser.log_in("anna").status_code == 200
    assert browser("GET", "/look").json()["name"] == "anna"


def test_a_wall_display_goes_on(make, users):
    damage(users)
    browser = Browser(make_application(make(anonymous_role="viewer")))
    assert browser("GET", "/look").json() == {"name": "anonymous", "role": "viewer"}


def test_the_setup_token_is_logged_when_the_database_was_removed(make, users, caplog):
    access = make()
    make_application(access)
    assert "setup token" not in caplog.text
    (users / "users.db").unlink()
    for name in ("users.db-wal", "users.db-shm"):
        (users / name).unlink(missing_ok=True)
    token = access.setup_token
    assert token is not None and token in caplog.text
    _ = access.setup_token
    assert caplog.text.count(token) == 1
