"""Entries of a piece as bytes: a compressed JSON document with exact numbers, and the cross-sections as float32."""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Sequence
from dataclasses import asdict, astuple, fields
from typing import Any

import numpy as np

from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.belt.ledger_entries import BeltRecord, CrossSection
from beltscape.core.belt.sigma_parts import SigmaParts
from beltscape.reprocessing.results import PieceResult, PieceTimes

_STRIP = tuple(field.name for field in fields(FlowRecord) if field.name != "sigma_parts")
_OWN = ("belt_mm", "standing", "reason", "cameras", "offset_mm")
"""Fields of an entry that its piece determines; the others are given where the pieces are joined."""


def encode_result(result: PieceResult) -> bytes:
    """Return a piece's result as bytes; floats keep every digit, NaN included."""
    document = {
        "entries": [_encode_entry(entry) for entry in result.entries],
        "warnings": result.warnings,
        "times": asdict(result.times),
    }
    return zlib.compress(json.dumps(document, separators=(",", ":")).encode(), 1)


def decode_result(data: bytes) -> PieceResult:
    """Return the result that `encode_result` encoded."""
    document = json.loads(zlib.decompress(data))
    entries = tuple(map(_decode_entry, document["entries"]))
    return PieceResult(entries, tuple(document["warnings"]), PieceTimes(**document["times"]))


def _encode_entry(record: BeltRecord) -> dict[str, Any]:
    strip = record.strip
    values: dict[str, Any] = {name: getattr(record, name) for name in _OWN}
    if strip is not None:
        values["strip"] = [getattr(strip, name) for name in _STRIP]
        values["parts"] = astuple(strip.sigma_parts)
    if record.section is not None:
        values["section"] = [_encode_array(a) for a in (record.section.x_mm, record.section.height_mm)]
    return values


def _decode_entry(values: dict[str, Any]) -> BeltRecord:
    strip, section = values.pop("strip", None), values.pop("section", None)
    parts = SigmaParts(*values.pop("parts", ()))
    begin_mm, end_mm = values.pop("belt_mm")
    return BeltRecord(
        number=0,
        run=0,
        belt_mm=(begin_mm, end_mm),
        wall_ns=0,
        strip=None if strip is None else _decode_strip(strip, parts),
        run_sigma_mm3=math.nan,
        section=None if section is None else CrossSection(*map(_decode_array, section)),
        **values,
    )


def _decode_strip(values: Sequence[Any], parts: SigmaParts) -> FlowRecord:
    named = dict(zip(_STRIP, values, strict=True))
    low, high = named.pop("strip_mm")
    return FlowRecord(strip_mm=(low, high), sigma_parts=parts, **named)


def _encode_array(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array, "<f4").tobytes()).decode()


def _decode_array(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4").astype(np.float32)
