"""Reading of a file that an earlier run kept and that this one can do without."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter

Kept = TypeVar("Kept")


def read_kept(path: Path, read: Callable[[], Kept | None], fix: str, reporter: Reporter) -> Kept | None:
    """Return what ``read`` finds in a file; None without the file, and with a warning where it is damaged.

    ``fix`` is the end of the warning: what happens without the file.
    """
    if not path.is_file():
        return None
    try:
        return read()
    except (InputError, KeyError, TypeError, ValueError) as error:
        reason = str(error) if isinstance(error, InputError) else f"{path}: damaged ({error!r})"
        reporter.warn(reason if reason.endswith(fix) else f"{reason}; {fix}")
        return None
