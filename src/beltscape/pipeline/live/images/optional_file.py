"""Reading of an optional file of an earlier run; without it, or when it is damaged, the run goes on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from beltscape.core.progress import Reporter
from beltscape.files.folders.durable import describe_damage, set_aside

Content = TypeVar("Content")


def read_optional_file(
    path: Path, read: Callable[[], Content | None], fix: str, reporter: Reporter
) -> Content | None:
    """Return what ``read`` finds in a file; None without it, and where it is damaged.

    A damaged file is set aside with a warning, of which ``fix`` is the end: what happens without the file.
    """
    if not path.is_file():
        return None
    try:
        return read()
    except Exception as error:
        reporter.warn(f"{set_aside(path, describe_damage(path, error).removesuffix(f'; {fix}'))}; {fix}")
        return None
