"""Reading and writing of float32 planes as TIFF: depth, sigma (mm, NaN where not measured) and confidence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError, describe_cause
from beltscape.files.folders.atomic import atomic_replacement


def write_float_tiff(path: Path, values: NDArray[np.float32], *, compressed: bool = False) -> None:
    """Write one float32 plane as TIFF, atomically."""
    import tifffile

    with atomic_replacement(path) as temporary:
        tifffile.imwrite(
            temporary,
            values.astype(np.float32),
            photometric="minisblack",
            compression="zlib" if compressed else None,
            software="beltscape",
            metadata=None,
        )


def read_float_tiff(path: Path) -> NDArray[np.float32]:
    """Read one float32 plane (H, W); InputError with the file's name if it is unreadable."""
    import tifffile

    try:
        values = tifffile.imread(path)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; give a frame folder of beltscape reconstruct") from error
    except (OSError, ValueError, tifffile.TiffFileError) as error:
        raise InputError(f"{path}: not a readable TIFF ({describe_cause(error)})") from error
    if values.ndim != 2 or values.dtype.kind != "f":
        raise InputError(f"{path}: holds {values.dtype} of shape {values.shape}; one float32 plane is needed")
    return values.astype(np.float32)
