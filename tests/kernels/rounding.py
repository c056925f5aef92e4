"""Instruction-set levels with the same rounding: all but those without a fused multiply-add."""

from __future__ import annotations

from beltscape.kernels.cuda.emulated_device import is_emulation_built
from beltscape.kernels.native import levels


def fusing_levels() -> tuple[str, ...]:
    """The levels that must give each other's bytes."""
    return tuple(level for level in levels() if level not in ("scalar", "v2"))


def first_alike(level: str) -> str:
    """The lowest level whose bytes are those of ``level``."""
    fuses = level in fusing_levels() or (level.startswith("emulated") and fusing_levels())
    return fusing_levels()[0] if fuses else level


def emulated() -> tuple[str, ...]:
    """The emulated GPU in the order of the threads' numbers and in another one; nothing where it is not built."""
    return ("emulated", "emulated-1") if is_emulation_built() else ()


ROUNDED = "average_windows", "evaluate_expression"
"""Cases of the self-test whose last digits are those of OpenCV, and of logarithms of two libraries."""
