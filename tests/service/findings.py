"""Dirt on a window, as the checks of images find it."""

from __future__ import annotations

from beltscape.core.findings import Finding
from beltscape.core.translatable_message import Message

PLACE = (0.5, 0.2, 0.75, 0.5)
"""Left, top, right, bottom."""
DIRT = Finding(
    "dirt", 6.2, 0.5, 2.0, "%", "cam2", Message("cam2: dirt at the marked place", "dirt", area=6.2, taken=40),
    "degraded", place=PLACE,
)  # fmt: skip
