"""How the doubts about a fit are printed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def format_findings(fit: Mapping[str, Any]) -> list[str]:
    """Return what speaks against a fit, one line each below a heading; empty for a sound fit."""
    return ["The fit is in doubt:", *(f"- {doubt}" for doubt in fit["doubts"]), ""] if fit["doubts"] else []
