"""User accounts: names, roles and protected changes."""

from __future__ import annotations

import sqlite3
import stat

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.service.access.accounts import MAX_NAME_LENGTH, ROLES, User, normalise_name, validate_name
from beltscape.service.access.database import Database, UsersUnreadableError

PASSWORD = "coal on the belt"


def test_users_survive_a_restart(make):
    make().accounts.add("Anna", "engineer", PASSWORD)
    again = make().accounts
    assert again.check("ANNA", PASSWORD) == User("anna", "engineer")
    assert again.check("anna", "coal on the bel") is None
    assert again.check("bert", PASSWORD) is None


def test_names_match_in_every_spelling(make):
    accounts = make().accounts
    accounts.add("Jürgen", "engineer", PASSWORD)
    with pytest.raises(InputError, match="exists already"):
        accounts.add("ju\u0308rgen", "viewer", PASSWORD)
    accounts.add("王伟", "operator", PASSWORD)
    assert [a.name for a in accounts.list()] == ["jürgen", "王伟"]


def test_the_last_engineer_cannot_be_removed(access):
    with pytest.raises(InputError, match="last engineer"):
        access.accounts.remove("the-engineer")
    with pytest.raises(InputError, match="last engineer"):
        access.accounts.set_role("the-engineer", "operator")
    access.accounts.set_role("the-operator", "engineer")
    access.accounts.remove("the-engineer")
    assert {a.name: a.role for a in access.accounts.list()} == {
        "the-operator": "engineer",
        "the-viewer": "viewer",
    }


def test_setup_stays_closed_after_the_first_user(make):
    accounts = make().accounts
    assert accounts.is_setup_open
    accounts.add("anna", "engineer", PASSWORD, first=True)
    assert not accounts.is_setup_open
    with pytest.raises(InputError, match="setup is over"):
        accounts.add("eve", "engineer", PASSWORD, first=True)
    assert not make().accounts.is_setup_open


def test_refused_changes_leave_no_trace(make):
    accounts = make().accounts
    for name, role, password in [("", "viewer", PASSWORD), ("a", "boss", PASSWORD), ("a", "viewer", "short")]:
        with pytest.raises(InputError):
            accounts.add(name, role, password)
    assert accounts.list() == ()
    assert accounts.is_setup_open
    for call in (accounts.remove, lambda n: accounts.set_role(n, "viewer")):
        with pytest.raises(InputError, match="there is none"):
            call("nobody")


@given(st.text(max_size=50))
def test_accepted_names_are_plain(name):
    try:
        kept = validate_name(name)
    except InputError as error:
        assert "\n" not in str(error)
        return
    assert 1 <= len(kept) <= MAX_NAME_LENGTH
    assert kept.isprintable()
    assert kept == normalise_name(kept) == validate_name(kept)
    assert not set(kept) & set("/\\ <>&\"'%")


@pytest.mark.parametrize(
    "name", ["anonymous", "Anonymous", "..", ".", "-rf", "a b", "a/b", "x" * 33, "a\x00", "\ud800"]
)
def test_unusable_names_are_refused(name):
    with pytest.raises(InputError):
        validate_name(name)


def test_database_is_readable_by_its_owner_only(make, tmp_path):
    make().accounts.add("anna", "engineer", PASSWORD)
    for file in tmp_path.glob("users.db*"):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert PASSWORD.encode() not in b"".join(f.read_bytes() for f in tmp_path.glob("users.db*"))


def test_a_file_that_is_no_database_is_refused(tmp_path):
    (tmp_path / "users.db").write_bytes(b"this is no database, but long enough to look at" * 30)
    database = Database(tmp_path)
    with pytest.raises(UsersUnreadableError, match=r"users\.db: no user database .* restore it"):
        database.select("SELECT 1")


def test_roles_include_those_before_them():
    for i, own in enumerate(ROLES):
        assert [User("a", own).has_role(role) for role in ROLES] == [j <= i for j in range(3)]


def test_changes_of_other_processes_take_effect(make, tmp_path):
    accounts = make().accounts
    accounts.add("anna", "engineer", PASSWORD)
    other = sqlite3.connect(tmp_path / "users.db")
    other.execute("UPDATE users SET role = 'viewer'")
    other.commit()
    other.close()
    assert accounts.check("anna", PASSWORD) == User("anna", "viewer")
