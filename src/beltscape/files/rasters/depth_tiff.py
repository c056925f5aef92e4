"""depth.tiff, sigma.tiff, confidence.tiff: one float32 plane each; millimetres are NaN where not measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.files.folders.atomic import replacing


def write_float_tiff(path: Path, values: NDArray[np.float32], *, compressed: bool = False) -> None:
    """One float32 plane as TIFF, atomically."""
    import tifffile

    with replacing(path) as temporary:
        tifffile.imwrite(
            temporary,
            values.astype(np.float32),
            photometric="minisblack",
            compression="zlib" if compressed else None,
            software="beltscape",
            metadata=None,
        )


def read_float_tiff(path: Path) -> NDArray[np.float32]:
    """(H, W) float32, or InputError naming the file."""
    import tifffile

    try:
        values = tifffile.imread(path)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; give a frame folder of beltscape reconstruct") from error
    except (OSError, ValueError, tifffile.TiffFileError) as error:
        raise InputError(f"{path}: not a readable TIFF ({error})") from error
    if values.ndim != 2 or values.dtype.kind != "f":
        raise InputError(f"{path}: holds {values.dtype} of shape {values.shape}; one float32 plane is needed")
    return values.astype(np.float32)
