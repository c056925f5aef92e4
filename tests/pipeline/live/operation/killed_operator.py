"""Forks programs whose alarms are acknowledged, and kills them; run by test_alarm_states.py with ``python -m``.

After every kill the file must be whole, and what was acknowledged must still be, by the same user.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from beltscape.alarms.board import AlarmBoard
from beltscape.core.alarms import Alarm
from beltscape.pipeline.live.alarm_control import AlarmControl, AlarmStateFile
from beltscape.pipeline.live.hidden_alarms import HiddenAlarms
from tests.alarms.plant import GOOD, SETTINGS, camera
from tests.pipeline.live.feed import Watcher

CAMERAS = tuple(f"cam{k}" for k in range(100))
LOST = replace(GOOD, cameras={name: camera(name, state="lost", message="silent") for name in CAMERAS})


class NoJournal:
    """Stands for the journal, whose kills have a test of their own."""

    def add(self, *_: object, **__: object) -> None: ...

    def add_alarm(self, *_: object) -> None: ...


def open_control(folder: Path) -> tuple[AlarmControl, AlarmBoard]:
    """Return a control that continues the states in ``folder``; AssertionError where they are damaged."""

    def fail(message: str) -> None:
        raise AssertionError(message)

    board, journal = (
        AlarmBoard(
            SETTINGS.model_copy(
                update={"cameras_off": SETTINGS.cameras_off.model_copy(update={"enabled": False})}
            )
        ),
        NoJournal(),
    )
    states, keep_no_frames = AlarmStateFile(folder, fail), lambda _: None
    events: Any = journal
    control = AlarmControl(board, HiddenAlarms(folder), events, Watcher(), keep_no_frames, states, CAMERAS)
    control.start()
    return control, board


def acknowledge_until_killed(folder: Path, pipe: int) -> None:
    """Acknowledge one alarm after the other, each by a user of its own number, and report the number."""
    control, board = open_control(folder)
    control.update(LOST)
    raised = [number for number in range(len(CAMERAS)) if get(board, number).state == "raised"]
    for number in raised:
        if control.acknowledge(f"camera_lost:cam{number}", f"user{number}"):
            os.write(pipe, number.to_bytes(2, "little"))
    time.sleep(60)  # until the kill


def get(board: AlarmBoard, number: int) -> Alarm:
    alarm = board.get(f"camera_lost:cam{number}")
    assert alarm is not None, number
    return alarm


def kill_once(folder: Path, after_s: float) -> list[int]:
    """Return the numbers that a program acknowledged before it was killed."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            acknowledge_until_killed(folder, writing)
        finally:
            os._exit(1)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        received = os.read(reading, 2)
        time.sleep(after_s)
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        assert os.WIFSIGNALED(status), "a program ended by itself"
        received += pipe.read()
    return [int.from_bytes(received[k : k + 2], "little") for k in range(0, len(received), 2)]


def main(folder: Path, kills: int) -> None:
    """Kill, then read the states of everything that was acknowledged so far."""
    rng, acknowledged = random.Random(27), list[int]()
    for _ in range(kills):
        acknowledged += kill_once(folder, rng.uniform(0, 0.02))
        _, board = open_control(folder)
        for number in acknowledged:
            alarm = get(board, number)
            assert (alarm.state, alarm.by) == ("acknowledged", f"user{number}"), alarm
        assert len(set(acknowledged)) == len(acknowledged), "one was acknowledged twice"
    print(len(acknowledged))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
