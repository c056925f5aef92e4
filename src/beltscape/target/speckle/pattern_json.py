"""pattern.json: ``beltscape-pattern/1``, the pattern with every dot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import InputError
from beltscape.core.type_guards import is_dict
from beltscape.files.documents.json_text import read_json, to_json
from beltscape.files.documents.toml_text import validate
from beltscape.files.folders.atomic import write_text
from beltscape.target.speckle.pattern import (
    MARKERS,
    Color,
    Length,
    Marker,
    Pattern,
    PatternSettings,
    Share,
    Side,
)

FORMAT = "beltscape-pattern/1"


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Parameters(_Entry):
    count: int
    d_min_px: Length
    radius_px: Length
    grey: tuple[Share, Share]
    dot_color: Color
    background: Color
    marker_color: Color


class _Marker(_Entry):
    row: int = Field(ge=0, lt=MARKERS)
    col: int = Field(ge=0, lt=MARKERS)
    center_px: tuple[float, float]
    radius_px: Length


class _Document(_Entry):
    format: Literal["beltscape-pattern/1"]
    size_px: tuple[Side, Side]
    seed: int
    parameters: _Parameters
    dots: list[tuple[float, float, Length, Share]]
    markers: list[_Marker]


def write_pattern(path: Path, pattern: Pattern) -> None:
    """Write a pattern, atomically, with full float precision; one dot per line."""
    settings = pattern.settings.model_dump(exclude={"size_px", "seed"})
    document = {
        "format": FORMAT,
        "size_px": pattern.size_px,
        "seed": pattern.settings.seed,
        "parameters": settings,
        "dots": [],
        "markers": [
            {"row": m.row, "col": m.col, "center_px": m.center_px, "radius_px": m.radius_px}
            for m in pattern.markers
        ],
    }
    dots = ",\n  ".join(json.dumps(dot) for dot in pattern.dots.tolist())
    write_text(path, to_json(document).replace('"dots": []', f'"dots": [\n  {dots}\n ]', 1))


def read_pattern(path: Path) -> Pattern:
    """Read pattern.json, or raise InputError naming the invalid key."""
    document: Any = read_json(path)
    format_name = document.get("format") if is_dict(document) else None
    if format_name != FORMAT:
        raise InputError(
            f"{path}: format is {format_name!r}, not {FORMAT!r}; give a pattern.json of beltscape target pattern"
        )
    content = validate(path, _Document, document)
    settings = {"size_px": content.size_px, "seed": content.seed, **content.parameters.model_dump()}
    if len(content.dots) != content.parameters.count:
        raise InputError(
            f"{path}: {len(content.dots)} dots, but parameters.count is {content.parameters.count}; "
            "give the file as it was written"
        )
    markers = tuple(Marker(m.row, m.col, m.center_px, m.radius_px) for m in content.markers)
    dots = np.array(content.dots, dtype=np.float64)
    return Pattern(validate(path, PatternSettings, settings), dots, markers)
