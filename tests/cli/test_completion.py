"""Completion in a shell: the code that is printed, and the answers that it gets."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from beltscape.cli.catalogue import COMMANDS

PROGRAM = Path(sys.executable).with_name("beltscape")


def complete(line: str, tmp_path: Path) -> list[str]:
    answer = tmp_path / "answer"
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer)}
    environment = {**os.environ, **asked, "COMP_LINE": line, "COMP_POINT": str(len(line))}
    subprocess.run([PROGRAM], env=environment, check=True, cwd=tmp_path)
    return answer.read_text().split()


def test_commands_and_options(tmp_path):
    assert set(complete("beltscape ", tmp_path)) >= set(COMMANDS)
    assert complete("beltscape recon", tmp_path) == ["reconstruct"]
    assert "--preset" in complete("beltscape reconstruct x --pre", tmp_path)
    assert "volume" in complete("beltscape measure vol", tmp_path)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_code_names_the_program_and_is_valid(shell):
    done = subprocess.run([PROGRAM, "completion", shell], capture_output=True, text=True, check=True)
    assert "beltscape" in done.stdout
    if shell == "bash" and shutil.which("bash"):
        subprocess.run(["bash", "-n"], input=done.stdout, text=True, check=True)


def test_an_unknown_shell_is_refused():
    done = subprocess.run([PROGRAM, "completion", "cmd"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "bash" in done.stderr
