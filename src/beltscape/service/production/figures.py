"""The figures of batches, shifts and days, with the comparison with the belt scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from beltscape.pipeline.live.production import ProductionControl
from beltscape.production.scale import Trend, WeighedVolume, compare, fit_trend, weigh
from beltscape.production.settings import ProductSettings, ScaleSettings
from beltscape.production.shifts import Period, PeriodKind, list_production_days, list_shifts
from beltscape.production.sums import ProductionSums, add_up
from beltscape.report.production.document import BatchOut, PeriodOut

_TREND_BATCHES = 100
"""Newest batches in a trend. Chosen: some weeks of a quay or a loading point."""


@dataclass(frozen=True, slots=True)
class ProductTrend:
    """The trend of a product's density by the belt scale, over its batches."""

    product: str
    trend: Trend


class ProductionFigures:
    """Counts and weighs; thread-safe."""

    def __init__(self, control: ProductionControl, scale: ScaleSettings | None) -> None:
        """``scale``: the belt scale; None: there is none."""
        self.control, self.scale = control, scale

    def list_batches(self, since_ns: int, until_ns: int, limit: int = 1000) -> list[BatchOut]:
        """Return the batches that touch a period, newest first."""
        found = self.control.history.batches(since_ns, until_ns, limit)
        return [
            BatchOut.from_batch(
                batch, self._compare(batch.started_ns, batch.ended_ns, dict(batch.by_product))
            )
            for batch in found
        ]

    def list_periods(self, kind: PeriodKind, since_ns: int, until_ns: int) -> list[Period]:
        """Return the shifts or days that touch a period, oldest first."""
        list_all = list_shifts if kind == "shift" else list_production_days
        return list_all(self.control.settings.shifts, self.control.zone, since_ns, until_ns)

    def count_period(self, period: Period) -> PeriodOut:
        """Return what a shift or a day adds up to."""
        by_product = self.control.history.product_sums(period.since_ns, period.until_ns)
        comparison = self._compare(period.since_ns, period.until_ns, by_product)
        return PeriodOut.from_period(period, by_product, comparison)

    def fit_trends(self, until_ns: int) -> list[ProductTrend]:
        """Return the trend of the density of every product that the scale weighed in batches of its own."""
        found: dict[str, list[tuple[int, float]]] = {}
        if self.scale is not None:
            for batch in reversed(self.control.history.batches(0, until_ns, _TREND_BATCHES)):
                if batch.ended_ns is None or len(batch.by_product) != 1:
                    continue
                compared = self._compare(batch.started_ns, batch.ended_ns, dict(batch.by_product))
                if compared is not None and not compared.reason:
                    found.setdefault(batch.by_product[0][0], []).append(
                        (batch.ended_ns, compared.density_kg_m3)
                    )
        trends = ((name, fit_trend(densities)) for name, densities in sorted(found.items()))
        return [ProductTrend(name, trend) for name, trend in trends if trend is not None]

    def _compare(
        self, since_ns: int, until_ns: int | None, by_product: Mapping[str, ProductionSums]
    ) -> WeighedVolume | None:
        """Return the comparison of a period that is over; None without a scale."""
        if self.scale is None or until_ns is None:
            return None
        weighing = weigh(self.control.history.readings(since_ns, until_ns), since_ns, until_ns, self.scale)
        return compare(weighing, add_up(by_product), self._find_only(list(by_product)))

    def _find_only(self, names: Sequence[str]) -> ProductSettings | None:
        return self.control.find_product(names[0]) if len(names) == 1 else None
