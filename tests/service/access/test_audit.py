"""The audit log: complete, bounded, and safe against forged entries."""

from __future__ import annotations

import json
import stat
import threading

from hypothesis import given
from hypothesis import strategies as st

from beltscape.service.access.audit import Audit


def read_entries(audit: Audit) -> list[dict]:
    return [json.loads(line) for line in audit.path.read_bytes().splitlines()]


@given(st.text(), st.text(), st.text(max_size=500))
def test_values_cannot_fake_an_entry(tmp_path_factory, what, who, value):
    audit = Audit(tmp_path_factory.mktemp("audit"), 10**6, 2)
    audit.write(what, who, "::1", {"value": value})
    audit.write("end", "anna")
    raw = audit.path.read_bytes()
    assert raw.count(b"\n") == 2
    assert all(b == 10 or 32 <= b < 127 for b in raw)
    first, last = read_entries(audit)
    assert (first["what"], first["who"], first["value"]) == (what, who[:300], value[:300])
    assert last["what"] == "end"


def test_log_is_rotated_and_bounded(tmp_path):
    ticks = iter(range(10**6))
    audit = Audit(tmp_path, 1000, 3, lambda: 1.8e9 + next(ticks))
    for i in range(90):
        audit.write("login", f"user{i}")
    aside = sorted(tmp_path.glob("audit-*.jsonl"))
    assert len(aside) == 3
    assert all(1000 <= file.stat().st_size < 1200 for file in aside)
    kept = [
        json.loads(line)["who"] for file in [*aside, audit.path] for line in file.read_text().splitlines()
    ]
    assert kept == [f"user{i}" for i in range(90 - len(kept), 90)], "the newest, in order, none twice"


def test_a_torn_line_does_not_join_the_next_entry(tmp_path):
    audit = Audit(tmp_path, 10**6, 2)
    audit.write("login", "anna")
    with audit.path.open("ab") as file:
        file.write(b'{"at": "2026-')
    audit.write("logout", "anna")
    assert [e["what"] for e in audit.read_last(10)] == ["logout", "login"]


def test_entries_are_returned_newest_first_up_to_the_count(tmp_path):
    audit = Audit(tmp_path, 10**6, 2)
    assert audit.read_last(5) == []
    for i in range(20):
        audit.write("login", f"user{i}", detail={"n": i})
    assert [e["n"] for e in audit.read_last(3)] == [19, 18, 17]


def test_threads_write_whole_lines(tmp_path):
    audit = Audit(tmp_path, 3000, 100)
    threads = [
        threading.Thread(target=lambda n=n: [audit.write("login", f"{n}-{i}") for i in range(25)])
        for n in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    lines = [line for file in tmp_path.iterdir() for line in file.read_text().splitlines()]
    assert len({json.loads(line)["who"] for line in lines}) == len(lines) == 100


def test_log_is_readable_by_its_owner_only(tmp_path):
    audit = Audit(tmp_path, 10**6, 2)
    audit.write("login", "anna")
    assert stat.S_IMODE(audit.path.stat().st_mode) == 0o600


def test_lost_entries_are_counted(tmp_path):
    audit = Audit(tmp_path / "gone", 10**6, 2)
    audit.write("login", "anna")
    assert audit.lost_entries == 1
