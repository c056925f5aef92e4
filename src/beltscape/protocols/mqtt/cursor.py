"""The number of the last record that the broker has acknowledged, kept on the disk."""

from __future__ import annotations

from pathlib import Path

from beltscape.protocols.kept_number import KeptNumber


def read_cursor(path: Path, broker: str) -> KeptNumber:
    """Return the cursor of a broker, without a number where nothing was published to it yet.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    key, fix = ("broker", broker), "publish from the newest record on"
    return KeptNumber(path, "beltscape-mqtt/1", "acknowledged", key, fix)
