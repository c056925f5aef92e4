"""The terminal's reporter: warnings, progress bars and errors."""

from __future__ import annotations

import io
import sys

import pytest

from beltscape.cli.terminal import Terminal


class Tty(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_warning_is_printed_once(capsys):
    with Terminal() as terminal:
        for _ in range(3):
            terminal.warn("cam1: no image")
        terminal.warn("cam2: no image")
    assert capsys.readouterr() == ("", "warning: cam1: no image\nwarning: cam2: no image\n")
    assert terminal.warnings == ["cam1: no image", "cam2: no image"]


def test_finished_stage_is_one_line_without_a_terminal(capsys):
    with Terminal() as terminal:
        for done in range(4):
            terminal.step("finding the board", done, 3)
    assert capsys.readouterr() == ("", "finding the board: 3 done\n")


def test_on_a_terminal_bars_and_warnings_share_standard_error(monkeypatch, capsys):
    screen = Tty()
    monkeypatch.setattr(sys, "stderr", screen)
    with Terminal() as terminal:
        terminal.step("finding the board", 1, 2)
        terminal.warn("cam1: [bold]not markup[/bold]")
        terminal.warn("cam1: [bold]not markup[/bold]")
        terminal.step("finding the board", 2, 2)
    text = screen.getvalue()
    assert text.count("warning: cam1: [bold]not markup[/bold]") == 1
    assert "finding the board" in text
    assert "2/2" in text
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("tty", [False, True])
def test_error_passes_through_the_terminal(monkeypatch, tty):
    monkeypatch.setattr(sys, "stderr", Tty() if tty else io.StringIO())
    with pytest.raises(ValueError, match="broke"), Terminal() as terminal:
        terminal.step("finding the board", 1, 2)
        raise ValueError("broke")
