"""Arguments that several commands share."""

from __future__ import annotations

from collections.abc import Sequence

from beltscape.core.errors import SettingsError


def ordered_range(option: str, values: Sequence[float] | None) -> tuple[float, float] | None:
    """Two numbers, the smaller one first, or None where the option was not given."""
    if values is None:
        return None
    low, high = values
    if not low < high:
        raise SettingsError(f"{option} {low:g} {high:g}: the first number must be the smaller one")
    return low, high


def positive_range(option: str, values: Sequence[float] | None) -> tuple[float, float] | None:
    """The same for lengths that must be positive."""
    pair = ordered_range(option, values)
    if pair is not None and pair[0] <= 0:
        raise SettingsError(f"{option} {pair[0]:g} {pair[1]:g}: both numbers must be positive")
    return pair
