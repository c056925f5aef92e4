"""The totals of a flow measurement with their standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.core.belt.sigma_parts import SigmaParts
from beltscape.measure.flow.records.profile import Stretch

Strip = tuple[float, float]


@dataclass(frozen=True, slots=True)
class FlowTotals:
    """Sums over all strips."""

    volume_mm3: float = 0.0
    sigma_mm3: float = 0.0
    mass_kg: float = 0.0
    """NaN as soon as one strip's density is unknown."""
    mass_sigma_kg: float = 0.0
    length_mm: float = 0.0
    """Length of belt that is counted."""
    seen_mm: float = 0.0
    """Part of this length that was in a frame's view."""
    bridged_mm: float = 0.0
    """Part of this length that was interpolated."""
    unseen_mm: float = 0.0
    """Length of belt that passed and is not counted, since it was neither in view nor bridged."""
    share: float = 0.0
    """Share of the counted belt that was measured in any frame."""
    single_share: float = 0.0
    """Share that one frame measures, on average."""
    first_strip_mm: Strip | None = None
    """The first frame's strip: all that was in view."""
    last_strip_mm: Strip | None = None
    """The last strip with a length."""


class Sums:
    """Sums over strips; common errors add linearly, independent errors in squares."""

    def __init__(self, drift_mm: float, width_mm: float) -> None:
        """``drift_mm`` are slow errors of depth, common to the whole belt of this width."""
        self._drift_mm2 = drift_mm * width_mm  # cross-section of slow depth errors over the belt's width
        self._width_mm = width_mm
        self._parts = SigmaParts()
        self._volume = self._mass = self._mass_common = 0.0
        self._length = self._seen = self._bridged = self._unseen = 0.0
        self._measured = self._single = 0.0
        self._first: Strip | None = None
        self._last: Strip | None = None

    def compute_fault_sigma(self, stretch: Stretch, systematic_mm: float, relative_sigma: float) -> float:
        """Return σ of the volume due to faults: a height error over the whole belt, and a relative error."""
        heights = systematic_mm * self._width_mm * (stretch.seen_mm + stretch.bridged_mm)
        return float(np.hypot(heights, relative_sigma * stretch.volume_mm3))

    def compute_sigma(self, stretch: Stretch, moved_mm3: float, fault_mm3: float) -> float:
        """Return σ of one strip's volume from its parts due to the surface, the position and the faults."""
        apart = stretch.apart_mm6 + moved_mm3**2
        return float((apart + self._compute_common_variance(stretch, fault_mm3)) ** 0.5)

    def compute_common_sigma(self, stretch: Stretch, fault_mm3: float) -> float:
        """Return the part of a strip's σ that it shares with other strips: edges, holes, slow drift and faults."""
        return float(self._compute_common_variance(stretch, fault_mm3) ** 0.5)

    def _compute_common_variance(self, stretch: Stretch, fault_mm3: float) -> float:
        drift = self._drift_mm2 * stretch.length_mm
        return stretch.edges_mm3**2 + stretch.holes_mm3**2 + drift**2 + fault_mm3**2

    def add(
        self, strip: Strip, stretch: Stretch, moved_mm3: float, fault_mm3: float, density: tuple[float, float]
    ) -> SigmaParts:
        """Add a strip with the parts of its σ due to position and faults; density and its σ in kg/m³.

        Return what it adds to the parts of σ.
        """
        counted = stretch.seen_mm + stretch.bridged_mm
        self._volume += stretch.volume_mm3
        apart_mm6, drift_mm3 = stretch.apart_mm6 + moved_mm3**2, self._drift_mm2 * counted
        parts = SigmaParts(apart_mm6, stretch.edges_mm3, stretch.holes_mm3, drift_mm3, fault_mm3)
        self._parts += parts
        self._mass += stretch.volume_mm3 * density[0] * 1e-9
        self._mass_common += stretch.volume_mm3 * density[1] * 1e-9
        self._length += counted
        self._seen += stretch.seen_mm
        self._bridged += stretch.bridged_mm
        self._unseen += stretch.length_mm - counted
        self._measured += stretch.share * stretch.length_mm
        self._single += stretch.single_share * stretch.length_mm
        if stretch.length_mm > 0:
            self._first = self._first or strip
            self._last = strip
        return parts

    @property
    def totals(self) -> FlowTotals:
        """Return the totals so far."""
        sigma = self._parts.sigma_mm3
        relative = sigma / self._volume if self._volume else 0.0
        return FlowTotals(
            volume_mm3=self._volume,
            sigma_mm3=sigma,
            mass_kg=self._mass,
            mass_sigma_kg=float(((self._mass * relative) ** 2 + self._mass_common**2) ** 0.5),
            length_mm=self._length,
            seen_mm=self._seen,
            bridged_mm=self._bridged,
            unseen_mm=self._unseen,
            share=self._measured / self._length if self._length else 0.0,
            single_share=self._single / self._length if self._length else 0.0,
            first_strip_mm=self._first,
            last_strip_mm=self._last,
        )
