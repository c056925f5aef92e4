"""How many of the examples of a property are tried: a part in ``make test``, all in ``make thorough``.

A test or case with the mark ``thorough`` runs in ``make thorough`` only: it shows on more inputs, or at length, what
a shorter test shows in ``make test``.
"""

from __future__ import annotations

import os
from collections.abc import Container, Iterable

import pytest
from hypothesis import settings

THOROUGH = os.environ.get("BELTSCAPE_THOROUGH") == "1"
"""Whether all is tried."""


def list_cases(cases: Iterable[object], main: Container[object]) -> list[object]:
    """Return the cases of a test; those that are not ``main`` are for ``make thorough``."""
    return [case if case in main else pytest.param(case, marks=pytest.mark.thorough) for case in cases]


def list_rows(rows: Iterable[tuple[object, ...]], main: Container[object]) -> list[object]:
    """Return the cases of a test of several arguments; those that are not ``main`` are for ``make thorough``."""
    return [row if row in main else pytest.param(*row, marks=pytest.mark.thorough) for row in rows]


def count_examples(most: int) -> int:
    """Return how many of at most this number of draws are made, of which a test takes means."""
    return most if THOROUGH else max(3, most // 4)


def examples(most: int) -> settings:
    """Return the setting of a property that is tried with at most this number of examples."""
    return settings(max_examples=most if THOROUGH else max(3, most // 6), deadline=None)
