"""The alarm journal as CSV: one row for every change of an alarm."""

from __future__ import annotations

import csv
import io
import json
from datetime import UTC, datetime

from beltscape.sinks.historian import Event

_COLUMNS = (
    "number", "time_utc", "alarm", "action", "state", "priority", "value", "limit", "unit", "suppression",
    "suppressed_by", "first", "group", "by", "text",
)  # fmt: skip
_FORMULA = ("=", "+", "-", "@")
"""Beginnings that a spreadsheet takes for a formula; people type reasons and names."""
_S_NS = 1_000_000_000
"""Nanoseconds of a second."""


def _format_row(values: list[str]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerow(values)
    return file.getvalue()


HEADER = _format_row(list(_COLUMNS))
"""First line of the table."""


def format_journal_row(event: Event) -> str:
    """Return the row of an entry, with its line end; an unknown value is empty."""
    parts: dict[str, object] = json.loads(event.parameters) if event.parameters else {}
    seconds, ns = divmod(event.wall_ns, _S_NS)
    time = datetime.fromtimestamp(seconds, UTC).replace(microsecond=ns // 1000)
    values: dict[str, object] = {
        **parts,
        "number": event.number,
        "time_utc": time.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "alarm": event.name,
        "by": event.by,
        "text": event.text,
    }
    return _format_row([_format_cell(values.get(column, "")) for column in _COLUMNS])


def _format_cell(value: object) -> str:
    """Return a cell; a text that a spreadsheet would compute begins with an apostrophe."""
    if isinstance(value, bool):
        return "true" if value else "false"
    text = str(value)
    return f"'{text}" if isinstance(value, str) and text.startswith(_FORMULA) else text
