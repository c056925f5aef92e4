"""Sessions: life, end, storage."""

from __future__ import annotations

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import OutputError
from beltscape.service.access.accounts import User
from beltscape.service.access.database import Database
from beltscape.service.access.sessions import IN_MEMORY_LIFE_S, MAX_PER_USER, Sessions, derive_page_token
from tests.thorough import examples

IDLE_S, LIFE_S = 3600.0, 10_000.0
ANNA = User("anna", "engineer")


class Clock:
    """A system clock that can be set."""

    now = 1_800_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def database(tmp_path):
    database = Database(tmp_path)
    with database.transaction() as connection:
        connection.execute("INSERT INTO users VALUES ('anna', 'engineer', 'x', 0, 0)")
    yield database
    database.close()


@pytest.fixture
def sessions(database, clock):
    return Sessions(database, IDLE_S, LIFE_S, clock)


def test_a_session_survives_a_restart(sessions, database, clock):
    token = sessions.open(ANNA, "::1")
    assert len(token) >= 43
    assert Sessions(database, IDLE_S, LIFE_S, clock).find(token) == ANNA


def test_tokens_are_stored_as_hashes(sessions, database):
    token = sessions.open(ANNA, "::1")
    ((kept,),) = database.select("SELECT token FROM sessions")
    assert kept == hashlib.sha256(token.encode()).hexdigest()
    assert sessions.find(kept) is None


def test_an_unused_session_ends(sessions, clock):
    token = sessions.open(ANNA, "")
    clock.now += IDLE_S - 1
    assert sessions.find(token) == ANNA
    clock.now += IDLE_S - 1
    assert sessions.find(token, touch=False) == ANNA
    clock.now += 2
    assert sessions.find(token) is None
    clock.now -= 10
    assert sessions.find(token) is None, "ended for ever"


def test_a_used_session_ends_after_its_life(sessions, clock):
    token = sessions.open(ANNA, "")
    for _ in range(int(LIFE_S / 1000)):
        assert sessions.find(token) == ANNA
        clock.now += 1000
    assert sessions.find(token) is None


@given(st.lists(st.floats(-50_000, 50_000), max_size=8))
@examples(20)
def test_no_step_of_the_clock_prolongs_a_session(tmp_path_factory, steps):
    """A session older than its life by the current clock has ended."""
    clock = Clock()
    database = Database(tmp_path_factory.mktemp("steps"))
    with database.transaction() as connection:
        connection.execute("INSERT INTO users VALUES ('anna', 'engineer', 'x', 0, 0)")
    sessions = Sessions(database, IDLE_S, LIFE_S, clock)
    token, born = sessions.open(ANNA, ""), clock.now
    for step in steps:
        clock.now += step
        if sessions.find(token):
            assert -300 <= int(clock.now) - int(born) < LIFE_S
    database.close()


def test_logging_out_ends_a_session(sessions):
    token, other = sessions.open(ANNA, ""), sessions.open(ANNA, "")
    sessions.close(token)
    assert (sessions.find(token), sessions.find(other)) == (None, ANNA)


def test_a_removed_user_has_no_session(sessions, database):
    token = sessions.open(ANNA, "")
    with database.transaction() as connection:
        connection.execute("DELETE FROM users")
    assert sessions.find(token) is None
    assert database.select("SELECT count(*) FROM sessions") == [(0,)]


def test_a_role_changes_at_once(sessions, database):
    token = sessions.open(ANNA, "")
    with database.transaction() as connection:
        connection.execute("UPDATE users SET role = 'viewer'")
    assert sessions.find(token) == User("anna", "viewer")


def test_sessions_per_user_are_bounded(sessions, database, clock):
    first = last = sessions.open(ANNA, "")
    for _ in range(MAX_PER_USER):
        clock.now += 1
        last = sessions.open(ANNA, "")
    assert database.select("SELECT count(*) FROM sessions") == [(MAX_PER_USER,)]
    assert (sessions.find(first), sessions.find(last)) == (None, ANNA)


def test_login_and_logout_work_on_a_full_disk(sessions, database, clock):
    token = sessions.open(ANNA, "")
    database.select("PRAGMA max_page_count = 1")
    database.select("PRAGMA query_only = 1")
    with pytest.raises(OutputError, match=r"users\.db: not written"):
        sessions.open(ANNA, "")
    unkept = sessions.open_in_memory(ANNA)
    assert sessions.find(unkept) == ANNA
    clock.now += 100
    assert sessions.find(token) == ANNA
    sessions.close(token)
    assert sessions.find(token) is None
    clock.now += IN_MEMORY_LIFE_S
    assert sessions.find(unkept) is None
    other = sessions.open_in_memory(ANNA)
    sessions.close(other)
    assert sessions.find(other) is None


@given(st.text(max_size=80))
def test_page_tokens_differ(text):
    assert derive_page_token(text) != derive_page_token(text + "x")
    assert len(derive_page_token(text.encode("utf-8", "replace").decode())) == 64
