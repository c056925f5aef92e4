"""A pattern as an image to be projected pixel by pixel, as SVG, and as pattern.json with every dot.

In the image each pixel gets the exact share of its area that a disc covers. SVG is for slides, gobos and glass masks;
pattern.json is ``beltscape-pattern/1``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError
from beltscape.files.atomic import write_text
from beltscape.files.json_text import read_json, to_json
from beltscape.files.toml_text import validate
from beltscape.target.pattern import MARKERS, Color, Length, Marker, Pattern, PatternSettings, Share, Side

CHUNK = 1 << 20
"""Pixel corners processed at once."""


def compute_disc_coverage(size_px: tuple[int, int], discs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of the discs' weights times the share of each pixel that they cover.

    Parameters
    ----------
    size_px
        Width and height. Pixel (0, 0) is the square of side 1 centred on (0, 0).
    discs
        (N, 4) x, y, radius > 0, weight; px. Parts outside the image are cut off.

    Returns
    -------
    (H, W) float64; exact but for rounding, so that a disc wholly inside sums up to weight · π · radius².
    """
    width, height = size_px
    image = np.zeros(width * height)
    spans = np.ceil(2 * discs[:, 2]).astype(np.int64) + 1  # pixels that a disc can touch in a row
    for span in np.unique(spans):
        same_span = discs[spans == span]
        step = max(CHUNK // int(span + 1) ** 2, 1)
        for start in range(0, len(same_span), step):
            _add_discs(image, size_px, same_span[start : start + step], int(span))
    return image.reshape(height, width)


def _add_discs(
    image: NDArray[np.float64], size_px: tuple[int, int], discs: NDArray[np.float64], span: int
) -> None:
    """Add (n, 4) discs, each within span × span pixels, to the flat image."""
    width, height = size_px
    x, y, radius, weight = discs.T
    column, row = np.rint(x - radius).astype(np.int64), np.rint(y - radius).astype(np.int64)
    corner = np.arange(span + 1) - 0.5
    u = ((column - x)[:, None] + corner) / radius[:, None]
    v = ((row - y)[:, None] + corner) / radius[:, None]
    below = _area_below(u, v) * (radius * radius * weight)[:, None, None]
    share = np.diff(np.diff(below, axis=1), axis=2)
    columns, rows = column[:, None] + np.arange(span), row[:, None] + np.arange(span)
    inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
    index = (rows * width)[:, :, None] + columns[:, None, :]
    image += np.bincount(index[inside], share[inside], minlength=image.size)


def _area_below(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, rows, columns) area of the unit disc left of u (n, columns) and above v (n, rows)."""
    u, v = np.clip(u, -1, 1)[:, None, :], np.clip(v, -1, 1)[:, :, None]
    half = np.sqrt(1 - v * v)  # the chord at v reaches from -half to half
    end = np.clip(u, -half, half)
    cap = (
        _integrate_half_chord(end) - _integrate_half_chord(-half) - np.abs(v) * (end + half)
    )  # beyond |v|, left of u
    return np.where(v < 0, cap, 2 * _integrate_half_chord(u) - cap)


def _integrate_half_chord(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ∫ √(1 - t²) dt from 0 to u."""
    return (u * np.sqrt(1 - u * u) + np.arcsin(u)) / 2


def draw_pattern(pattern: Pattern, bits: Literal[8, 16] = 8) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return (H, W, 3) RGB of 8 or 16 bits; each pixel is the mean of the colours in it, in pixel values."""
    markers = np.array([(*marker.center_px, marker.radius_px, 1.0) for marker in pattern.markers])
    dot_coverage = np.clip(compute_disc_coverage(pattern.size_px, pattern.dots), 0, 1)
    marker_coverage = np.clip(compute_disc_coverage(pattern.size_px, markers), 0, 1)
    settings = pattern.settings
    background, dot, marker = map(
        rgb_from_hex, (settings.background, settings.dot_color, settings.marker_color)
    )
    max_value = 2**bits - 1
    image = np.empty((*dot_coverage.shape, 3), dtype=np.uint8 if bits == 8 else np.uint16)
    for channel in range(3):
        low = background[channel]
        value = low + dot_coverage * (dot[channel] - low) + marker_coverage * (marker[channel] - low)
        image[..., channel] = np.rint(np.clip(value, 0, 1) * max_value)
    return cast("NDArray[np.uint8] | NDArray[np.uint16]", image)


def rgb_from_hex(color: str) -> NDArray[np.float64]:
    """Return (3,) red, green, blue 0..1 of a colour written #RRGGBB."""
    return np.array([int(color[start : start + 2], 16) / 255 for start in (1, 3, 5)])


def hex_from_rgb(rgb: NDArray[np.float64]) -> str:
    """Return the nearest colour written #RRGGBB."""
    return "#" + "".join(f"{round(float(value) * 255):02X}" for value in rgb)


def pattern_to_svg(pattern: Pattern) -> str:
    """Return the SVG text of a pattern; one unit is one pixel, (0, 0) the centre of the top-left one."""
    (width, height), settings = pattern.size_px, pattern.settings
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="-0.5 -0.5 {width} {height}">',
        f'<rect x="-0.5" y="-0.5" width="{width}" height="{height}" fill="{settings.background}"/>',
    ]
    low, high = rgb_from_hex(settings.background), rgb_from_hex(settings.dot_color)
    for level in np.unique(pattern.dots[:, 3]):
        dots = pattern.dots[pattern.dots[:, 3] == level]
        parts.append(f'<g fill="{hex_from_rgb(low + level * (high - low))}">')
        parts += [f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{r:g}"/>' for x, y, r, _ in dots.tolist()]
        parts.append("</g>")
    parts.append(f'<g fill="{settings.marker_color}">')
    parts += [
        f'<circle cx="{m.center_px[0]:g}" cy="{m.center_px[1]:g}" r="{m.radius_px:g}"/>'
        for m in pattern.markers
    ]
    return "\n".join([*parts, "</g>", "</svg>"]) + "\n"


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
