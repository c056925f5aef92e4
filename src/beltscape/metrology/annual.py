"""The budget of the paid tonne: what the mass of a year's belt is uncertain by, part by part.

Errors that all belt shares add linearly over strips and products, those of one product's density over that product,
those of a zero until the next one is set; independent ones add in squares (GUM 5.2.2).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from beltscape.metrology.uncertainty import Budget, Contribution, make_budget

_UNIFORM = 1 / math.sqrt(12)
"""σ of a value that lies anywhere in an interval of length 1 (GUM 4.3.7)."""


@dataclass(frozen=True, slots=True)
class ProductPart:
    """What was conveyed of a product between two settings of the zero; its sums of σ as in `ProductionSums`."""

    product: str
    stretch: int
    """Number of the stretch between two settings of the zero."""
    volume_m3: float
    density_kg_m3: float
    """Mean bulk density; NaN where it is not known."""
    density_sigma_kg_m3: float = 0.0
    matching_m3: float = 0.0
    """σ of what is independent from strip to strip."""
    edges_m3: float = 0.0
    holes_m3: float = 0.0
    drift_m3: float = 0.0
    faults_m3: float = 0.0
    unsplit_m3: float = 0.0
    scale_m3: float = 0.0
    """σ by the size of the calibration board."""
    missing_share: float = 0.0
    """Share of the belt that was not measured."""
    is_tested: bool = False
    """Whether its density is a material test's mass per measured volume, in which the rig's scale cancels."""


@dataclass(frozen=True, slots=True)
class CommonErrors:
    """What is known of errors beside the records."""

    zero_share: float = 0.0
    """σ of the zero that was set over the whole σ of slow depth errors."""
    scale_share: float = 0.0
    """Relative σ of the rig's scale, by the span factor of a certificate in force; 0: that of the board's size."""
    speed_share: float = 0.0
    """Relative σ of the belt's length, by encoder against material; 0: not known."""
    moisture_sigma: float = 0.0
    """σ of the moisture as a share; it counts where the dry tonne is paid."""
    moistures: dict[str, float] = field(default_factory=dict[str, float])
    """Moisture by product, as a share."""


@dataclass(frozen=True, slots=True)
class PaidTonne:
    """The budget of what was conveyed."""

    amount: float
    """Tonnes; m³ where no density is known."""
    unit: str
    """"t" or "m³"."""
    budget: Budget
    """Keys: geometry, scale (of the rig, by material test or board), matching, holes, edges, zero, speed, density,
    moisture, faults, missing, unsplit (of records without parts)."""
    by_product: tuple[tuple[str, float], ...]
    """Amount by product."""

    @property
    def largest(self) -> str:
        """Return the key of the largest contribution; empty without any."""
        return self.budget.contributions[0].key if self.budget.contributions else ""


def compute_paid_tonne(
    parts: Sequence[ProductPart], errors: CommonErrors, confidence: float = 0.95
) -> PaidTonne:
    """Return amount and budget over all parts."""
    weighed = all(math.isfinite(one.density_kg_m3) for one in parts if one.volume_m3)
    factors = [
        one.density_kg_m3 * 1e-3 if weighed and math.isfinite(one.density_kg_m3) else 1.0 for one in parts
    ]
    amounts = [one.volume_m3 * factor for one, factor in zip(parts, factors, strict=True)]
    found = dict(_list_linear(parts, factors, amounts, errors))
    found |= _list_by_group(parts, factors, errors, is_weighed=weighed)
    by_product: dict[str, float] = {}
    for one, amount in zip(parts, amounts, strict=True):
        by_product[one.product] = by_product.get(one.product, 0.0) + amount
    contributions = [Contribution(key, "B", sigma, math.inf) for key, sigma in found.items()]
    budget = make_budget(contributions, confidence)
    return PaidTonne(sum(amounts), "t" if weighed else "m³", budget, tuple(sorted(by_product.items())))


def _list_linear(
    parts: Sequence[ProductPart], factors: Sequence[float], amounts: Sequence[float], errors: CommonErrors
) -> Iterator[tuple[str, float]]:
    """Yield the errors that all belt shares."""
    for key in ("edges", "holes", "faults", "unsplit"):
        yield key, sum(getattr(one, f"{key}_m3") * factor for one, factor in zip(parts, factors, strict=True))
    rest = math.sqrt(max(1 - errors.zero_share**2, 0.0))
    yield "geometry", rest * sum(one.drift_m3 * factor for one, factor in zip(parts, factors, strict=True))
    yield "scale", _add_scale(parts, factors, amounts, errors.scale_share)
    yield "speed", errors.speed_share * abs(sum(amounts))
    # belt without a measurement carried anything from none to twice the mean load
    guessed = (
        2 * _UNIFORM * one.missing_share / (1 - one.missing_share) * abs(amount)
        for one, amount in zip(parts, amounts, strict=True)
        if one.missing_share < 1
    )
    yield "missing", sum(guessed)


def _add_scale(
    parts: Sequence[ProductPart], factors: Sequence[float], amounts: Sequence[float], tested_share: float
) -> float:
    """Return σ by the rig's scale: as a material test found it, else by the size of the calibration board.

    It cancels where the density is the test's mass per measured volume.
    """
    free = [index for index, one in enumerate(parts) if not one.is_tested]
    if tested_share:
        return tested_share * abs(sum(amounts[index] for index in free))
    return sum(parts[index].scale_m3 * factors[index] for index in free)


def _list_by_group(
    parts: Sequence[ProductPart], factors: Sequence[float], errors: CommonErrors, *, is_weighed: bool
) -> dict[str, float]:
    """Return the errors that are common within a group, and independent between groups."""
    zeros: dict[int, float] = {}
    densities: dict[str, float] = {}
    moistures: dict[str, float] = {}
    own = 0.0
    for one, factor in zip(parts, factors, strict=True):
        own += (one.matching_m3 * factor) ** 2
        zeros[one.stretch] = zeros.get(one.stretch, 0.0) + errors.zero_share * one.drift_m3 * factor
        if not is_weighed:
            continue
        density = one.volume_m3 * one.density_sigma_kg_m3 * 1e-3
        densities[one.product] = densities.get(one.product, 0.0) + density
        solids = 1 - errors.moistures.get(one.product, 0.0)
        moisture = one.volume_m3 * factor * errors.moisture_sigma / solids
        moistures[one.product] = moistures.get(one.product, 0.0) + moisture
    groups = {"zero": zeros, "density": densities, "moisture": moistures}
    return {"matching": math.sqrt(own), **{key: math.hypot(*group.values()) for key, group in groups.items()}}
