"""What one look at the readings says of one alarm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Condition = Literal["on", "off", "between", "unknown"]
"""past the limit; back beyond the clear limit; between the two; nobody knows"""

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Finding:
    """One alarm's condition at one moment, and what it was judged by."""

    condition: Condition
    value: float = _NAN
    """In ``unit``; NaN where that is no number."""
    limit: float = _NAN
    unit: str = ""
    said: str = ""
    """What somebody else says of it, in one line; it stands in for the alarm's own text."""
    after_s: float | None = None
    """A delay of its own until it is raised, in place of the setting's."""
    clear_after_s: float | None = None
    """The same until it is over."""


def above(value: float, sigma: float, limit: float, hysteresis: float, sigmas: float = 0.0) -> Condition:
    """How a value stands to an upper limit.

    On where value - sigmas·σ > limit: an uncertain value must be past it by its uncertainty. Off where the value
    itself is at most limit·(1 - hysteresis). So nothing changes from there up to limit + sigmas·σ, and the wider σ
    the wider is that band. A σ that is not known counts as 0; a value that is not finite is not known.
    """
    return _above(value, sigma, limit, limit * (1 - hysteresis), sigmas)


def below(value: float, sigma: float, limit: float, hysteresis: float, sigmas: float = 0.0) -> Condition:
    """How a value stands to a lower limit: on where value + sigmas·σ < limit, off from limit·(1 + hysteresis)."""
    return _above(-value, sigma, -limit, -limit * (1 + hysteresis), sigmas)


def told(trouble: str | None) -> Finding:
    """Of a trouble that is told in words: on where there is one, off where it is empty, unknown for None."""
    if trouble is None:
        return Finding("unknown")
    return Finding("on", said=trouble) if trouble else Finding("off")


def worst(findings: Sequence[Finding]) -> Finding:
    """Several limits of one alarm: on by any; off only if all are known to be off. Told by the first such."""
    if not findings:
        return Finding("unknown")
    order: tuple[Condition, ...] = ("on", "unknown", "between", "off")
    return min(findings, key=lambda one: order.index(one.condition))


def _above(value: float, sigma: float, limit: float, clear: float, sigmas: float) -> Condition:
    if not math.isfinite(value):
        return "unknown"
    spread = sigmas * sigma if sigmas > 0 and not math.isnan(sigma) else 0.0
    if value - spread > limit:
        return "on"
    return "off" if value <= clear else "between"
