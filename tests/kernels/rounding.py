"""Instruction-set levels with the same rounding: all but those without a fused multiply-add."""

from __future__ import annotations

from beltscape.kernels.native import levels


def fusing_levels() -> tuple[str, ...]:
    """The levels that must give each other's bytes."""
    return tuple(level for level in levels() if level not in ("scalar", "v2"))


def first_alike(level: str) -> str:
    """The lowest level whose bytes are those of ``level``."""
    return fusing_levels()[0] if level in fusing_levels() else level
