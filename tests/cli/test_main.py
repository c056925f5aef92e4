"""The program as a whole: help, exit codes and errors."""

from __future__ import annotations

import subprocess
import sys

import pytest

import beltscape
from beltscape.cli.catalogue import COMMANDS, load_command
from beltscape.cli.main import main
from beltscape.core.errors import InputError


def test_module_runs_as_a_program():
    done = subprocess.run(
        [sys.executable, "-m", "beltscape", "--version"], capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == (f"beltscape {beltscape.__version__}\n", "")


@pytest.mark.parametrize("words", [["--help"], ["-h"], []])
def test_help_lists_every_command_with_its_description(capsys, words):
    try:
        code = main(words)
    except SystemExit as stop:
        code = stop.code
    assert code == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    for name, what in COMMANDS.items():
        assert f"{name:<12} {what}" in lines


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_and_an_example_of_its_arguments(capsys, name):
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert out.startswith(f"usage: beltscape {name} ")
    module = load_command(name)
    assert {"add_arguments", "run", "summary"} <= set(vars(module))


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("rig.json: no such file"), 2, "beltscape: rig.json: no such file\n"),
        (KeyboardInterrupt(), 130, "beltscape: interrupted\n"),
    ],
)
def test_error_gives_an_exit_code_and_a_line(monkeypatch, capsys, error, code, line):
    def fail(arguments, reporter):
        raise error

    monkeypatch.setattr("beltscape.cli.commands.check.run", fail)
    assert main(["check", "c", "--rig=r", "--board=b"]) == code
    assert capsys.readouterr() == ("", line)


def test_internal_error_has_its_own_exit_code(monkeypatch, capsys):
    def fail(arguments, reporter):
        raise ZeroDivisionError

    monkeypatch.setattr("beltscape.cli.commands.check.run", fail)
    assert main(["check", "c", "--rig=r", "--board=b"]) == 70
    assert "internal error" in capsys.readouterr().err
