"""The tree of exceptions."""

from __future__ import annotations

import inspect

import pytest

from beltscape.core import errors
from beltscape.core.errors import describe_cause, suggest_name

TREE = {
    "InputError", "OutputError", "CalibrationError", "ReconstructionError", "MeasureError", "SettingsError",
    "KernelError", "ArgumentError",
}  # fmt: skip


def test_exceptions_match_the_tree_in_the_docstring():
    classes = {name for name, kind in vars(errors).items() if inspect.isclass(kind)} - {"BeltscapeError"}
    assert classes == TREE
    lines = [line.replace("│   ", "") for line in (errors.__doc__ or "").splitlines()]
    drawn = {line.split()[1] for line in lines if line and line[:1] in "├└"}
    assert drawn == TREE


def test_one_except_catches_all_that_is_raised_on_purpose():
    assert all(issubclass(getattr(errors, name), errors.BeltscapeError) for name in TREE)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ValueError("could not convert string to float: '1,5'"), "a part of it has another form"),
        (ValueError("invalid literal for int() with base 10: 'x'"), "a part of it has another form"),
        (
            ValueError("Object arrays cannot be loaded when allow_pickle=False"),
            "a part of it has another form",
        ),
        (TypeError("'NoneType' object is not subscriptable"), "a part of it has another form"),
        (IndexError("list index out of range"), "a part of it has another form"),
        (KeyError("cam0"), "cam0 is missing"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"), "not UTF-8 text"),
        (FileNotFoundError(2, "No such file or directory", "a.txt"), "No such file or directory"),
        (ValueError("units = 'm': only\n \"mm\" is known"), "units = 'm': only \"mm\" is known"),
    ],
)
def test_a_cause_is_told_without_pythons_words(error, words):
    assert describe_cause(error) == words


@pytest.mark.parametrize(
    ("name", "suggestion"),
    [("lod_mm", "load_mm"), ("prt", "port"), ("folder", ""), ("recordings", "recording"), ("colour", "")],
)
def test_only_a_name_that_is_really_near_is_suggested(name, suggestion):
    known = ("encoder", "load_mm", "port", "recording", "cameras", "core")
    assert suggest_name(name, known) == (f"did you mean {suggestion}?" if suggestion else "")
