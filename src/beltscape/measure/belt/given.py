"""A learned belt limited to the ends or the width that the engineer gives, and what remains unknown of its ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.empty_belt import Belt, BeltEdges, End
from beltscape.core.errors import MeasureError
from beltscape.measure.belt.settings import GivenBelt

_WIDTH_SHARE, _WIDTH_MM = 0.02, 10.0
"""A belt differs from its width as ordered by less than this share and this length: belts are made to ±1 % (ISO 251)
and their ends are found to some mm."""
_GIVEN_SIGMA_MM = 5.0
"""One standard deviation of an end that was given, or that follows from a given width; chosen."""
_FIX = "give --across A B, its ends in mm of the belt frame"
UNKNOWN: tuple[End, ...] = ("covered", "unmeasured", "out of view")
"""Ends of which it is not known where the belt ends."""


def apply_given(belt: Belt, given: GivenBelt) -> Belt:
    """Return the belt with the ends that are given, or that follow from its width.

    Raises
    ------
    MeasureError
        if the belt was not measured between the ends given, or the width does not tell where the ends are.
    """
    if given.across_mm is not None:
        return _limit(belt, given.across_mm, ("told", "told"))
    if given.width_mm is not None:
        return replace(_apply_width(belt, given.width_mm), width_mm=given.width_mm)
    return belt


def describe_doubts(belt: Belt) -> tuple[str, ...]:
    """Return what is not known of the belt's direction and its ends, or only by a given width, each with its fix."""
    doubts = (_describe_unknown_direction(belt), _describe_unknown_ends(belt), _describe_given_width(belt))
    return tuple(text for text in doubts if text)


def _describe_unknown_direction(belt: Belt) -> str | None:
    """Return that a flat belt without edges in view does not show its direction of travel; None for any other."""
    if belt.yaw_from != "camera":
        return None
    return (
        "the empty belt is flat and no edge of it was seen: its direction of travel is taken for that of the core "
        "image's columns; if it runs at an angle to them, beltscape measure belt --travel DEG says so"
    )


def _describe_unknown_ends(belt: Belt) -> str | None:
    """Return what is not known of the belt's ends, with the fix; None where both are known, or in older files."""
    if belt.ends is None or not set(belt.ends) & set(UNKNOWN):
        return None
    low, high = belt.across_mm
    reasons: dict[End, str] = {
        "covered": "something stands as high or higher beside it",
        "unmeasured": "nothing was measured beyond it",
        "out of view": "it reaches the image's border",
    }
    texts = [
        f"{side} end was not seen (up to x {at:.0f} mm {reasons[end]})"
        for side, at, end in (("left", low, belt.ends[0]), ("right", high, belt.ends[1]))
        if end in reasons
    ]
    return (
        f"the empty belt's {' and its '.join(texts)}: what lies beyond is not measured; where the belt is, "
        "beltscape measure belt --width MM, --across A B or --region says"
    )


def _describe_given_width(belt: Belt) -> str | None:
    """Return where the belt lies if its given width, and no end that was seen, says so; else None."""
    if belt.width_mm is None or belt.ends != ("told", "told"):
        return None
    low, high = belt.across_mm
    return (
        f"the empty belt's ends follow from its width of {belt.width_mm:g} mm about the trough's middle, x {low:.0f} "
        f"to {high:.0f} mm, and not from what was seen; see the report's picture"
    )


def measure_width_mm(belt: Belt) -> float:
    """Return the width along the belt's surface, between its ends ``across_mm``."""
    return float(_run(belt)[-1])


def _run(belt: Belt) -> NDArray[np.float64]:
    """Return the length (K,) along the surface from the first node."""
    return np.r_[0.0, np.cumsum(np.hypot(np.diff(belt.x_mm), np.diff(belt.z_mm)))]


def _apply_width(belt: Belt, width_mm: float) -> Belt:
    """Return the belt with its unknown ends placed by its width; a width that contradicts seen ends replaces them."""
    run, (left, right) = _run(belt), belt.ends or ("out of view", "out of view")
    known, excess = [end in ("seen", "told") for end in (left, right)], float(run[-1]) - width_mm
    kinds: tuple[End, End]
    if all(known) and abs(excess) <= _WIDTH_SHARE * width_mm + _WIDTH_MM:
        return belt
    if known[0] and not known[1]:
        start = _edge_run(belt, run, 0)
        kinds = (left, "inferred")
    elif known[1] and not known[0]:
        start = _edge_run(belt, run, 1) - width_mm
        kinds = ("inferred", right)
    elif excess < 0 and all(known):
        raise MeasureError(
            f"empty belt: both its ends were seen, {run[-1]:.0f} mm apart along its surface, but its width is given "
            f"as {width_mm:g} mm; give the width of this belt, or {_FIX}"
        )
    else:
        start = _middle_run(belt, run, width_mm) - 0.5 * width_mm
        kinds = ("told", "told")
    ends = tuple(_prolonged_x(belt, run, at) for at in (start, start + width_mm))
    return _limit(belt, (ends[0], ends[1]), kinds)


def _edge_run(belt: Belt, run: NDArray[np.float64], side: int) -> float:
    """Return the length along the surface up to the edge that was located, or up to the outermost node."""
    edge = np.nan if belt.edges is None else (belt.edges.left_mm, belt.edges.right_mm)[side]
    if not np.isfinite(edge):
        return float(run[0 if side == 0 else -1])
    slope = np.diff(run) / np.diff(belt.x_mm)
    near, at, per_mm = (0, run[0], slope[0]) if side == 0 else (-1, run[-1], slope[-1])
    return float(at + per_mm * (edge - belt.x_mm[near]))


def _middle_run(belt: Belt, run: NDArray[np.float64], width_mm: float) -> float:
    """Return the length along the surface up to the trough's middle; MeasureError for a belt without a trough."""
    if belt.yaw_from != "shape":
        raise MeasureError(
            f"empty belt: a flat belt {run[-1]:.0f} mm wide as far as it was measured, neither end of which fits the "
            f"width of {width_mm:g} mm: which part of it is the belt does not follow; {_FIX}"
        )
    return float(np.interp(belt.middle_mm, belt.x_mm, run))


def _prolonged_x(belt: Belt, run: NDArray[np.float64], at: float) -> float:
    """Return x at a length along the surface, prolonged by the outermost slopes."""
    x = belt.x_mm
    if at < run[0]:
        return float(x[0] + (at - run[0]) * (x[1] - x[0]) / (run[1] - run[0]))
    if at > run[-1]:
        return float(x[-1] + (at - run[-1]) * (x[-1] - x[-2]) / (run[-1] - run[-2]))
    return float(np.interp(at, run, x))


def _limit(belt: Belt, across_mm: tuple[float, float], kinds: tuple[End, End]) -> Belt:
    """Return the belt between two ends: measured where it was measured, ending where it is said to."""
    low, high = max(across_mm[0], belt.across_mm[0]), min(across_mm[1], belt.across_mm[1])
    inside = (belt.x_mm > low) & (belt.x_mm < high)
    if low >= high or inside.sum() < 3:
        raise MeasureError(
            f"empty belt: nothing was measured between x {across_mm[0]:.0f} and {across_mm[1]:.0f} mm; the surface "
            f"reaches from {belt.across_mm[0]:.0f} to {belt.across_mm[1]:.0f} mm: {_FIX}"
        )
    x = np.r_[low, belt.x_mm[inside], high]
    flat = belt.flat_mm
    if flat is not None:
        flat = (max(flat[0], low), min(flat[1], high))
    return replace(
        belt,
        x_mm=x,
        z_mm=np.interp(x, belt.x_mm, belt.z_mm),
        z_sigma_mm=np.interp(x, belt.x_mm, belt.z_sigma_mm),
        across_mm=(low, high),
        flat_mm=None if flat is None or flat[0] >= flat[1] else flat,
        edges=_place_edges(belt, across_mm, kinds),
        ends=kinds,
    )


def _place_edges(belt: Belt, across_mm: tuple[float, float], kinds: tuple[End, End]) -> BeltEdges:
    """Return the edges: those that were seen, and those that were given."""
    seen = belt.edges or BeltEdges(*[np.nan] * 6, against="trough")
    own = (seen.left_mm, seen.right_mm), (seen.left_sigma_mm, seen.right_sigma_mm)
    (left, left_sigma), (right, right_sigma) = (
        (own[0][side], own[1][side]) if kinds[side] == "seen" else (across_mm[side], _GIVEN_SIGMA_MM)
        for side in (0, 1)
    )
    offset = 0.5 * (left + right) - belt.middle_mm if "told" not in kinds else np.nan
    sigma = 0.5 * float(np.hypot(left_sigma, right_sigma)) if "told" not in kinds else np.nan
    return BeltEdges(left, right, left_sigma, right_sigma, float(offset), sigma, "trough")
