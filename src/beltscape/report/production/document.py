"""The figures of production as documents: for reports and for the HTTP interface; null where a value is not known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict

from beltscape.files.json_number import Number
from beltscape.production.scale import WeighedVolume
from beltscape.production.shifts import Period, PeriodKind
from beltscape.production.sums import Batch, ProductionSums, add_up

_MS_NS = 1_000_000
"""Nanoseconds of a millisecond."""


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SumsOut(_Document):
    """Sums of records; σ is one standard deviation."""

    records: int
    volume_m3: float
    sigma_m3: float
    mass_t: Number
    mass_sigma_t: Number
    valid_m: float
    degraded_m: float
    missing_m: float

    @classmethod
    def from_sums(cls, sums: ProductionSums) -> SumsOut:
        """Return the sums in m³, t and m."""
        return cls(
            records=sums.records,
            volume_m3=sums.volume_mm3 * 1e-9,
            sigma_m3=sums.sigma_mm3 * 1e-9,
            mass_t=sums.mass_kg * 1e-3,
            mass_sigma_t=sums.mass_sigma_kg * 1e-3,
            valid_m=sums.valid_mm * 1e-3,
            degraded_m=sums.degraded_mm * 1e-3,
            missing_m=sums.missing_mm * 1e-3,
        )


class ProductOut(_Document):
    """The sums of one product."""

    product: str
    totals: SumsOut


class ScaleOut(_Document):
    """A belt scale's weighing against our volume."""

    mass_t: Number
    sigma_t: Number
    density_kg_m3: Number
    sigma_kg_m3: Number
    moisture_percent: Number
    moisture_sigma_percent: Number
    deviation_t: Number
    deviation_sigma_t: Number
    disagrees: bool
    reason: str

    @classmethod
    def from_comparison(cls, comparison: WeighedVolume) -> ScaleOut:
        """Return the comparison in t."""
        return cls(
            mass_t=comparison.weighing.kg * 1e-3,
            sigma_t=comparison.weighing.sigma_kg * 1e-3,
            density_kg_m3=comparison.density_kg_m3,
            sigma_kg_m3=comparison.sigma_kg_m3,
            moisture_percent=comparison.moisture_percent,
            moisture_sigma_percent=comparison.moisture_sigma_percent,
            deviation_t=comparison.deviation_kg * 1e-3,
            deviation_sigma_t=comparison.deviation_sigma_kg * 1e-3,
            disagrees=comparison.disagrees,
            reason=comparison.reason,
        )


class BatchOut(_Document):
    """A batch; without ``ended_ms`` it is open, ``complete``: nothing more will be counted for it."""

    number: int
    name: str
    started_ms: int
    started_by: str
    ended_ms: int | None
    ended_by: str
    complete: bool
    totals: SumsOut
    by_product: list[ProductOut]
    scale: ScaleOut | None

    @classmethod
    def from_batch(cls, batch: Batch, comparison: WeighedVolume | None) -> BatchOut:
        """Return the batch with its weighing, if there is a scale."""
        return cls(
            number=batch.number,
            name=batch.name,
            started_ms=batch.started_ns // _MS_NS,
            started_by=batch.started_by,
            ended_ms=None if batch.ended_ns is None else batch.ended_ns // _MS_NS,
            ended_by=batch.ended_by,
            complete=batch.is_complete,
            totals=SumsOut.from_sums(batch.sums),
            by_product=_list_products(batch.by_product),
            scale=None if comparison is None else ScaleOut.from_comparison(comparison),
        )


class PeriodOut(_Document):
    """A shift or a day."""

    kind: PeriodKind
    name: str
    key: str
    day: str
    since_ms: int
    until_ms: int
    totals: SumsOut
    by_product: list[ProductOut]
    scale: ScaleOut | None

    @classmethod
    def from_period(
        cls, period: Period, by_product: dict[str, ProductionSums], comparison: WeighedVolume | None
    ) -> PeriodOut:
        """Return the period with its sums and its weighing, if there is a scale."""
        return cls(
            kind=period.kind,
            name=period.name,
            key=period.key,
            day=period.day.isoformat(),
            since_ms=period.since_ns // _MS_NS,
            until_ms=period.until_ns // _MS_NS,
            totals=SumsOut.from_sums(add_up(by_product)),
            by_product=_list_products(sorted(by_product.items())),
            scale=None if comparison is None else ScaleOut.from_comparison(comparison),
        )


class ChangeOut(_Document):
    """A change of the product."""

    at_ms: int
    product: str
    by: str


class FlowIntervals(_Document):
    """Mean flow in equal intervals."""

    width_ms: int
    start_ms: list[int]
    m3_h: list[Number]


class ReportDocument(_Document):
    """All figures of one report."""

    format: Literal["beltscape-production-report/1"] = "beltscape-production-report/1"
    plant: str
    language: str
    time_zone: str
    made_ms: int
    period: PeriodOut
    shifts: list[PeriodOut]
    batches: list[BatchOut]
    changes: list[ChangeOut]
    flow: FlowIntervals
    colours: dict[str, str]
    """Colour of every product."""


def _list_products(by_product: Sequence[tuple[str, ProductionSums]]) -> list[ProductOut]:
    return [ProductOut(product=name, totals=SumsOut.from_sums(sums)) for name, sums in by_product]
