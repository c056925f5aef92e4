"""Writing of point clouds in the format of the file's ending: PLY, LAS or LAZ."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beltscape.core.cloud import PointCloud
from beltscape.core.errors import InputError
from beltscape.files.las import ENDINGS as LAS_ENDINGS
from beltscape.files.las import write_las
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.ply import write_ply


@dataclass(frozen=True, slots=True)
class CloudFormat:
    """A format of point clouds."""

    write: Callable[[Path, PointCloud, Mapping[str, Any]], None]
    """Writes a cloud with its provenance, atomically."""
    unit: str
    """Unit of the coordinates in the file."""


FORMATS: Mapping[str, CloudFormat] = {
    ".ply": CloudFormat(lambda path, cloud, _: write_ply(path, cloud), "mm"),
    **dict.fromkeys(LAS_ENDINGS, CloudFormat(write_las, "m")),
}
"""By the ending of a file's name."""
ENDINGS = tuple(FORMATS)


def write_cloud(path: AnyPath, cloud: PointCloud, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a cloud in the format of the file's ending, atomically.

    Parameters
    ----------
    path
        The file; its ending is one of `ENDINGS`, in any case.
    cloud
        The points.
    provenance
        Plain values, such as the frame's name and the rig's digest, for the formats that can hold them (LAS, LAZ).

    Raises
    ------
    InputError
        When the ending is of no such format, or the library of LAS is not installed.
    """
    path = as_path(path)
    FORMATS[require_ending(path.name)].write(path, cloud, provenance or {})


def require_ending(name: str) -> str:
    """Return the ending of a cloud's file name in lower case; InputError if no format has it."""
    if name.lower().endswith(".copc.laz"):
        raise InputError(f"{name}: COPC is not written; write a .laz, and convert it with PDAL or untwine")
    ending = find_ending(name)
    if ending is None:
        raise InputError(f"{name}: no format of point clouds has this ending; use {', '.join(ENDINGS)}")
    return ending


def find_ending(name: str) -> str | None:
    """Return the ending of a cloud's file name in lower case; None if no format has it."""
    return next((ending for ending in ENDINGS if name.lower().endswith(ending)), None)
