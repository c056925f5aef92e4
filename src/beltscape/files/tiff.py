"""Planes of float32 as TIFF (depth, σ, confidence), and height maps as GeoTIFF (OGC 19-008r4, version 1.1).

A height map's coordinate system is a local one in metres, the belt frame, which QGIS and GDAL open without asking
for another; the heights are in millimetres, which GDAL's metadata state. Earlier versions wrote positions in
millimetres and named no system; their files are read as well.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError, describe_cause
from beltscape.core.height_map import HeightMap
from beltscape.files.atomic import atomic_replacement
from beltscape.files.paths import AnyPath, as_path

_SCALE, _TIEPOINT, _KEYS, _TEXTS = 33550, 33922, 34735, 34737
"""ModelPixelScaleTag, ModelTiepointTag, GeoKeyDirectoryTag, GeoAsciiParamsTag."""
_METADATA, _NODATA = 42112, 42113
"""GDAL's tags: metadata of the band, and the value of cells without a height."""
_DOUBLE, _SHORT, _ASCII = 12, 3, 2
"""Types of a tag's values (TIFF 6.0, section 2)."""
_MODEL, _RASTER, _CITATION, _UNIT = 1024, 1025, 1026, 3076
"""GTModelTypeGeoKey, GTRasterTypeGeoKey, GTCitationGeoKey, ProjLinearUnitsGeoKey."""
_USER_DEFINED, _AREA, _METRE = 32767, 1, 9001
"""No map projection; a cell is an area; EPSG's number of the metre."""
_FRAME = "Beltscape belt frame (x across, y along, z up)|"
"""The citation, by which GDAL names the local coordinate system; GeoTIFF ends texts with a bar."""
_DESCRIPTIONS = {False: "height over the empty belt", True: "standard deviation of the height"}
"""Whether the map is of σ → its description."""
_BAND = (
    '<GDALMetadata><Item name="UNITTYPE" sample="0" role="unittype">mm</Item>'
    '<Item name="DESCRIPTION" sample="0" role="description">{}</Item></GDALMetadata>'
)
_DECIMALS = 9
"""Decimals of a position in mm that is read: less than the rounding of metres in a double."""


def write_height_tiff(path: AnyPath, heights: HeightMap, *, sigma: bool = False) -> None:
    """Write heights (or, with ``sigma``, their σ) as float32, NaN where not measured, atomically.

    The first row of the file is the one at the greatest y, as in a map: model y falls from row to row. A sum of the
    heights (mm) times the area of a cell (m²) is a volume in litres.
    """
    path = as_path(path)
    import tifffile

    values = heights.sigma_mm if sigma else heights.height_mm
    cell_m, half = heights.cell_mm / 1000, heights.cell_mm / 2
    left_m, top_m = (heights.origin_mm[0] - half) / 1000, (float(heights.y_mm[-1]) + half) / 1000
    with atomic_replacement(path) as temporary:
        tifffile.imwrite(
            temporary,
            values[::-1].astype(np.float32),
            photometric="minisblack",
            software="beltscape",
            description=f"{_DESCRIPTIONS[sigma]}, mm",
            resolution=(10 / heights.cell_mm, 10 / heights.cell_mm),
            resolutionunit="CENTIMETER",
            metadata=None,
            extratags=[
                (_SCALE, _DOUBLE, 3, (cell_m, cell_m, 0.0), True),
                (_TIEPOINT, _DOUBLE, 6, (0.0, 0.0, 0.0, left_m, top_m, 0.0), True),
                *_list_frame_tags(),
                (_METADATA, _ASCII, 0, _BAND.format(_DESCRIPTIONS[sigma]), True),
                (_NODATA, _ASCII, 0, "nan", True),
            ],
        )


def _list_frame_tags() -> list[tuple[int, int, int, object, bool]]:
    """Return the tags that name the belt frame as a local coordinate system in metres, its cells areas."""
    keys = (
        *(1, 1, 1, 4),  # version 1.1.1 of the directory, number of keys
        *(_MODEL, 0, 1, _USER_DEFINED),
        *(_RASTER, 0, 1, _AREA),
        *(_CITATION, _TEXTS, len(_FRAME), 0),
        *(_UNIT, 0, 1, _METRE),
    )
    return [(_KEYS, _SHORT, len(keys), keys, True), (_TEXTS, _ASCII, 0, _FRAME, True)]


def read_height_tiff(path: AnyPath) -> HeightMap:
    """Read a file of `write_height_tiff`, with unknown σ (NaN); InputError with its name if it is unreadable."""
    path = as_path(path)
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            values = page.asarray()
            unit_mm = 1000.0 if _TEXTS in page.tags else 1.0
            scale, tie = (unit_mm * np.array(page.tags[tag].value) for tag in (_SCALE, _TIEPOINT))
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; give a height map of beltscape measure volume") from error
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: no height map with a scale ({describe_cause(error)})") from error
    height = values[::-1].astype(np.float64)
    cell = round(float(scale[0]), _DECIMALS)
    x, y = tie[3] + cell / 2, tie[4] + cell / 2 - len(height) * cell
    origin = (round(float(x), _DECIMALS) + 0.0, round(float(y), _DECIMALS) + 0.0)
    return HeightMap(height, np.full(height.shape, np.nan), origin, cell)


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
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a readable TIFF ({describe_cause(error)})") from error
    if values.ndim != 2 or values.dtype.kind != "f":
        raise InputError(f"{path}: holds {values.dtype} of shape {values.shape}; one float32 plane is needed")
    return values.astype(np.float32)
