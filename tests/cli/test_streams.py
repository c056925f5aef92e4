"""Standard output and standard error of every command: other encodings, full disks, closed pipes, no folder."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from beltscape.cli.catalogue import COMMANDS, EXAMPLES, load_command
from beltscape.cli.main import main
from beltscape.core.errors import InputError

LINES = [one.split("   ")[0].split(" > ")[0].split() for examples in EXAMPLES.values() for one in examples]
"""A command line of every command, and of every quantity and kind of target."""
TEXT = "13.2 ± 0.1 l, σ ≤ 3 µm × 2 → 5 m³ 😀 ä 皮带 caf\udce9"
"""What the program prints, and what names of cameras and files may have."""
FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="only Linux has /dev/full")


@pytest.fixture
def answering(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every command answer the text at once, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    for name in COMMANDS:
        command = load_command(name)
        monkeypatch.setattr(
            command, "run", lambda _arguments, reporter: reporter.warn(TEXT) or {"text": TEXT}
        )
        monkeypatch.setattr(command, "summary", lambda result: result["text"])


@pytest.fixture
def stream() -> Iterator[Callable[[str, str], io.TextIOWrapper]]:
    """A function that opens a file as a stream of that encoding, with Python's own handling of errors."""
    opened: list[io.TextIOWrapper] = []

    def open_stream(path: str, encoding: str = "utf-8") -> io.TextIOWrapper:
        opened.append(io.TextIOWrapper(open(path, "wb"), encoding=encoding, errors="strict"))  # noqa: PTH123, SIM115
        return opened[-1]

    yield open_stream
    for one in opened:
        one.close()


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "latin-1", "shift_jis", "utf-8"])
@pytest.mark.usefixtures("answering")
def test_every_command_prints_in_every_encoding(
    monkeypatch: pytest.MonkeyPatch, stream: Any, encoding: str
) -> None:
    for k, words in enumerate(LINES):
        for more in ([], ["--json"]):
            monkeypatch.setattr(sys, "stdout", stream(f"out{k}", encoding))
            monkeypatch.setattr(sys, "stderr", stream(f"err{k}", encoding))
            assert main([*words, *more]) == 0
            sys.stderr.flush()
            text = Path(f"out{k}").read_bytes().decode(encoding)
            if more:
                assert json.loads(text)["text"] == TEXT
            else:
                assert text.startswith("13.2 ")
            assert Path(f"err{k}").read_bytes().decode(encoding).startswith("warning: 13.2 ")


def test_what_an_encoding_lacks_is_spelled(
    monkeypatch: pytest.MonkeyPatch, stream: Any, tmp_path: Path
) -> None:
    for encoding, expected in (
        ("ascii", r"13.2 +/- 0.1 l, sigma <= 3 um x 2 -> 5 m3 \U0001f600 a \u76ae\u5e26 caf\udce9"),
        ("cp1252", r"13.2 ± 0.1 l, sigma <= 3 µm × 2 -> 5 m³ \U0001f600 ä \u76ae\u5e26 caf\udce9"),
        ("utf-8", r"13.2 ± 0.1 l, σ ≤ 3 µm × 2 → 5 m³ 😀 ä 皮带 caf\udce9"),
    ):
        monkeypatch.setattr(sys, "stdout", stream(str(tmp_path / encoding), encoding))
        plan = load_command("plan")
        monkeypatch.setattr(plan, "run", lambda *_: {})
        monkeypatch.setattr(plan, "summary", lambda _: TEXT)
        assert main(["plan"]) == 0
        assert (tmp_path / encoding).read_bytes().decode(encoding).strip() == expected


@needs_full
@pytest.mark.usefixtures("answering")
@pytest.mark.parametrize("more", [[], ["--json"], ["--help"]], ids=["text", "json", "help"])
def test_a_full_disk_behind_standard_output_is_one_line(
    monkeypatch: pytest.MonkeyPatch, stream: Any, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    for words in LINES:
        monkeypatch.setattr(sys, "stdout", stream(str(FULL)))
        assert main([*words, *more]) == 2
        line = capsys.readouterr().err.splitlines()[-1]
        assert line.startswith("beltscape: standard output: cannot be written (No space left on device); ")
        sys.stdout.flush()  # as the interpreter does at its end: nothing is left that fails


@needs_full
@pytest.mark.usefixtures("answering")
def test_standard_error_that_cannot_be_written_changes_no_result(
    monkeypatch: pytest.MonkeyPatch, stream: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in LINES:
        monkeypatch.setattr(sys, "stderr", stream(str(FULL)))
        assert main([*words, "--json"]) == 0
        sys.stderr.flush()
        assert json.loads(capsys.readouterr().out)["text"] == TEXT


@needs_full
def test_an_error_has_its_code_where_nothing_can_be_written(
    monkeypatch: pytest.MonkeyPatch, stream: Any
) -> None:
    def fail(*_: object) -> None:
        raise InputError("rig.json: no such file")

    monkeypatch.setattr(load_command("plan"), "run", fail)
    for words in (["plan"], ["plan", "--json"], ["plan", "--widht"], ["nonsense"]):
        for name in ("stdout", "stderr"):
            monkeypatch.setattr(sys, name, stream(str(FULL)))
        assert main(words) == 2


@pytest.mark.usefixtures("answering")
def test_a_reader_that_has_left_is_no_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in LINES:
        reads, writes = os.pipe()
        os.close(reads)
        with open(writes, "w", encoding="utf-8") as pipe:  # noqa: PTH123
            monkeypatch.setattr(sys, "stdout", pipe)
            assert main(words) == 0
        assert capsys.readouterr().err == f"warning: {TEXT}\n".encode("utf-8", "backslashreplace").decode()


def test_streams_that_the_caller_has_closed_take_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load_command("plan"), "run", lambda *_: {})
    monkeypatch.setattr(load_command("plan"), "summary", lambda _: TEXT)
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    assert main(["plan"]) == 0
    assert main(["plan", "--widht"]) == 2
    for one in (sys.stdout, sys.stderr):
        one.close()


@pytest.mark.usefixtures("answering")
def test_a_working_folder_that_was_removed_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in LINES:
        folder = tmp_path / "gone"
        folder.mkdir()
        monkeypatch.chdir(folder)
        folder.rmdir()
        assert main(words) == 2
        line = capsys.readouterr().err
        assert line.startswith("beltscape: the working folder cannot be used (No such file or directory)")
        assert line.count("\n") == 1
    monkeypatch.chdir(tmp_path)


HELP, JSON = ["plan", "--help"], ["doctor", "--json"]


@pytest.mark.parametrize(
    ("words", "redirected", "code"),
    [
        pytest.param(JSON, "> /dev/full", 2, marks=needs_full),
        pytest.param(HELP, "> /dev/full", 2, marks=needs_full),
        pytest.param(HELP, "> /dev/full 2> /dev/full", 2, marks=needs_full),
        pytest.param(HELP, "2> /dev/full | cat > /dev/null; exit ${PIPESTATUS[0]}", 0, marks=needs_full),
        (HELP, "| true; exit ${PIPESTATUS[0]}", 0),
        (JSON, ">&-", 0),
        (HELP, ">&-", 0),
    ],
)
def test_the_program_itself_ends_with_its_code_and_without_a_traceback(
    words: list[str], redirected: str, code: int
) -> None:
    command = f"{sys.executable} -m beltscape {' '.join(words)} {redirected}"
    done = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONIOENCODING": "cp1252"},
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr
