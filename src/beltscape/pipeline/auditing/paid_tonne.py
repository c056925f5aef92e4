"""The budget of the paid tonne of a plant, from the sums of its history and what is known beside them."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from beltscape.core.alarm_catalogue import ENCODER_MOTION
from beltscape.core.errors import BeltscapeError, InputError
from beltscape.files.belt_json import read_belt, read_zero_settings
from beltscape.metrology.annual import CommonErrors, PaidTonne, ProductPart, compute_paid_tonne
from beltscape.metrology.document import describe_budget
from beltscape.pipeline.auditing.total import TotalName
from beltscape.pipeline.certifying.certificates import find_in_force, read_document
from beltscape.pipeline.live import zero
from beltscape.pipeline.live.project import Project, RunSettings
from beltscape.production.sums import ProductionSums
from beltscape.sinks.historian.events import read_events
from beltscape.sinks.historian.findings import average_findings
from beltscape.sinks.historian.production import read_batch, read_product_sums
from beltscape.sinks.historian.reading import find_database, read_history

FORMAT = "beltscape-budget/1"
_MOST_EVENTS = 200_000
"""Newest events among which zeros are searched: a year of one every three minutes."""
_SAME_DENSITY = 1e-3
"""Relative difference up to which a product's density is that of the material test: it is typed with four digits."""
_LATEST_NS = 1 << 61
"""A time after every record, whose minute SQLite's integers hold."""


@dataclass(frozen=True, slots=True)
class PaidTonneOptions:
    """What the settings and the history do not say."""

    moisture_sigma_percent: float = 0.0
    """σ of the moisture, percentage points, where the dry tonne is paid; 0: the wet one is."""
    confidence: float = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class PlantBudget:
    """The budget with what it rests on."""

    name: TotalName
    paid: PaidTonne
    errors: CommonErrors
    certificate: str
    """Number of the newest certificate; empty without one."""
    test_share: float
    """Relative σ of the mass per measured volume by its material test; 0: not known."""
    zeros: int
    """How often the zero was set in the period."""
    missing_share: float
    unsplit_share: float
    """Share of the volume's common σ that old records do not split."""


def compute_plant_budget(
    project: Project[RunSettings], name: TotalName, options: PaidTonneOptions
) -> PlantBudget:
    """Return the budget of a total of a project's history, which a plant may be writing.

    Raises
    ------
    InputError
        If there is no history, or it keeps no sums of that total.
    """
    data = project.resolve(project.settings.data)
    path = find_database(data)

    def read(connection: sqlite3.Connection) -> tuple[list[tuple[int, str, ProductionSums]], float, int]:
        zeros = _list_zeros(connection, name)
        return list(_read_sums(connection, name, zeros)), _read_speed_share(connection, name), len(zeros)

    sums, speed, zeros = read_history(path, read)
    if not any(one.records for _, _, one in sums):
        raise InputError(f"{path}: keeps no sums of {name.text}; give another total, such as all")
    results, certificate = _read_results(data)
    scale = _find_share(results, "span_factor")
    errors = CommonErrors(
        zero_share=_find_zero_share(project, data),
        scale_share=scale,
        speed_share=speed,
        moisture_sigma=options.moisture_sigma_percent / 100,
        moistures={one.name: (one.moisture_percent or 0.0) / 100 for one in project.settings.products},
    )
    tested = results.get("mass_factor", {}).get("value", math.nan)
    parts = [_make_part(stretch, product, one, tested) for stretch, product, one in sums]
    total = [one for _, _, one in sums]
    common, length = sum(one.common_mm3 for one in total), sum(one.length_mm for one in total)
    return PlantBudget(
        name,
        compute_paid_tonne(parts, errors, options.confidence),
        errors,
        certificate,
        _find_share(results, "mass_factor"),
        zeros,
        sum(one.missing_mm for one in total) / length if length else 0.0,
        sum(one.unsplit_mm3 for one in total) / common if common else 0.0,
    )


def _list_zeros(connection: sqlite3.Connection, name: TotalName) -> list[int]:
    """Return when the zero was set within a period, oldest first."""
    if name.kind == "batch":
        return []
    events = read_events(connection, name.since_ns, name.until_ns, _MOST_EVENTS)
    return sorted(one.wall_ns for one in events if (one.kind, one.name) == ("zero", "set"))


def _read_sums(
    connection: sqlite3.Connection, name: TotalName, zeros: Sequence[int]
) -> Iterator[tuple[int, str, ProductionSums]]:
    """Yield number of the stretch between two settings of the zero, product and sums."""
    if name.kind == "batch":
        found = read_batch(connection, name.batch)
        for product, one in () if found is None else found.by_product:
            yield 0, product, one
        return
    ends = [max(name.since_ns, 0), *zeros, min(name.until_ns, _LATEST_NS)]
    for stretch, (since_ns, until_ns) in enumerate(pairwise(ends)):
        for product, one in sorted(read_product_sums(connection, since_ns, until_ns).items()):
            yield stretch, product, one


def _make_part(stretch: int, product: str, sums: ProductionSums, tested_kg_m3: float) -> ProductPart:
    volume_m3 = sums.volume_mm3 * 1e-9
    density = sums.mass_kg / volume_m3 if volume_m3 > 0 else math.nan
    sigma = sums.density_common_kg / volume_m3 if volume_m3 > 0 else 0.0
    return ProductPart(
        product=product,
        stretch=stretch,
        volume_m3=sums.volume_mm3 * 1e-9,
        density_kg_m3=density,
        density_sigma_kg_m3=sigma,
        matching_m3=math.sqrt(sums.variance_mm6) * 1e-9,
        edges_m3=sums.edges_mm3 * 1e-9,
        holes_m3=sums.holes_mm3 * 1e-9,
        drift_m3=sums.drift_mm3 * 1e-9,
        faults_m3=sums.faults_mm3 * 1e-9,
        unsplit_m3=sums.unsplit_mm3 * 1e-9,
        scale_m3=sums.scale_mm3 * 1e-9,
        missing_share=sums.missing_mm / sums.length_mm if sums.length_mm > 0 else 0.0,
        is_tested=abs(density - tested_kg_m3) <= _SAME_DENSITY * density,
    )


def _read_speed_share(connection: sqlite3.Connection, name: TotalName) -> float:
    """Return the relative σ of the belt's length, by encoder against material; 0 where they were not compared."""
    period = max(name.since_ns, 0), min(name.until_ns, _LATEST_NS)
    found = average_findings(connection, ENCODER_MOTION, *period)
    return 0.0 if found is None else math.hypot(*found)


def _find_zero_share(project: Project[RunSettings], data: Path) -> float:
    """Return σ of the zero that was set last over the σ of all slow depth errors; 0 where none was set."""
    empty = project.resolve(project.settings.empty)
    for path in (data / zero.FILE, empty):
        try:
            settings = read_zero_settings(path) if path.is_file() else []
            if settings:
                drift_mm = read_belt(path)[0].drift_mm
                sigma_mm = float(settings[-1].get("offset_sigma_mm", 0.0))  # pyrefly: ignore
                return min(1.0, sigma_mm / drift_mm) if drift_mm > 0 else 0.0
        except (BeltscapeError, TypeError, ValueError):
            continue  # a damaged zero is named by the run, which does not use it
    return 0.0


def _read_results(data: Path) -> tuple[Mapping[str, Mapping[str, Any]], str]:
    """Return the results of the newest certificate by their keys, and its number; none without one."""
    newest = find_in_force(data)
    if newest is None:
        return {}, ""
    results: Sequence[Mapping[str, Any]] = read_document(newest.path)["results"]
    return {one["key"]: one for one in results}, newest.statement.number


def _find_share(results: Mapping[str, Mapping[str, Any]], key: str) -> float:
    """Return the relative σ of a result; 0 where it is not determined."""
    found = results.get(key)
    return 0.0 if found is None else found["sigma"] / found["value"]


def make_budget_document(found: PlantBudget) -> dict[str, Any]:
    """Return the budget as plain values."""
    paid = found.paid
    return {
        "format": FORMAT,
        "total": found.name.text,
        "unit": paid.unit,
        "amount": paid.amount,
        "confidence": paid.budget.confidence,
        **describe_budget(paid.budget),
        "relative_percent": 100 * paid.budget.sigma / abs(paid.amount) if paid.amount else None,
        "largest": paid.largest,
        "by_product": [{"product": name, "amount": amount} for name, amount in paid.by_product],
        "certificate": found.certificate,
        "test_sigma_percent": 100 * found.test_share or None,
        "zeros": found.zeros,
        "missing_percent": 100 * found.missing_share,
        "unsplit_percent": 100 * found.unsplit_share,
        "notes": list(_list_notes(found)),
    }


def _list_notes(found: PlantBudget) -> Iterator[str]:
    """Yield the keys of what a reader must know."""
    parts = {one.key for one in found.paid.budget.contributions}
    checks = {
        "volume_only": found.paid.unit != "t",
        "no_scale": not found.errors.scale_share and "scale" not in parts,
        "no_speed": not found.errors.speed_share,
        "wet": not found.errors.moisture_sigma,
        "unsplit": found.unsplit_share > 0.01,
    }
    yield from (key for key, holds in checks.items() if holds)
