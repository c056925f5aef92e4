"""Reading of an optional file of an earlier run; without it, or when it is damaged, the run goes on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from beltscape.core.errors import InputError, describe_cause
from beltscape.core.progress import Reporter

Content = TypeVar("Content")


def read_optional_file(
    path: Path, read: Callable[[], Content | None], fix: str, reporter: Reporter
) -> Content | None:
    """Return what ``read`` finds in a file; None without the file, and with a warning where it is damaged.

    ``fix`` is the end of the warning: what happens without the file.
    """
    if not path.is_file():
        return None
    try:
        return read()
    except (InputError, KeyError, TypeError, ValueError) as error:
        reason = str(error) if isinstance(error, InputError) else f"{path}: damaged ({describe_cause(error)})"
        reporter.warn(reason if reason.endswith(fix) else f"{reason}; {fix}")
        return None
