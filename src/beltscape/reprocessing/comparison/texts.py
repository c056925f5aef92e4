"""Sentences and numbers of a comparison, the same in the terminal and on the page; and the terminal summary."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np

from beltscape.reprocessing.comparison.comparison import Comparison, PairedTotal
from beltscape.reprocessing.comparison.differences import (
    NO_RECORD,
    BeltPart,
    DifferencePattern,
    DifferingStretch,
    StretchSide,
)
from beltscape.reprocessing.comparison.segments import EDGE_MM
from beltscape.reprocessing.comparison.uncertainty import COVERAGE_FACTOR

_EPOCH_NS = 10**17
"""A time above it (1973) is of a clock since 1970; others count from a camera's or a recording's start."""
_LITRES_MM3 = 1e9
"""Below one cubic metre volumes are given in litres."""
_UNIT = re.compile(r"_(kg_m3|mm_s|mm3|mm2|mm|ns)$")
"""The unit at the end of a column's name."""
_SAME = 1 - 1e-9
"""Share of belt that is all of it, but for rounding."""


def choose_volume_unit(comparison: Comparison) -> tuple[str, float]:
    """Return the unit for the volumes of a comparison, and a mm³ in it."""
    largest = max(abs(comparison.volume.first), abs(comparison.volume.second))
    return ("l", 1e-6) if largest < _LITRES_MM3 else ("m³", 1e-9)


def format_with_sigma(value: float, sigma: float, *, sign: str = "") -> str:
    """Return ``value ± sigma`` with two digits of σ; ``sign`` "+" shows the sign always."""
    if not math.isfinite(sigma):
        return f"{value:{sign}.6g} ± ?"
    if sigma <= 0:
        return f"{value:{sign}.6g} ± 0"
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:{sign}.{digits}f} ± {sigma:.{digits}f}"


def format_time(time_ns: int | None) -> str:
    """Return a trigger time: UTC, or seconds of a clock that does not count since 1970; empty if not known."""
    if time_ns is None:
        return ""
    if time_ns < _EPOCH_NS:
        return f"{time_ns * 1e-9:.1f} s"
    return datetime.fromtimestamp(time_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def has_epoch(time_ns: int) -> bool:
    """Return whether a time counts since 1970."""
    return time_ns >= _EPOCH_NS


def make_verdict(comparison: Comparison) -> str:
    """Return the result in one sentence."""
    columns, length = comparison.first.columns, comparison.compared_mm / 1000
    if comparison.is_identical:
        return f"A and B are identical to the last digit: {len(columns)} records, {length:.1f} m of measured belt."
    volume = comparison.volume
    if volume.difference == 0 and _has_same_volumes(comparison):
        return (
            f"A and B have the same volumes to the last digit on {length:.1f} m of belt, and differ in "
            f"{list_differing(comparison)}."
        )
    change = f"B - A = {describe_difference(comparison)} on the {length:.1f} m of belt that both measured"
    if volume.agrees is None:
        return f"It cannot be judged whether B agrees with A, because strips without a σ are in it: {change}."
    if volume.agrees:
        return f"B agrees with A within the uncertainty of their difference: {change}."
    sigmas = abs(volume.difference) / volume.difference_sigma if volume.difference_sigma else math.inf
    times = f"{sigmas:.3g} σ" if math.isfinite(sigmas) else "σ is 0"
    return f"B differs from A beyond the uncertainty of their difference ({times}): {change}."


def describe_difference(comparison: Comparison) -> str:
    """Return the difference of the volumes with σ, unit and share."""
    unit, factor = choose_volume_unit(comparison)
    volume = comparison.volume
    text = format_with_sigma(volume.difference * factor, volume.difference_sigma * factor, sign="+")
    return f"{text} {unit} ({format_relative(volume)})"


def format_relative(total: PairedTotal) -> str:
    """Return a difference in per cent of the first total, with its σ."""
    if not total.first:
        return "of nothing"
    sigma = total.difference_sigma / abs(total.first)
    return f"{format_with_sigma(100 * total.relative, 100 * sigma, sign='+')} %"


def _has_same_volumes(comparison: Comparison) -> bool:
    return not {"records", "volume_mm3", "from_mm", "to_mm", "standing"} & comparison.differing.keys()


def list_differing(comparison: Comparison) -> str:
    """Return the columns that differ, with the number of records."""
    return ", ".join(f"{_name_column(name)} ({count})" for name, count in comparison.differing.items())


def _name_column(name: str) -> str:
    words = {"records": "number of records", "from_mm": "beginning on the belt", "to_mm": "end on the belt"}
    return words.get(name) or _UNIT.sub("", name).replace("_", " ")


def explain_sigma(comparison: Comparison) -> str:
    """Return which σ the difference has, and why."""
    share = comparison.same_rig_mm / comparison.compared_mm
    own = (
        "the strips' own errors come from the same images and are taken as independent, which is an upper limit "
        "(GUM 5.2.2, F.1.2)"
    )
    shared = "the errors that strips share (edges, holes, slow drift)"
    same = f"{shared} are one error on both sides and cancel but for the difference of their amounts"
    other = f"{shared} are taken as independent and add in squares"
    if share >= _SAME:
        return f"σ of the difference: rig and empty belt are the same, so {same}; {own}."
    if share == 0:
        return f"σ of the difference: rig or empty belt are not the same, or not recorded, so {other}; {own}."
    return (
        f"σ of the difference: on {100 * share:.1f} % of the belt rig and empty belt are the same: {same}; elsewhere "
        f"{other}; {own}."
    )


def compare_with_totals(comparison: Comparison) -> str:
    """Return whether a change that is real also matters against the uncertainty of the totals; empty if not asked."""
    volume = comparison.volume
    if volume.agrees is not False:
        return ""
    sigma = max(volume.first_sigma, volume.second_sigma)
    if abs(volume.difference) <= COVERAGE_FACTOR * sigma:
        return "The difference is real, and smaller than twice the σ of the totals themselves."
    return "The difference is larger than twice the σ of the totals themselves."


def explain_causes(comparison: Comparison) -> Iterator[str]:
    """Yield what differs in the provenance, and what follows from it."""
    differing = [one for one in comparison.provenance if one.differing_mm]
    yield from (one.sentence for one in differing)
    same = [one for one in comparison.provenance if not one.differing_mm]
    yield from (one.sentence for one in same)
    if comparison.is_identical:
        return
    if comparison.pattern is not None:
        yield describe_pattern(comparison.pattern)
    if not {one.part for one in differing} & {"program", "rig", "empty", "settings"}:
        yield (
            "Program, rig, empty belt and settings do not explain a difference of the volumes: other frames, another "
            "machine, or what no provenance records"
        )


def describe_pattern(pattern: DifferencePattern) -> str:
    """Return the pattern of the differences, and what has such a pattern."""
    if pattern.kind == "proportional":
        share = format_with_sigma(100 * pattern.value, 100 * pattern.sigma, sign="+")
        return f"pattern: B differs from A by {share} % of the load everywhere, as by a calibration of other scale"
    area = format_with_sigma(pattern.value / 100, pattern.sigma / 100, sign="+")
    return (
        f"pattern: B differs from A by {area} cm² of cross-section everywhere, whatever the load, as by another "
        "empty belt or zero"
    )


def describe_change(part: BeltPart) -> str:
    """Return a changed standing in words, such as ``valid → degraded``."""
    return f"{part.first} → {part.second}"


def describe_reasons(part: BeltPart) -> str:
    """Return the reasons of a changed standing with their lengths."""
    known = [f"{_join(pair.first, pair.second)} ({pair.length_mm / 1000:.2f} m)" for pair in part.reasons]
    if part.more_reasons:
        known.append(f"{part.more_reasons} more")
    if not known and NO_RECORD in (part.first, part.second):
        return "only one of the ledgers has it"
    return "; ".join(known)


def _join(first: str, second: str) -> str:
    if first == second:
        return f"both ledgers: {first}"
    texts = (
        f"{name}: {text}" if text else f"{name} gives no reason"
        for name, text in (("A", first), ("B", second))
    )
    return ", ".join(texts)


def describe_sides(stretch: DifferingStretch) -> str:
    """Return frames, standings and reasons of a stretch, once where both ledgers have the same."""
    first, second = _describe_side(stretch.first), _describe_side(stretch.second)
    return f"both ledgers: {first}" if first == second else f"A: {first}; B: {second}"


def _describe_side(side: StretchSide) -> str:
    count = "frame" if side.first_frame == side.last_frame else "frames"
    frames = dict.fromkeys((side.first_frame, side.last_frame))
    reasons = f" ({'; '.join(side.reasons)})" if side.reasons else ""
    return f"{count} {' … '.join(frames)}, {' and '.join(side.standings)}{reasons}"


def describe_alignment(comparison: Comparison) -> str:
    """Return how both ledgers were laid along the belt."""
    aligned = comparison.alignment
    text = f"{aligned.shared_frames} frames of the same name and time"
    if aligned.spread_mm > EDGE_MM:
        return (
            f"{text}; the counts differ by {aligned.offset_mm / 1000:+.3f} m, which varies by "
            f"{aligned.spread_mm:.1f} mm, so B is laid on A frame by frame"
        )
    return (
        f"{text}; the counts differ by {aligned.offset_mm / 1000:+.3f} m all along"
        if aligned.offset_mm
        else text
    )


def list_warnings(comparison: Comparison) -> Iterator[str]:
    """Yield what limits the comparison."""
    for name, whole in zip("AB", comparison.wholes, strict=True):
        if whole.alone_mm > 0:
            unit, factor = choose_volume_unit(comparison)
            yield (
                f"Only {name} has {whole.alone_mm / 1000:.2f} m of measured belt, with "
                f"{whole.alone_mm3 * factor:.4g} {unit}; it is in no difference."
            )
    if comparison.mass is None:
        lengths = zip("AB", comparison.without_density_mm, strict=True)
        where = " and ".join(f"{name} on {mm / 1000:.1f} m" for name, mm in lengths if mm > 0)
        yield f"Masses are left out: no density is known, in {where}."
    if comparison.alignment.spread_mm > EDGE_MM:
        yield f"The belt was aligned by {describe_alignment(comparison)}."


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
