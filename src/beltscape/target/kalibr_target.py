"""Kalibr's description of a calibration target, ``target.yaml``, as a board.

``target_type`` is ``aprilgrid`` with ``tagCols``, ``tagRows``, ``tagSize`` (m) and ``tagSpacing`` (gap over tagSize),
or ``checkerboard`` with ``targetCols``, ``targetRows`` (inner corners), ``colSpacingMeters``, ``rowSpacingMeters``.

Source: https://github.com/ethz-asl/kalibr/wiki/calibration-targets
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError
from beltscape.core.plausibility import suggest_unit
from beltscape.core.quantities import SQUARE
from beltscape.core.type_guards import is_dict
from beltscape.files.documents.toml_text import validate
from beltscape.files.exchange.documents import read_document
from beltscape.target.planar_boards import AprilGrid, Chessboard, PlanarBoard

SUFFIXES = (".yaml", ".yml")
MM_PER_M = 1000.0
"""Kalibr's lengths are in metres."""
NANOMETRES = 6
"""Decimals of a length in mm: metres times 1000 leave rounding behind."""


def read_kalibr_target(path: Path) -> PlanarBoard:
    """Return the board of a target.yaml.

    Raises
    ------
    InputError
        With the key that is missing or wrong, or when the target is one of circles.
    """
    values = read_document(path)
    kind = values.get("target_type") if is_dict(values) else None
    if not is_dict(values) or kind not in ("aprilgrid", "checkerboard"):
        raise InputError(
            f"{path}: target_type = {kind!r}: must be 'aprilgrid' or 'checkerboard'; describe other boards in "
            "board.toml"
        )
    if kind == "aprilgrid":
        found = {
            "tags": [_get(path, values, "tagCols"), _get(path, values, "tagRows")],
            "tag_mm": _get_mm(path, values, "tagSize"),
            "spacing": _get(path, values, "tagSpacing"),
        }
        return validate(path, AprilGrid, found)
    across, down = _get_mm(path, values, "colSpacingMeters"), _get_mm(path, values, "rowSpacingMeters")
    if across != down:
        raise InputError(
            f"{path}: colSpacingMeters = {values['colSpacingMeters']} and rowSpacingMeters = "
            f"{values['rowSpacingMeters']} differ; only boards of squares are supported"
        )
    corners = [_get(path, values, "targetCols"), _get(path, values, "targetRows")]
    return validate(path, Chessboard, {"corners": corners, "square_mm": across})


def _get(path: Path, values: dict[str, Any], key: str) -> Any:
    if values.get(key) is None:
        raise InputError(f"{path}: {key} is missing")
    return values[key]


def _get_mm(path: Path, values: dict[str, Any], key: str) -> float:
    value = _get(path, values, key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{path}: {key} = {value!r}: must be a length in metres")
    if value > 0 and SQUARE.find_refusal(value * MM_PER_M):
        fix = suggest_unit(value, "m", lambda metres: not SQUARE.find_refusal(metres * MM_PER_M))
        raise InputError(f"{path}: {key} = {value!r}: must be a length in metres{fix}")
    return round(value * MM_PER_M, NANOMETRES)
