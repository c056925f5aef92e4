"""The terminal summary of a comparison."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beltscape.reprocessing.comparison.comparison import Comparison, PairedTotal
from beltscape.reprocessing.comparison.presentation.texts import (
    choose_volume_unit,
    compare_with_totals,
    describe_alignment,
    describe_change,
    describe_reasons,
    describe_sides,
    explain_causes,
    explain_sigma,
    format_relative,
    format_time,
    format_with_sigma,
    list_warnings,
    make_verdict,
)

_STRETCHES = 3
"""Stretches that the terminal shows; report and document have ten. Chosen."""


def summarise(comparison: Comparison) -> str:
    """Return the result in lines of the terminal."""
    return "\n".join(_list_lines(comparison))


def _list_lines(comparison: Comparison) -> Iterator[str]:
    yield make_verdict(comparison)
    yield f"A            {comparison.first.folder}"
    yield f"B            {comparison.second.folder}"
    yield f"aligned by   {describe_alignment(comparison)}"
    unit, factor = choose_volume_unit(comparison)
    yield from _list_total("volume", unit, comparison.volume, factor)
    if comparison.mass is not None:
        yield from _list_total("mass", "t", comparison.mass, 1e-3)
    if comparison.is_identical:
        return
    if text := compare_with_totals(comparison):
        yield text
    yield explain_sigma(comparison)
    yield from _list_places(comparison, factor, unit)
    yield "why:"
    yield from (f"  {line}" for line in explain_causes(comparison))
    yield from list_warnings(comparison)


def _list_total(name: str, unit: str, total: PairedTotal, factor: float) -> Iterator[str]:
    rows = (
        ("A", total.first, total.first_sigma, ""),
        ("B", total.second, total.second_sigma, ""),
        ("B - A", total.difference, total.difference_sigma, "+"),
    )
    for side, value, sigma, sign in rows:
        share = f"  ({format_relative(total)})" if sign else ""
        yield f"{name:<6} {side:<5} {format_with_sigma(value * factor, sigma * factor, sign=sign)} {unit}{share}"


def _list_places(comparison: Comparison, factor: float, unit: str) -> Iterator[str]:
    volume = comparison.intervals.volume
    filled = volume.length_mm > 0
    beyond = int(np.count_nonzero(filled & ~volume.agrees))
    yield f"{beyond} of {int(filled.sum())} intervals differ beyond 2 σ"
    for part in comparison.changes:
        reasons = describe_reasons(part)
        yield f"  {describe_change(part)}: {part.length_mm / 1000:.2f} m{f': {reasons}' if reasons else ''}"
    for one in comparison.stretches[:_STRETCHES]:
        value = format_with_sigma(one.difference_mm3 * factor, one.sigma_mm3 * factor, sign="+")
        time = format_time(one.time_ns)
        yield (
            f"  {one.from_mm / 1000:.2f} … {one.to_mm / 1000:.2f} m{f', {time}' if time else ''}: {value} {unit}; "
            f"{describe_sides(one)}"
        )
