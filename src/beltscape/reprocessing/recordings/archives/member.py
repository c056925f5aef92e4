"""Path of an archive's member with its byte range, so that it is read without a list of the archive's members."""

from __future__ import annotations

import re
from dataclasses import dataclass

_RANGE = re.compile(r"(.*)@(\d+)\+(\d+)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Member:
    """A file in an archive."""

    start: int
    """zip: of the local header in the archive; tar: of the data in the archive, in a compressed one when unpacked."""
    length: int
    """Bytes of the range: zip: header, packed data and what follows; tar: the data."""
    size: int
    """Bytes of the unpacked file."""
    stamp: str
    """What tells a changed file: a checksum, or its time."""

    def append_range(self, name: str) -> str:
        """Return the path by which the member is read."""
        return f"{name}@{self.start}+{self.length}"


def split_member(path: str) -> tuple[str, int, int]:
    """Return name, start and length of a path that `Member.append_range` made."""
    match = _RANGE.fullmatch(path)
    if match is None:
        raise ValueError(f"{path}: has no byte range")
    return match[1], int(match[2]), int(match[3])


def normalise_name(name: str) -> str | None:
    """Return a member's path with "/" and without "./"; None for one that would leave the archive's root."""
    parts = [part for part in name.replace("\\", "/").split("/") if part != "."]
    if name.startswith(("/", "\\")) or ".." in parts or (parts and parts[0].endswith(":")):
        return None
    return "/".join(part for part in parts if part)
