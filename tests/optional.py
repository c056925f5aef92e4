"""Access to optional values that must be present in a test."""

from __future__ import annotations

from typing import TypeVar

Value = TypeVar("Value")


def require(value: Value | None) -> Value:
    """Return the value; the test fails where it is missing."""
    assert value is not None
    return value
