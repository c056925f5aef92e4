"""Errors are one line and an exit code; an internal error names its origin on request."""

from __future__ import annotations

import json

import pytest

from beltscape.cli.commands import plan
from beltscape.cli.main import main


@pytest.fixture
def failing(monkeypatch):
    """A function: the command ``plan`` raises the error that it is given."""
    monkeypatch.delenv("BELTSCAPE_TRACEBACK", raising=False)

    def fail(error: BaseException) -> None:
        def run(*_: object) -> None:
            raise error

        monkeypatch.setattr(plan, "run", run)

    return fail


@pytest.mark.parametrize(
    ("error", "code", "kind", "message"),
    [
        (KeyError("cam7"), 70, "InternalError", "internal error, a fault of Beltscape (KeyError: 'cam7' in "),
        (ValueError("a\nb"), 70, "InternalError", "(ValueError: a b in "),
        (KeyboardInterrupt(), 130, "Interrupted", "interrupted"),
        (MemoryError(), 2, "MemoryError", "not enough memory"),
        (PermissionError(13, "Permission denied", "a.png"), 2, "PermissionError", "a.png: Permission denied"),
    ],
)
def test_errors_are_one_line_and_with_json_a_document(failing, capsys, error, code, kind, message):
    failing(error)
    assert main(["plan", "--json"]) == code
    out, err = capsys.readouterr()
    assert len(err.splitlines()) == 1
    assert message in err
    document = json.loads(out)["error"]
    assert (document["type"], document["exit_code"]) == (kind, code)
    assert err == f"beltscape: {document['message']}\n"


def test_internal_error_names_the_traceback_variable_and_prints_with_it(failing, capsys, monkeypatch):
    failing(KeyError("cam7"))
    assert main(["plan"]) == 70
    assert "set BELTSCAPE_TRACEBACK=1 to see where" in capsys.readouterr().err
    monkeypatch.setenv("BELTSCAPE_TRACEBACK", "1")
    assert main(["plan"]) == 70
    assert "Traceback (most recent call last)" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["--json"], ["plann", "--json"], ["plan", "--focal", "x", "--json"], ["measure", "--json"]]
)
def test_usage_error_is_a_document_too(capsys, words):
    assert main(words) == 2
    out, err = capsys.readouterr()
    error = json.loads(out)["error"]
    assert (error["type"], error["exit_code"]) == ("UsageError", 2)
    assert err == f"{error['message']}\n"


def test_help_and_version_still_end_with_0(capsys):
    for words in (["--version"], ["plan", "--help"]):
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert not stop.value.code
    assert main([]) == 0
    assert "usage: beltscape" in capsys.readouterr().out
