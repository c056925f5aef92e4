"""Batches: what was conveyed between the start and the stop of a truck's, a ship's or a mixture's load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

from beltscape.production.sums import ProductionSums


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
