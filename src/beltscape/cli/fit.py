"""Findings against a fit, formatted for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def format_findings(fit: Mapping[str, Any]) -> list[str]:
    """Return the findings against a fit, one line each below a heading; empty for a sound fit."""
    return (
        ["The fit is in doubt:", *(f"- {finding}" for finding in fit["doubts"]), ""] if fit["doubts"] else []
    )
