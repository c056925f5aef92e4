"""Reading and writing of height maps as TIFF with GeoTIFF's tags for position and scale, in millimetres."""

from __future__ import annotations

import numpy as np

from beltscape.core.belt.height_map import HeightMap
from beltscape.core.errors import InputError
from beltscape.files.folders.atomic import atomic_replacement
from beltscape.files.folders.paths import AnyPath, as_path

_SCALE, _TIEPOINT, _KEYS, _NODATA = 33550, 33922, 34735, 42113
"""ModelPixelScaleTag, ModelTiepointTag, GeoKeyDirectoryTag of OGC 19-008r4 (GeoTIFF 1.1); GDAL's nodata."""
_DOUBLE, _SHORT, _ASCII = 12, 3, 2
"""Types of a tag's values (TIFF 6.0, section 2)."""
_USER_DEFINED, _AREA, _MODEL, _RASTER = 32767, 1, 1024, 1025
"""Values of GTModelTypeGeoKey and GTRasterTypeGeoKey, and the numbers of these keys (OGC 19-008r4)."""


def write_height_tiff(path: AnyPath, heights: HeightMap, *, sigma: bool = False) -> None:
    """Write heights (or, with ``sigma``, their σ) as float32, NaN where not measured, atomically.

    The first row of the file is the one at the greatest y, as in a map: model y falls from row to row.
    """
    path = as_path(path)
    import tifffile

    values = heights.sigma_mm if sigma else heights.height_mm
    half = heights.cell_mm / 2
    left, top = heights.origin_mm[0] - half, float(heights.y_mm[-1]) + half
    keys = (1, 1, 1, 2, _MODEL, 0, 1, _USER_DEFINED, _RASTER, 0, 1, _AREA)
    with atomic_replacement(path) as temporary:
        tifffile.imwrite(
            temporary,
            values[::-1].astype(np.float32),
            photometric="minisblack",
            software="beltscape",
            description="height over the empty belt, mm" if not sigma else "standard deviation, mm",
            resolution=(10 / heights.cell_mm, 10 / heights.cell_mm),
            resolutionunit="CENTIMETER",
            metadata=None,
            extratags=[
                (_SCALE, _DOUBLE, 3, (heights.cell_mm, heights.cell_mm, 0.0), True),
                (_TIEPOINT, _DOUBLE, 6, (0.0, 0.0, 0.0, left, top, 0.0), True),
                (_KEYS, _SHORT, len(keys), keys, True),
                (_NODATA, _ASCII, 0, "nan", True),
            ],
        )


def read_height_tiff(path: AnyPath) -> HeightMap:
    """Read a file of `write_height_tiff`, with unknown σ (NaN); InputError with its name if it is unreadable."""
    path = as_path(path)
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            values = page.asarray()
            scale, tie = (page.tags[tag].value for tag in (_SCALE, _TIEPOINT))
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; give a height map of beltscape measure volume") from error
    except (OSError, ValueError, KeyError, tifffile.TiffFileError) as error:
        raise InputError(f"{path}: no height map with a scale ({error})") from error
    height = values[::-1].astype(np.float64)
    cell = float(scale[0])
    origin = (float(tie[3]) + cell / 2, float(tie[4]) + cell / 2 - len(height) * cell)
    return HeightMap(height, np.full(height.shape, np.nan), (origin[0], origin[1] + 0.0), cell)
