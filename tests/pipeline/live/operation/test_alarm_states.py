"""The file of the alarms' states: whole after every kill, and replaced where it is damaged."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from beltscape.alarms.snapshot import BoardSnapshot, SavedAlarm
from beltscape.pipeline.live.alarm_control import STATES_FILE, AlarmStateFile

SNAPSHOT = BoardSnapshot(
    (SavedAlarm("overload", "acknowledged", "critical", 5, "ada", 6, 112.0, 100.0, "%"),),
    {"load": "overload"},
)


@pytest.mark.parametrize(
    "data",
    [
        b"", b"[]", b"{", b"\xff\xfe", b"null", b'{"alarms": 3}', b"[" * 100_000,
        b'{"alarms": [{"name": "overload", "state": "clear", "severity": "info", "since_ns": 1}]}',
        b'{"alarms": [{"name": "overload", "state": "raised", "severity": "info", "since_ns": -1}]}',
        b'{"alarms": [{"name": "overload", "state": "raised", "severity": "info", "since_ns": 1e30}]}',
        b'{"alarms": [{"name": "overload", "state": "raised", "severity": "info", "since_ns": 1, "value": 1e999}]}',
    ],
)  # fmt: skip
def test_a_damaged_file_is_named_and_replaced(tmp_path: Path, data: bytes) -> None:
    (tmp_path / STATES_FILE).write_bytes(data)
    messages: list[str] = []
    states = AlarmStateFile(tmp_path, messages.append)
    assert states.read() == BoardSnapshot()
    (message,) = messages
    assert STATES_FILE in message and "\n" not in message
    states.write(BoardSnapshot())
    assert AlarmStateFile(tmp_path, messages.append).read() == BoardSnapshot() and len(messages) == 1


def test_every_cut_of_a_file_is_refused_or_empty(tmp_path: Path) -> None:
    AlarmStateFile(tmp_path).write(SNAPSHOT)
    whole = (tmp_path / STATES_FILE).read_bytes()
    for length in range(len(whole)):
        (tmp_path / STATES_FILE).write_bytes(whole[:length])
        messages: list[str] = []
        assert AlarmStateFile(tmp_path, messages.append).read() == BoardSnapshot() and messages, length


def test_a_disk_that_refuses_is_said_once_and_tried_again(tmp_path: Path) -> None:
    messages: list[str] = []
    states = AlarmStateFile(tmp_path / "data", messages.append)
    states.write(SNAPSHOT)
    states.write(SNAPSHOT)
    assert len(messages) == 1 and "lose acknowledgements" in messages[0]
    (tmp_path / "data").mkdir()
    states.write(SNAPSHOT)
    assert AlarmStateFile(tmp_path / "data").read() == SNAPSHOT


def test_only_what_a_restart_must_not_lose_is_written(tmp_path: Path) -> None:
    states = AlarmStateFile(tmp_path)
    states.write(SNAPSHOT)
    written = (tmp_path / STATES_FILE).stat().st_ino
    states.write(
        BoardSnapshot(
            (SavedAlarm("overload", "acknowledged", "critical", 5, "ada", 6, 130.0, 100.0, "%"),),
            {"load": "overload"},
        )
    )
    assert (tmp_path / STATES_FILE).stat().st_ino == written
    states.write(BoardSnapshot())
    assert (tmp_path / STATES_FILE).stat().st_ino != written


@pytest.mark.thorough
def test_no_acknowledgement_is_lost_by_a_kill(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.pipeline.live.operation.killed_operator", str(tmp_path), "12"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 12  # each kill comes after an acknowledgement
