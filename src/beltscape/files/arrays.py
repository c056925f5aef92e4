"""Named arrays in one file, a compressed NumPy archive (.npz); damaged bytes are recognised by its checksums."""

from __future__ import annotations

import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError, describe_cause
from beltscape.files.atomic import atomic_replacement

DAMAGED = (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error)
"""What NumPy and the archive raise for a file that cannot be read, is damaged or is no archive of arrays."""


def write_arrays(path: Path, /, **arrays: NDArray[Any]) -> None:
    """Write named arrays, atomically; OutputError where the disk does not take them."""
    with atomic_replacement(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **cast("dict[str, Any]", arrays))


def encode_arrays(**arrays: NDArray[Any]) -> bytes:
    """Return what `write_arrays` writes, for a file that has to be written in another way."""
    file = BytesIO()
    np.savez_compressed(file, **cast("dict[str, Any]", arrays))
    return file.getvalue()


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file by name; InputError if it is missing, damaged or no such file."""
    try:
        with path.open("rb") as stream:
            return parse_arrays(stream, str(path))
    except OSError as error:
        raise InputError(f"{path}: is no readable file of arrays ({describe_cause(error)})") from None


def parse_arrays(stream: IO[bytes], name: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of an open file, which is called ``name`` in errors; InputError as `read_arrays`."""
    try:
        with np.load(stream, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files}
    except DAMAGED as error:
        raise InputError(f"{name}: is no readable file of arrays ({describe_cause(error)})") from None
