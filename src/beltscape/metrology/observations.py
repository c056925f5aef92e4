"""What a material test observes: runs of known mass or volume, their references, the zero, and samples."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.metrology.uncertainty import INFINITE

ReferenceKind = Literal["mass", "volume"]
REFERENCE_KINDS: tuple[ReferenceKind, ...] = ("mass", "volume")


@dataclass(frozen=True, slots=True)
class ReferenceStandard:
    """What masses or volumes of runs are known by; one for all runs of a kind, so its error is common to them."""

    name: str = ""
    certificate: str = ""
    """Number of its own certificate."""
    sigma_share: float = 0.0
    """σ of the calibration in proportion to the value."""
    sigma_constant: float = 0.0
    """σ of the calibration that is the same for every value, kg or m³."""
    resolution: float = 0.0
    """Step of the display, kg or m³; a mass is the difference of two readings."""
    degrees_of_freedom: float = INFINITE
    """Of the calibration."""


@dataclass(frozen=True, slots=True)
class ReferenceRun:
    """One run: what passed, by the reference and as measured."""

    load: str
    """Name of its load; runs of the same load are repetitions."""
    kind: ReferenceKind
    reference: float
    """kg or m³."""
    volume_m3: float
    """As measured, with the zero that held then."""
    length_m: float
    """Length of belt over which the volume was measured."""
    own_sigma_m3: float = 0.0
    """σ of the measured volume that is independent from run to run."""
    level: float = math.nan
    """What tells loads apart, such as the mean flow in m³/h."""
    recorded_kg: float = math.nan
    """Mass by the plant's own density; NaN: it has none."""
    label: str = ""
    """Such as the number of the weighing ticket."""


@dataclass(frozen=True, slots=True)
class ZeroTest:
    """The apparent load of the empty running belt over whole revolutions."""

    area_mm2: float
    """Mean apparent cross-section."""
    sigma_mm2: float
    """One standard deviation of it."""
    revolutions: int
    degrees_of_freedom: float
    """Turns less one; infinite where σ is that of the measurement."""
    scatter_mm2: float = math.nan
    """Standard deviation of one turn."""


@dataclass(frozen=True, slots=True)
class Sample:
    """A quantity that was determined apart from the belt."""

    value: float
    """kg/m³, or the moisture as a share of the mass."""
    sigma: float
    degrees_of_freedom: float = INFINITE


@dataclass(frozen=True, slots=True)
class OtherEffect:
    """A further source of error, such as spilt material: a share of the mass or volume, common to all runs."""

    name: str
    sigma_share: float
    kind: Literal["A", "B"] = "B"
    degrees_of_freedom: float = INFINITE


@dataclass(frozen=True, slots=True)
class ObservedRuns:
    """All that a material test observed: runs, references, zero and samples."""

    runs: tuple[ReferenceRun, ...]
    references: Mapping[ReferenceKind, ReferenceStandard]
    zero: ZeroTest | None = None
    """None: no zero test was made."""
    samples: Mapping[Literal["density", "dry_density", "moisture"], Sample] | None = None
    others: tuple[OtherEffect, ...] = ()
    confidence: float = 0.95


def correct_volume(run: ReferenceRun, observed: ObservedRuns) -> float:
    """Return the measured volume of a run less that of the zero, m³."""
    zero = 0.0 if observed.zero is None else observed.zero.area_mm2 * 1e-6 * run.length_m
    return run.volume_m3 - zero


def evaluate_zero(areas_mm2: Sequence[float], own_sigma_mm2: float) -> ZeroTest:
    """Return the zero by the mean apparent cross-section of each whole revolution of the empty belt.

    ``own_sigma_mm2`` is the σ of the mean by the measurement itself, without what they share with the loads. It holds
    for a single revolution, and where they scatter by chance less.
    """
    areas = np.asarray(areas_mm2, np.float64)
    count = len(areas)
    scatter = float(areas.std(ddof=1)) if count > 1 else math.nan
    by_scatter = scatter / math.sqrt(count) if count > 1 else 0.0
    if by_scatter > own_sigma_mm2:
        return ZeroTest(float(areas.mean()), by_scatter, count, count - 1, scatter)
    return ZeroTest(float(areas.mean()), own_sigma_mm2, count, INFINITE, scatter)
