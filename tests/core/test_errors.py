"""The tree of exceptions."""

from __future__ import annotations

import inspect

from beltscape.core import errors

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
