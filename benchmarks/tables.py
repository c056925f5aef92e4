"""Tables of Markdown."""

from __future__ import annotations

from collections.abc import Sequence


def format_cells(cells: Sequence[str]) -> str:
    """Return a row of a table."""
    return "| " + " | ".join(cells) + " |"


def format_head(columns: Sequence[str]) -> list[str]:
    """Return the two lines above a table's rows."""
    return [format_cells(columns), "|" + "---|" * len(columns)]
