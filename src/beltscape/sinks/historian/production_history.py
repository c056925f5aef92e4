"""The production's part of the history: the present product, batches, sums of periods, readings of a belt scale."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence

from beltscape.production.scale import ScaleReading
from beltscape.production.sums import Batch, ProductionSums
from beltscape.sinks.historian import production
from beltscape.sinks.historian.ledger import transaction
from beltscape.sinks.historian.production import ProductChange
from beltscape.sinks.historian.store import Store


class ProductionHistory:
    """Stores and reads production; what a call stored is on the disk when it returns. Thread-safe.

    Writing raises OutputError where the database cannot be written, reading InputError where it cannot be read.
    """

    def __init__(self, store: Store) -> None:
        self._store = store

    def change_product(self, product: str, by: str, wall_ns: int) -> None:
        """Make a product the present one."""
        self._store.transact(lambda c: production.insert_product_change(c, wall_ns, product, by))

    def start_batch(self, name: str, by: str, wall_ns: int) -> int:
        """Open a batch, where none is open; return its number."""
        first = self._store.sums.number + 1
        return self._store.transact(lambda c: production.insert_batch(c, first, name, wall_ns, by))

    def end_batch(self, by: str, wall_ns: int) -> None:
        """End the open batch, if there is one."""
        self._store.transact(lambda c: production.end_batch(c, wall_ns, by))

    def add_readings(self, readings: Sequence[ScaleReading]) -> None:
        """Store readings of a belt scale."""

        def work(connection: sqlite3.Connection) -> None:
            with transaction(connection):
                production.insert_readings(connection, readings)

        if readings:
            self._store.transact(work)

    @property
    def last_change(self) -> ProductChange | None:
        """The last change of the product; None before the first."""
        with self._store.readers.borrow() as connection:
            return production.read_last_change(connection)

    @property
    def open_batch(self) -> Batch | None:
        """The open batch; None without one."""
        with self._store.readers.borrow() as connection:
            return production.read_open_batch(connection)

    def changes(self, since_ns: int, until_ns: int) -> tuple[ProductChange, ...]:
        """Return the changes of the product in a period, oldest first."""
        with self._store.readers.borrow() as connection:
            return production.read_changes(connection, since_ns, until_ns)

    def batches(self, since_ns: int, until_ns: int, limit: int = 1000) -> tuple[Batch, ...]:
        """Return the batches that touch a period, newest first."""
        with self._store.readers.borrow() as connection:
            return production.read_batches(connection, since_ns, until_ns, limit)

    def product_sums(self, since_ns: int, until_ns: int) -> dict[str, ProductionSums]:
        """Return what the records of a period of whole minutes add up to, for every product."""
        with self._store.readers.borrow() as connection:
            return production.read_product_sums(connection, since_ns, until_ns)

    def readings(self, since_ns: int, until_ns: int) -> tuple[ScaleReading, ...]:
        """Return the scale's readings of a period and those next to it, in the order of time."""
        with self._store.readers.borrow() as connection:
            return production.read_readings(connection, since_ns, until_ns)

    @property
    def last_reading(self) -> ScaleReading | None:
        """The newest reading of the scale; None without one."""
        with self._store.readers.borrow() as connection:
            return production.read_last_reading(connection)
