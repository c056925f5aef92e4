"""The present product and batch of a running system: changed by people, other systems or the timetable."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from time import time_ns

from beltscape.core.errors import InputError
from beltscape.core.ledger import RecordTag
from beltscape.pipeline.live.event_log import EventLog
from beltscape.production.calendar import open_zone
from beltscape.production.settings import ProductionSettings, ProductSettings
from beltscape.production.shifts import find_due_change
from beltscape.sinks.historian.production_history import ProductionHistory

TIMETABLE = "timetable"
"""Name under which the timetable changes the product."""
_NAME_MAX = 60
"""Longest name of a batch, characters: two lines on a phone."""
_MS_NS, _MINUTE_NS = 1_000_000, 60_000_000_000
"""Resolution of the interface's times and of the timetable."""


class ProductionControl:
    """Changes product and batch; a change is on the disk before it counts, and counts from the next frame on.

    Thread-safe. The methods raise OutputError where a change cannot be kept; then nothing has changed.
    """

    def __init__(
        self,
        products: Sequence[ProductSettings],
        settings: ProductionSettings,
        history: ProductionHistory,
        events: EventLog,
        wall_ns: Callable[[], int] = time_ns,
    ) -> None:
        """Continue with the product and the batch of the run before."""
        self.products = tuple(products)
        self.settings, self.history = settings, history
        self.zone = open_zone(settings.time_zone)
        self.events, self._wall_ns = events, wall_ns
        self._lock = threading.Lock()
        self._by_name = {product.name: product for product in products}
        self._minute = -1
        batch = history.open_batch
        self._batch_name = "" if batch is None else batch.name
        self.tag = RecordTag(batch=0 if batch is None else batch.number)
        """What the next frame's record is counted for."""
        if products:
            self._restore_product()

    @property
    def batch_name(self) -> str:
        """Name of the open batch; empty without one."""
        return self._batch_name

    @property
    def product(self) -> ProductSettings | None:
        """The present product; None where none is defined."""
        return self._by_name.get(self.tag.product)

    def find_product(self, name: str) -> ProductSettings | None:
        """Return the product of that name; None if the settings have none."""
        return self._by_name.get(name)

    def require_present(self, products: Sequence[ProductSettings]) -> None:
        """Raise InputError unless other products have the present one."""
        present = self.tag.product
        if present and all(product.name != present for product in products):
            raise InputError(
                f"products: {present} is the present product; make another the present one first"
            )

    def set_settings(self, products: Sequence[ProductSettings], settings: ProductionSettings) -> None:
        """Take other products and settings; the present product's density counts from the next frame on."""
        with self._lock:
            self.products, self.settings, self.zone = tuple(products), settings, open_zone(settings.time_zone)
            self._by_name = {product.name: product for product in products}
            if self.tag.product or not products:
                self._set_tag(self.tag.product, self.tag.batch)
            else:
                self._restore_product()

    def change_product(self, name: str, by: str) -> bool:
        """Make a product the present one; return whether it was not. InputError if there is no such product."""
        with self._lock:
            return self._change_product(name, by)

    def start_batch(self, name: str, product: str, by: str) -> int:
        """Start a batch and return its number; ``product`` empty: the present one.

        Raises
        ------
        InputError
            If a batch is open, the name is none, or there is no such product.
        """
        name = _check_name(name)
        with self._lock:
            if self.tag.batch:
                raise InputError(f"batch {self._batch_name} is open; stop it first")
            if product:
                self._change_product(product, by)
            number = self.history.start_batch(name, by, self._read_ms())
            self._batch_name = name
            self._set_tag(self.tag.product, number)
        self.events.add("batch", name, "started", self._wall_ns(), by, {"action": "start"})
        return number

    def stop_batch(self, by: str) -> None:
        """Stop the open batch; InputError if none is open.

        Belt that was in view is still counted for it, some records later.
        """
        with self._lock:
            name = self._batch_name
            if not self.tag.batch:
                raise InputError("no batch is open")
            self.history.end_batch(by, self._read_ms())
            self._batch_name = ""
            self._set_tag(self.tag.product, 0)
        self.events.add("batch", name, "stopped", self._wall_ns(), by, {"action": "stop"})

    def follow_timetable(self) -> None:
        """Make the change whose time has come; call it at least once a minute."""
        minute = self._wall_ns() // _MINUTE_NS
        if minute != self._minute and self.products:
            self._minute = minute
            with self._lock:
                self._apply_due_change()

    def _read_ms(self) -> int:
        """Return the clock in whole ms: a scale's reading that is typed for a batch has its very time."""
        return self._wall_ns() // _MS_NS * _MS_NS

    def _restore_product(self) -> None:
        last = self.history.last_change
        due = find_due_change(self.settings.timetable, self.zone, self._wall_ns())
        if last is not None and last.product in self._by_name:
            self._set_tag(last.product, self.tag.batch)
            self._apply_due_change()
            return
        first = self.settings.product or self.products[0].name
        self._change_product(first if due is None else due.product, TIMETABLE if due else "settings")

    def _apply_due_change(self) -> None:
        due = find_due_change(self.settings.timetable, self.zone, self._wall_ns())
        last = self.history.last_change
        if due is None or (last is not None and last.wall_ns >= due.wall_ns):
            return
        if not self._change_product(due.product, TIMETABLE):
            self.history.change_product(
                due.product, TIMETABLE, self._wall_ns()
            )  # it is done: a later change by hand holds

    def _change_product(self, name: str, by: str) -> bool:
        if name not in self._by_name:
            there = (
                f"there are {', '.join(self._by_name)}"
                if self._by_name
                else "the settings have no [[products]]"
            )
            raise InputError(f"product {name!r}: no such product; {there}")
        before = self.tag.product
        if name == before:
            return False
        self.history.change_product(name, by, self._wall_ns())
        self._set_tag(name, self.tag.batch)
        text = f"{name} instead of {before}" if before else name
        self.events.add("product", name, text, self._wall_ns(), by, {"before": before} if before else None)
        return True

    def _set_tag(self, name: str, batch: int) -> None:
        product = self._by_name.get(name)
        if product is None:
            self.tag = RecordTag(batch=batch)
        else:
            self.tag = RecordTag(name, product.density_kg_m3, product.sigma_kg_m3, batch)


def _check_name(name: str) -> str:
    name = name.strip()
    if not name or len(name) > _NAME_MAX or not name.isprintable():
        raise InputError(
            f"a batch's name has 1 to {_NAME_MAX} printable characters, not {name[:_NAME_MAX]!r}"
        )
    return name
