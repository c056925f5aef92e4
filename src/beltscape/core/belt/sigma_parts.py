"""The parts of the uncertainty of a volume on the belt, which add up over strips."""

from __future__ import annotations

import operator
from dataclasses import astuple, dataclass


@dataclass(frozen=True, slots=True)
class SigmaParts:
    """The parts of σ of a volume; those of a longer stretch of belt are the sums of those of its strips.

    Common errors add linearly, independent ones in squares (GUM, JCGM 100:2008, 5.2.2).
    """

    apart_mm6: float = 0.0
    """Variance of errors that are independent from strip to strip."""
    edges_mm3: float = 0.0
    """σ of the common displacement of all edges."""
    holes_mm3: float = 0.0
    """σ of the common error of all filled holes."""
    drift_mm3: float = 0.0
    """σ of slow errors of depth, common to the whole belt."""
    faults_mm3: float = 0.0
    """σ of the faults that were found, common to all strips."""

    def __add__(self, other: SigmaParts) -> SigmaParts:
        return SigmaParts(*map(operator.add, astuple(self), astuple(other)))

    @property
    def sigma_mm3(self) -> float:
        """Return one standard deviation of the volume."""
        common = self.drift_mm3**2 + self.faults_mm3**2
        return float((self.apart_mm6 + self.edges_mm3**2 + self.holes_mm3**2 + common) ** 0.5)
