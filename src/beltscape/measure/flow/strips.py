"""Strips of belt: the queue of those not yet finished, their flow records, and the totals with their σ."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from beltscape.core.findings import (
    EFFECTS,
    Finding,
    combine_relative_sigma,
    combine_systematic_mm,
    summarise_faults,
    worst_effect,
)
from beltscape.core.ledger import FlowRecord, Quality, SigmaParts
from beltscape.measure.flow.density import Density
from beltscape.measure.flow.profile import Profile, Stretch, make_unmeasured_stretch

StripEnds = tuple[float, float]
ALL_LENGTHS = 3
"""The lengths of a volume. All of them follow the rig's scale, with an encoder, too: the motion of the material that
the cameras see places the frames, and the encoder's steps are divided by its ratio to that motion. Measured with rigs
scaled by 0.1 to 1 %: volumes follow with the power 2.95 to 3.01."""
ENCODER_LENGTHS = 2
"""The same where the encoder alone measures the belt, because its material has never shown a motion."""


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
    first_strip_mm: StripEnds | None = None
    """The first frame's strip: all that was in view."""
    last_strip_mm: StripEnds | None = None
    """The last strip with a length."""


class StripSums:
    """Sums over strips; common errors add linearly, independent errors in squares."""

    def __init__(self, drift_mm: float, width_mm: float, scale_sigma: float = 0.0) -> None:
        """``drift_mm`` are slow errors of depth, common to the whole belt of this width.

        ``scale_sigma`` is the relative σ of the rig's lengths (`Strip.scaled_lengths`).
        """
        self._scale_sigma = scale_sigma
        self._drift_mm2 = drift_mm * width_mm  # cross-section of slow depth errors over the belt's width
        self._width_mm = width_mm
        self._parts = SigmaParts()
        self._volume = self._mass = self._mass_common = 0.0
        self._length = self._seen = self._bridged = self._unseen = 0.0
        self._measured = self._single = 0.0
        self._first: StripEnds | None = None
        self._last: StripEnds | None = None

    def compute_fault_sigma(self, stretch: Stretch, systematic_mm: float, relative_sigma: float) -> float:
        """Return σ of the volume due to faults: a height error over the belt and a relative one."""
        heights = systematic_mm * self._width_mm * (stretch.seen_mm + stretch.bridged_mm)
        return float(np.hypot(heights, relative_sigma * stretch.volume_mm3))

    def compute_parts(
        self, stretch: Stretch, moved_mm3: float, fault_mm3: float, scaled_lengths: int
    ) -> SigmaParts:
        """Return the parts of σ of one strip's volume, given those due to its position and to faults."""
        return SigmaParts(
            apart_mm6=stretch.apart_mm6 + moved_mm3**2,
            edges_mm3=stretch.edges_mm3,
            holes_mm3=stretch.holes_mm3,
            drift_mm3=self._drift_mm2 * (stretch.seen_mm + stretch.bridged_mm),
            faults_mm3=fault_mm3,
            scale_mm3=scaled_lengths * self._scale_sigma * abs(stretch.volume_mm3),
        )

    def add(
        self, strip: StripEnds, stretch: Stretch, parts: SigmaParts, density: tuple[float, float]
    ) -> None:
        """Add a strip with the parts of its σ; density and its σ in kg/m³."""
        counted = stretch.seen_mm + stretch.bridged_mm
        self._volume += stretch.volume_mm3
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


_MIN_SHARE = 0.7
"""Least measured share of a strip that counts as fully measured."""
_MIN_PART = 0.05
"""Smaller parts of a strip do not affect its quality."""


@dataclass(slots=True)
class Strip:
    """The belt that became new in one frame."""

    frame: str
    time_ns: int | None
    belt_position_mm: float
    """Position for the record; NaN if unknown."""
    start_mm: float
    end_mm: float
    """In belt coordinates."""
    step_sigma_mm: float
    """One standard deviation of the strip's length."""
    speed_mm_s: float
    """NaN if unknown."""
    placed: bool
    """Whether the belt's position was known."""
    reliable: bool
    """Whether the position came from material or encoder, not from the last known speed, with all images present."""
    number: int = 0
    """Number of the frame since the start."""
    view_start_mm: float = np.inf
    """Beginning of the belt that its frame measured, in belt coordinates; infinite: the frame measured nothing."""
    scaled_lengths: int = ALL_LENGTHS
    """Number of its three lengths that are in proportion to the rig's scale."""
    is_void: bool = False
    """Whether it counts as not measured, because what was measured of it cannot be separated from a fault."""
    systematic_mm: float = 0.0
    """Largest error common to all pixels of a depth map that measured it; a finding may state the same error."""
    findings: dict[tuple[str, str], Finding] = field(default_factory=dict)
    """By check and camera, the findings that concern its measurement."""
    lost_to: dict[tuple[str, str], Finding] = field(default_factory=dict)
    """By check and camera, the faults for which its own frame was not measured."""

    def add_finding(self, finding: Finding) -> None:
        """Account for a finding about its measurement; of several of one check the most severe counts."""
        _keep_most_severe(self.findings, finding)

    def add_loss(self, finding: Finding) -> None:
        """Account for a fault for which its own frame was not measured."""
        _keep_most_severe(self.lost_to, finding)


def _keep_most_severe(findings: dict[tuple[str, str], Finding], finding: Finding) -> None:
    key = finding.check, finding.subject
    before = findings.get(key)
    if before is None or _severity(finding) >= _severity(before):
        findings[key] = finding


def _severity(finding: Finding) -> tuple[int, float, float]:
    return EFFECTS.index(finding.effect), finding.systematic_mm, finding.relative_sigma


class Strips:
    """A queue of strips in the order of the frames; each becomes a record when its profile is complete."""

    def __init__(self, sums: StripSums, density: Density) -> None:
        """Records are also counted in ``sums``."""
        self._sums, self._density = sums, density
        self._waiting: deque[Strip] = deque()

    def add(self, strip: Strip) -> None:
        """Append the next frame's strip."""
        self._waiting.append(strip)

    def __iter__(self) -> Iterator[Strip]:
        """Iterate over the waiting strips in order."""
        return iter(self._waiting)

    @property
    def first(self) -> Strip | None:
        """Return the strip that waits longest."""
        return self._waiting[0] if self._waiting else None

    def pop_finished(self, profile: Profile, until_mm: float) -> list[FlowRecord]:
        """Remove the strips that end at or before ``until_mm`` and return their records.

        A strip without a place has no length to wait for.
        """
        out: list[FlowRecord] = []
        while self._waiting and (self._waiting[0].end_mm <= until_mm or not self._waiting[0].placed):
            out.append(self._make_record(self._waiting.popleft(), profile))
        return out

    def _make_record(self, strip: Strip, profile: Profile) -> FlowRecord:
        stretch = profile.integrate(strip.start_mm, strip.end_mm)
        quality = _classify_quality(strip, stretch)
        if quality == "missing":
            stretch = make_unmeasured_stretch(stretch.length_mm)
        area = stretch.volume_mm3 / stretch.length_mm if stretch.length_mm > 0 else float("nan")
        if stretch.length_mm == 0 and quality != "missing":
            area = profile.area_at_mm2(strip.end_mm)
        moved = strip.step_sigma_mm * float(np.nan_to_num(area))
        fault = self._sums.compute_fault_sigma(
            stretch,
            max(strip.systematic_mm, combine_systematic_mm(strip.findings.values())),
            combine_relative_sigma(strip.findings.values()),
        )
        density = self._density.at(strip.time_ns)
        parts = self._sums.compute_parts(stretch, moved, fault, strip.scaled_lengths)
        self._sums.add((strip.start_mm, strip.end_mm), stretch, parts, density)
        return FlowRecord(
            frame=strip.frame,
            time_ns=strip.time_ns,
            belt_position_mm=strip.belt_position_mm,
            strip_mm=(strip.start_mm, strip.end_mm),
            area_mm2=float("nan") if quality == "missing" else area,
            volume_mm3=stretch.volume_mm3,
            sigma_mm3=0.0 if quality == "missing" else parts.sigma_mm3,
            speed_mm_s=strip.speed_mm_s,
            density_kg_m3=density[0],
            coverage=stretch.share,
            single_coverage=stretch.single_share,
            quality=quality,
            reason=_summarise(strip, quality),
            common_sigma_mm3=0.0 if quality == "missing" else parts.common_sigma_mm3,
            density_sigma_kg_m3=density[1],
            sigma_parts=parts,
        )


def _classify_quality(strip: Strip, stretch: Stretch) -> Quality:
    length = stretch.length_mm
    unseen = length - stretch.seen_mm - stretch.bridged_mm
    is_unmeasured = length == 0 and not np.isfinite(strip.view_start_mm)
    is_void = strip.is_void or is_unmeasured or (bool(strip.lost_to) and stretch.seen_mm <= 0.5 * length)
    if is_void or not strip.placed or unseen > 0.5 * length:
        return "missing"
    if stretch.bridged_mm > _MIN_PART * length:
        return "bridged"
    is_faulty = worst_effect(strip.findings.values()) != "none"
    if is_faulty or not strip.reliable or unseen > _MIN_PART * length or stretch.share < _MIN_SHARE:
        return "degraded"
    return "measured"


def _summarise(strip: Strip, quality: Quality) -> str:
    """Return the texts of the faults that made the strip what it is."""
    if quality == "measured":
        return ""
    return summarise_faults([*strip.findings.values(), *strip.lost_to.values()])
