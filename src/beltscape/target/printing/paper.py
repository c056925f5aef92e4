"""Paper sizes, and the choice of a page for a given size."""

from __future__ import annotations

import re
from math import ceil

from beltscape.core.errors import SettingsError

PAPERS_MM: dict[str, tuple[float, float]] = {
    "A4": (210, 297),
    "A3": (297, 420),
    "A2": (420, 594),
    "A1": (594, 841),
    "A0": (841, 1189),
}
"""ISO 216, width and height in portrait, from small to large."""

LARGEST_MM = 5080.0
"""A PDF page is at most 14,400 points wide (ISO 32000-1, Annex C)."""


def choose_page(needed_mm: tuple[float, float], page: str | None) -> tuple[float, float]:
    """Return width and height in mm of a page that holds ``needed_mm``, in the better orientation.

    Parameters
    ----------
    page
        A4 … A0, or WxH in mm (used unrotated); None chooses the smallest sufficient one of A4 … A0.

    Raises
    ------
    SettingsError
        If the page is unknown or too small; the message names a sufficient one.
    """
    sizes = None if page is None else _page_sizes(page)
    for width, height in sizes or [size for name in PAPERS_MM for size in _page_sizes(name)]:
        landscape = width > height
        if _is_large_enough(needed_mm, (width, height)):
            rotated = (height, width)
            is_better = landscape != (needed_mm[0] > needed_mm[1]) and _is_large_enough(needed_mm, rotated)
            return rotated if is_better and sizes != [(width, height)] else (width, height)
    limit = "more than A0" if page is None else f"more than page {page}"
    raise SettingsError(
        f"the board with margin, ruler and text needs {ceil(needed_mm[0])}×{ceil(needed_mm[1])} mm, {limit}; "
        f"give {_suggest_page(needed_mm)}smaller squares"
    )


def _page_sizes(page: str) -> list[tuple[float, float]]:
    """Return the possible sizes of a page: a named one in portrait or landscape."""
    if page.upper() in PAPERS_MM:
        width, height = PAPERS_MM[page.upper()]
        return [(width, height), (height, width)]
    match = re.fullmatch(r"(\d+(?:\.\d+)?)[x×](\d+(?:\.\d+)?)", page)
    size = (float(match[1]), float(match[2])) if match else (0.0, 0.0)
    if min(size) <= 0 or max(size) > LARGEST_MM:
        raise SettingsError(
            f"page {page!r} is not known; give {', '.join(PAPERS_MM)}, or WxH in mm up to {LARGEST_MM:g}, as 600x400"
        )
    return [size]


def _is_large_enough(needed: tuple[float, float], page: tuple[float, float]) -> bool:
    return needed[0] <= page[0] + 1e-9 and needed[1] <= page[1] + 1e-9


def _suggest_page(needed: tuple[float, float]) -> str:
    """Return the smallest sufficient page as text, or an empty text."""
    for name in PAPERS_MM:
        if any(_is_large_enough(needed, size) for size in _page_sizes(name)):
            return f"page {name}, or "
    size = ceil(needed[0]), ceil(needed[1])
    return f"page {size[0]}x{size[1]}, or " if max(size) <= LARGEST_MM else ""
