"""Sums of records with σ over any choice of records, and batches, which are made of such sums.

Independent errors add in squares, common ones linearly. A batch is what was conveyed between the start and the stop
of a truck's, a ship's or a mixture's load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from typing import Any

from beltscape.core.ledger import BeltRecord, SigmaParts


@dataclass(frozen=True, slots=True)
class ProductionSums:
    """Sums of records; sums of sums are sums of all their records.

    The common part of a strip's σ (edges, holes, slow drift, faults) is the same error in all strips, so these parts
    add linearly and do not average out; so does the error of a density (as in `measure.flow.strips`).
    """

    records: int = 0
    volume_mm3: float = 0.0
    variance_mm6: float = 0.0
    """Sum of the variances of the strips' own errors."""
    common_mm3: float = 0.0
    """Sum of the common parts of their σ."""
    weighed_kg: float = 0.0
    """Mass of the records with a known density."""
    unweighed: int = 0
    """Number of records with a load of unknown density."""
    mass_variance_kg2: float = 0.0
    mass_common_kg: float = 0.0
    density_common_kg: float = 0.0
    """Sum of volume × σ of the density."""
    valid_mm: float = 0.0
    degraded_mm: float = 0.0
    missing_mm: float = 0.0
    edges_mm3: float = 0.0
    holes_mm3: float = 0.0
    drift_mm3: float = 0.0
    faults_mm3: float = 0.0
    """Sums of the parts of the common σ: common displacement of edges, holes, slow depth errors, faults."""
    unsplit_mm3: float = 0.0
    """Sum of the common σ of the records whose parts are not known."""
    scale_mm3: float = 0.0
    """Sum of the part by the size of the calibration board."""

    def __add__(self, other: ProductionSums) -> ProductionSums:
        """Return the sums of both."""
        return ProductionSums(*(getattr(self, name) + getattr(other, name) for name in COLUMNS))

    @property
    def sigma_mm3(self) -> float:
        """Return one standard deviation of the volume."""
        return math.sqrt(self.variance_mm6 + self.common_mm3**2)

    @property
    def mass_kg(self) -> float:
        """Return the mass; NaN as soon as one load's density is not known."""
        return math.nan if self.unweighed else self.weighed_kg

    @property
    def mass_sigma_kg(self) -> float:
        """Return one standard deviation of the mass: volume and density; NaN as the mass."""
        if self.unweighed:
            return math.nan
        return math.sqrt(self.mass_variance_kg2 + self.mass_common_kg**2 + self.density_common_kg**2)

    @property
    def volume_mass_sigma_kg(self) -> float:
        """Return the part of the mass's σ that is due to the volume."""
        return math.sqrt(self.mass_variance_kg2 + self.mass_common_kg**2)

    @property
    def length_mm(self) -> float:
        """Return the length of all belt that passed."""
        return self.valid_mm + self.degraded_mm + self.missing_mm


COLUMNS = tuple(field.name for field in fields(ProductionSums))
"""Names of the sums, in order."""


def sum_record(record: BeltRecord) -> ProductionSums:
    """Return what one record adds."""
    lengths: dict[str, Any] = {f"{record.standing}_mm": float(record.length_mm)}
    passed = ProductionSums(records=1, **lengths)
    strip = record.strip
    volume = record.volume_mm3
    if strip is None or record.standing == "missing" or not math.isfinite(volume):
        return passed
    sigma = strip.sigma_mm3 if math.isfinite(strip.sigma_mm3) else 0.0
    common = min(strip.common_sigma_mm3, sigma) if math.isfinite(strip.common_sigma_mm3) else sigma
    variance = max(sigma**2 - common**2, 0.0)
    parts = _list_parts(strip.sigma_parts, common)
    density = strip.density_kg_m3 * 1e-9
    if not math.isfinite(density):
        unweighed = int(volume != 0.0)
        return replace(
            passed, volume_mm3=volume, variance_mm6=variance, common_mm3=common, unweighed=unweighed, **parts
        )
    density_sigma = strip.density_sigma_kg_m3 if math.isfinite(strip.density_sigma_kg_m3) else 0.0
    return replace(
        passed,
        volume_mm3=volume,
        variance_mm6=variance,
        common_mm3=common,
        weighed_kg=volume * density,
        mass_variance_kg2=variance * density**2,
        mass_common_kg=common * density,
        density_common_kg=volume * density_sigma * 1e-9,
        **parts,
    )


def _list_parts(parts: SigmaParts, common_mm3: float) -> dict[str, Any]:
    """Return the parts of a strip's common σ, or all of it as one where they are not known."""
    if parts == SigmaParts():
        return {"unsplit_mm3": common_mm3}
    names = ("edges_mm3", "holes_mm3", "drift_mm3", "faults_mm3", "scale_mm3")
    return {name: getattr(parts, name) for name in names}


@dataclass(frozen=True, slots=True)
class Batch:
    """A batch with what its records add up to."""

    number: int
    """Increases from batch to batch."""
    name: str
    """Such as the number plate of a truck or the name of a ship."""
    started_ns: int
    """System clock, ns since 1970."""
    started_by: str
    ended_ns: int | None = None
    """None: it is open."""
    ended_by: str = ""
    by_product: tuple[tuple[str, ProductionSums], ...] = ()
    """Its sums for every product, in the order of their names."""
    is_complete: bool = False
    """Whether it has ended and all belt that was in view then is counted."""

    @property
    def sums(self) -> ProductionSums:
        """Return the sums over all products."""
        return add_up(dict(self.by_product))


def add_up(by_product: Mapping[str, ProductionSums]) -> ProductionSums:
    """Return the sums over all products."""
    return reduce(ProductionSums.__add__, by_product.values(), ProductionSums())


def list_products(batches: Sequence[Batch]) -> list[str]:
    """Return the names of all products of some batches, in the order of their names."""
    return sorted({name for batch in batches for name, _ in batch.by_product})
