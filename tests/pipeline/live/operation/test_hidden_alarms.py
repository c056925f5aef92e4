"""Hidden alarms: those that people have hidden, which end by themselves and survive a restart."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.pipeline.live.hidden_alarms import FILE, HiddenAlarms

S_NS = 1_000_000_000


class Clocks:
    """A monotonic clock and a system clock."""

    def __init__(self) -> None:
        self.steady_s, self.wall_ns = 100.0, 1_000 * S_NS

    def pass_s(self, seconds: float) -> None:
        self.steady_s += seconds
        self.wall_ns += round(seconds * S_NS)


def open_hidden(folder: Path | None, clocks: Clocks) -> HiddenAlarms:
    return HiddenAlarms(folder, lambda: clocks.steady_s, lambda: clocks.wall_ns)


def test_shelving_ends_by_itself_and_out_of_service_does_not() -> None:
    clocks = Clocks()
    hidden = open_hidden(None, clocks)
    hidden.shelve("overload", "scale test", 30, "ada")
    hidden.take_out_of_service("camera_lost:cam2", "sent for repair", "eve")
    clocks.pass_s(30 * 60 - 1)
    assert hidden.remove_ended() == {} and set(hidden.hidden) == {"overload", "camera_lost:cam2"}
    clocks.pass_s(1)
    (ended,) = hidden.remove_ended().items()
    assert (ended[0], ended[1].by, ended[1].reason) == ("overload", "ada", "scale test")
    clocks.pass_s(1e6)
    assert hidden.remove_ended() == {} and list(hidden.hidden) == ["camera_lost:cam2"]
    assert hidden.remove("camera_lost:cam2") is not None and hidden.remove("camera_lost:cam2") is None


@given(st.floats(1, 480), st.floats(0, 500), st.floats(0, 500))
def test_a_restart_changes_no_end(
    tmp_path_factory, minutes: float, before_min: float, away_min: float
) -> None:
    folder, clocks = tmp_path_factory.mktemp("data"), Clocks()
    hidden = open_hidden(folder, clocks)
    hidden.shelve("overload", "test", minutes, "ada")
    clocks.pass_s(before_min * 60)
    hidden.remove_ended()
    clocks.pass_s(away_min * 60)
    clocks.steady_s = 5.0  # the computer was started anew
    again = open_hidden(folder, clocks)
    again.remove_ended()
    assert ("overload" in again.hidden) == (before_min + away_min < round(minutes * 60) / 60)


def test_a_clock_that_was_set_back_does_not_lengthen_it(tmp_path: Path) -> None:
    clocks = Clocks()
    open_hidden(tmp_path, clocks).shelve("overload", "test", 30, "ada")
    clocks.wall_ns -= 10**6 * S_NS
    again = open_hidden(tmp_path, clocks)
    clocks.pass_s(30 * 60)
    assert "overload" in again.remove_ended()


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"overload": 3}', '{"overload": {"kind": "by_state", "reason": "x"}}',
     '{"overload": {"kind": "shelved", "reason": "x", "by": "a", "since_ns": 1, "until_ns": null}}',
     json.dumps({"overload": {"kind": "shelved", "reason": ["x"], "by": "a", "since_ns": 1, "until_ns": 2}})],
)  # fmt: skip
def test_a_damaged_file_hides_nothing_and_says_so(tmp_path: Path, text: str) -> None:
    (tmp_path / FILE).write_text(text)
    messages: list[str] = []
    assert HiddenAlarms(tmp_path, on_message=messages.append).hidden == {}
    assert (
        len(messages) == 1 and FILE in messages[0] and "moved to" in messages[0] and "\n" not in messages[0]
    )


def test_a_disk_that_cannot_be_written_is_not_fatal(tmp_path: Path) -> None:
    messages: list[str] = []
    hidden = HiddenAlarms(tmp_path / "missing", on_message=messages.append)
    hidden.shelve("overload", "test", 30, "ada")
    assert "overload" in hidden.hidden and "a restart would show hidden alarms" in messages[0]
