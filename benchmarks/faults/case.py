"""A row of the bench: a fault, what is promised about it, and how it is put before the running system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Case:
    """A fault of one size."""

    name: str
    promised: str
    """In the words of the table."""
    within_s: float
    """Time from the fault to the alarm or finding that names it."""
    named_by: tuple[str, ...]
    """Names of alarms or checks, any of which names the fault: with or without the camera after ":", or a beginning
    with "*"."""
    faults: Mapping[str, Any] = field(default_factory=dict)
    """The table [faults] of a scene, without ``first``, which is the row's."""
    rendered: str = ""
    """Camera whose images are rendered anew with the fault, "*": all; empty: the fault is applied to the images."""
    replaced: str = ""
    """What the project names is another one, or damaged: a key of `replacements.REPLACEMENTS`."""
    disturbed: str = ""
    """What happens to the running system's files when the fault begins: a key of `disturbances.DISTURBANCES`."""
    zero_faults: Mapping[str, Any] = field(default_factory=dict)
    """The table [faults] with which the empty belt was rendered when the zero was learned: wrong from the start."""
    allows_valid: bool = False
    """Whether valid records may go on, because the fault harms nothing or is covered by σ."""
    rounds: float = 5.0
    """Duration after the fault, in rounds of the capture."""
    least_rounds: float = 0.0
    """Rounds after the fault that the row needs, also where fewer are asked for."""
    step_mm: float | None = None
    """Travel of the belt between frame sets from the fault on: only so many are delivered; None: all."""
    rolls_back_mm: float = 0.0
    """Distance by which the belt rolls back, after it stood for some frames; then it runs on. No fault: belts do."""
    rests_s: float = 0.0
    """Time for which the belt stands before the fault begins. No fault: belts do."""
    stays_s: float = 0.0
    """Time for which it goes on to stand afterwards, before it runs on."""
    begins_after: float = 0.0
    """Share of a round after which the fault begins: where nothing is in view, or a heap."""
    from_start: bool = False
    """Whether the fault of the images is there from the first frame on, before any check has learned anything."""
    trends: Mapping[str, float] = field(default_factory=dict)
    """True values of checks at the end: their findings must agree within 2.5 σ."""
    belt_width_mm: float | None = None
    """Width of the belt where its edges must be in view; None: that of the other rows."""
    is_short: bool = False
    """Whether it belongs to the short form."""
    needs_full_size: bool = False
    """Whether it shows only in images that resolve the projected dots: small ones have no recognisable pattern."""

    @property
    def is_sound(self) -> bool:
        """Return whether nothing is wrong: any alarm is a false accusation."""
        return not (self.faults or self.zero_faults or self.replaced or self.disturbed or self.step_mm)

    @property
    def is_wrong_from_start(self) -> bool:
        """Return whether the fault is there before the first frame."""
        return bool(self.zero_faults or self.replaced or self.from_start)

    def is_named_by(self, name: str) -> bool:
        """Return whether an alarm or check of this name names the fault."""
        kind = name.split(":", maxsplit=1)[0]
        return any(
            kind.startswith(one[:-1]) if one.endswith("*") else one in (kind, name) for one in self.named_by
        )
