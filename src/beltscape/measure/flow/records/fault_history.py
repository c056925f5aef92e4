"""The checks' last passes: from which frame on a fault may have been present before it was noticed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from beltscape.core.live.findings import Finding


@dataclass(slots=True)
class FaultHistory:
    """Remembers for each check and camera the last frame that passed it."""

    _passed: dict[tuple[str, str], int] = field(default_factory=dict)

    def add(self, number: int, findings: Iterable[Finding]) -> list[tuple[int, Finding]]:
        """Account for a frame's findings; return each fault with an effect and the first frame that it concerns.

        A check with the value NaN was not made; it neither passed nor failed.
        """
        out: list[tuple[int, Finding]] = []
        for finding in findings:
            key = finding.check, finding.subject
            if finding.effect != "none":
                since = number if finding.is_momentary else self._passed.get(key, -1) + 1
                out.append((min(since, number), finding))
            elif not np.isnan(finding.value):
                self._passed[key] = number
        return out
