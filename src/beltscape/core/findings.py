"""Findings of the system about itself: the difference of two quantities, its σ, and its effect on records."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.core.translatable_message import get_key

Effect = Literal["none", "degraded", "missing"]
"""Effect of a finding on the records of its frame:

none       within the limit, or without influence on the measured volume
degraded   the volume is counted with a larger σ, and the record is not called valid
missing    nothing was measured: the belt passed, its volume is counted nowhere
"""
EFFECTS: tuple[Effect, ...] = ("none", "degraded", "missing")
"""All effects, from harmless to severe."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check of one frame; it is reported with and without a fault, as a time series."""

    check: str
    """Name of the check, such as "zero_shift"; the alarm of a fault has the same name."""
    value: float
    """The quantity that was compared, in ``unit``; NaN: not measured this time."""
    sigma: float
    """One standard deviation of it; NaN: not known."""
    limit: float
    """The value beyond which, with its σ, it is a fault; NaN: the check has no limit."""
    unit: str
    subject: str = ""
    """The camera concerned; empty: the whole system."""
    text: str = ""
    """The fault and the fix in one line, as a `Message` that pages in other languages compose; empty: no fault."""
    effect: Effect = "none"
    systematic_mm: float = 0.0
    """One standard deviation of the height error common to the whole belt that the fault may cause."""
    relative_sigma: float = 0.0
    """One standard deviation of the volume's relative error that the fault may cause."""
    place: tuple[float, float, float, float] | None = None
    """Where the fault is in the subject's image: left, top, right, bottom as shares of its width and height, 0..1."""

    is_momentary: bool = False
    """Whether a fault concerns its own frame alone, as a repeated image does; else also those since the last pass."""

    @property
    def is_fault(self) -> bool:
        """Return whether the check found a fault."""
        return bool(self.text)

    @property
    def cause(self) -> str:
        """Return the key of the fault's text; empty without a fault, and for a text that exists in English only."""
        return get_key(self.text)


def has_fault(findings: Iterable[Finding], check: str, *subjects: str) -> bool:
    """Return whether a check found a fault of one of these subjects."""
    return any(one.check == check and one.subject in subjects and one.is_fault for one in findings)


def worst_effect(findings: Iterable[Finding]) -> Effect:
    """Return the most severe effect; "none" without findings."""
    return EFFECTS[max((EFFECTS.index(finding.effect) for finding in findings), default=0)]


def combine_systematic_mm(findings: Iterable[Finding]) -> float:
    """Return the root of the sum of squares of the height errors that the faults may cause, mm."""
    return float(np.sqrt(sum(finding.systematic_mm**2 for finding in findings)))


def combine_relative_sigma(findings: Iterable[Finding]) -> float:
    """Return the root of the sum of squares of the relative volume errors that the faults may cause."""
    return float(np.sqrt(sum(finding.relative_sigma**2 for finding in findings)))


def summarise_faults(findings: Iterable[Finding]) -> str:
    """Return the texts of the faults, the most severe first, separated by semicolons; empty without a fault."""
    faults = sorted((f for f in findings if f.is_fault), key=lambda f: -EFFECTS.index(f.effect))
    return "; ".join(dict.fromkeys(fault.text for fault in faults))
