"""Rights of the data folder: its files are for the user and the group of the program, whatever its umask."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

_MASK = 0o027
"""New files get 0640 at most, new folders 0750, as under the systemd unit (UMask=0027)."""
_OTHERS = 0o007
"""Rights of other users, which are removed from files of the data folder."""
_OWN = (
    *("history.db*", "history.*", "totals.json", "users.db*", "site.db*", "audit*.jsonl", "reserve"),
    *("days", "csv", "recordings", "damaged"),
)
"""Files and folders that the program writes into its data folder."""


@contextmanager
def restrict_rights(data: Path) -> Generator[None]:
    """Create files without rights for others until the block ends; take them from what earlier runs wrote."""
    before = os.umask(_MASK)
    os.umask(before | _MASK)
    try:
        for pattern in _OWN:
            for path in data.glob(pattern):
                _restrict(path)
        yield
    finally:
        os.umask(before)


def _restrict(path: Path) -> None:
    """Take the rights of others from a file or folder; another user's file is left as it is."""
    with suppress(OSError):
        mode = path.stat().st_mode
        if mode & _OTHERS:
            path.chmod(mode & 0o7777 & ~_OTHERS)
