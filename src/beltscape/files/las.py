"""Writing of point clouds as LAS 1.4, or LAZ, for GIS and surveying software (ASPRS LAS 1.4 R15).

Points are in metres, as that software expects: integers of 1 µm in the cloud's own frame, which the file names as a
local coordinate system. σ, confidence and normals are extra dimensions; a record of Beltscape holds the provenance.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beltscape import __version__
from beltscape.core.cloud import PointCloud
from beltscape.core.errors import InputError, describe_missing_library
from beltscape.files.atomic import atomic_replacement

if TYPE_CHECKING:
    import laspy

ENDINGS = (".las", ".laz")
USER_ID, RECORD_ID = "beltscape", 1
"""Keys of the variable-length record with the provenance, a JSON document in UTF-8."""
_STEP_M = 1e-6
"""Unit of a coordinate: a hundredth of the usual σ; 32 bits then reach ±2147 m. Chosen."""
_REACH_M = 2147.0
"""Farthest coordinate that 32 bits hold in that unit."""
_POINT_FORMAT = 7
"""Coordinates, 16-bit colour, time; of LAS 1.4, which names coordinate systems as WKT."""
_DATE_OFFSET = 90
"""Offset of the header's day and year of creation (LAS 1.4 R15, table 3); 0 means unknown."""
_AXES = {
    "core": ("core camera", "x right, y down, z forward along the optical axis"),
    "belt": ("belt", "x across, y along, z up; 0 where the core looks at the belt"),
}
"""Frame → its name in words, and its axes."""


def write_las(path: Path, cloud: PointCloud, provenance: Mapping[str, Any]) -> None:
    """Write a cloud as LAS, or compressed if the name ends with .laz, atomically. Same cloud, same bytes.

    Raises
    ------
    InputError
        When the library is not installed, or a point is not finite or farther away than LAS can express.
    """
    try:
        import laspy
    except ImportError as error:
        raise InputError(f"{path}: {describe_missing_library(error)}") from error
    points_m = cloud.points_mm.astype(np.float64) / 1000
    if not (np.abs(points_m) < _REACH_M).all():
        raise InputError(
            f"{path}: a point is not finite, or farther than {_REACH_M:g} m; LAS holds steps of 1 µm"
        )
    record = _make_record(laspy.LasData(_make_header(cloud, provenance)), cloud)
    record.x, record.y, record.z = points_m.T
    with atomic_replacement(path) as temporary:
        record.write(str(temporary), do_compress=path.suffix.lower() == ".laz")
        with temporary.open("r+b") as file:  # the library writes today's date, and equal clouds would differ
            file.seek(_DATE_OFFSET)
            file.write(bytes(4))


def _make_header(cloud: PointCloud, provenance: Mapping[str, Any]) -> laspy.LasHeader:
    import laspy
    from laspy.vlrs.known import WktCoordinateSystemVlr

    header = laspy.LasHeader(version="1.4", point_format=_POINT_FORMAT)
    header.scales, header.offsets = np.full(3, _STEP_M), np.zeros(3)
    header.system_identifier, header.generating_software = "stereo matching", f"beltscape {__version__}"
    header.global_encoding.wkt = True
    header.vlrs.append(WktCoordinateSystemVlr(_describe_frame(cloud.frame)))
    document = {**provenance, "program": f"beltscape {__version__}", "frame": cloud.frame, "units": "m"}
    data = json.dumps(document, ensure_ascii=False, sort_keys=True).encode()
    header.vlrs.append(laspy.VLR(USER_ID, RECORD_ID, "provenance, JSON", data))
    extra = [("sigma_mm", "standard deviation, mm")]
    extra += [] if cloud.confidence is None else [("confidence", "of a true surface, 0 to 1")]
    extra += [(name, "unit normal; NaN: none") for name in ("NormalX", "NormalY", "NormalZ")]
    header.add_extra_dims([laspy.ExtraBytesParams(name, "float32", text) for name, text in extra])
    return header


def _make_record(record: laspy.LasData, cloud: PointCloud) -> laspy.LasData:
    """Fill all dimensions but the coordinates; 8-bit colours become 16-bit ones of the same brightness."""
    count = len(cloud.points_mm)
    record.points = type(record.points).zeros(count, header=record.header)
    record.return_number = record.number_of_returns = np.ones(count, np.uint8)
    record.red, record.green, record.blue = cloud.colors.T.astype(np.uint16) * 257
    record.sigma_mm = cloud.sigma_mm
    if cloud.confidence is not None:
        record.confidence = cloud.confidence
    for name, values in zip(("NormalX", "NormalY", "NormalZ"), cloud.normals.T, strict=True):
        record[name] = values
    return record


def _describe_frame(frame: str) -> str:
    """Return a frame as a local coordinate system in metres (WKT 1, OGC 01-009, which LAS 1.4 prescribes)."""
    name, axes = _AXES.get(frame, (frame, "in metres"))
    return (
        f'LOCAL_CS["Beltscape {name} frame ({axes})",LOCAL_DATUM["{name}",32767],UNIT["metre",1],'
        'AXIS["x",OTHER],AXIS["y",OTHER],AXIS["z",OTHER]]'
    )
