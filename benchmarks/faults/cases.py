"""The rows of the bench, read from cases.toml."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from faults.case import Case


def read_cases() -> tuple[Case, ...]:
    """Return every row."""
    return tuple(Case(**(row | {"named_by": tuple(row["named_by"])})) for row in _read()["case"])


def read_not_played() -> tuple[tuple[str, str], ...]:
    """Return what the bench leaves to others, and why."""
    return tuple((row["what"], row["why"]) for row in _read()["not_played"])


def _read() -> dict[str, Any]:
    return tomllib.loads((Path(__file__).with_name("cases.toml")).read_text(encoding="utf-8"))
