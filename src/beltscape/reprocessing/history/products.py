"""Product and batch of a record at its time, from the timetable and the plant's own history."""

from __future__ import annotations

import sqlite3
from bisect import bisect_right
from collections.abc import Callable, Sequence

from beltscape.core.belt.ledger_entries import RecordTag
from beltscape.core.progress import Reporter
from beltscape.pipeline.live.project import Project, RunSettings
from beltscape.production.calendar import open_zone
from beltscape.production.timetable import find_due_change
from beltscape.reprocessing.comparison.reading import ChangedMeanwhileError, open_history
from beltscape.sinks.historian.reading.production import read_changes
from beltscape.sinks.historian.writing.recovery import DATABASE

_LATEST_NS = 2**63 - 1
"""The last time that SQLite can hold."""
_MINUTE_NS = 60 * 10**9
"""The live system looks at its timetable once a minute."""
Change = tuple[int, str]
"""System clock, ns, and the name of the product from then on."""


def read_product_changes(project: Project[RunSettings], reporter: Reporter) -> list[Change]:
    """Return the changes that people and the timetable made in the plant, by its own history, if there is one."""
    path = project.resolve(project.settings.data) / DATABASE
    if not project.settings.products or not path.is_file():
        return []
    try:
        with open_history(path) as connection:
            return [(one.wall_ns, one.product) for one in read_changes(connection, 0, _LATEST_NS)]
    except (ChangedMeanwhileError, sqlite3.Error, OSError) as error:
        reason = " ".join(str(error).split()) or "it changes meanwhile"
        reporter.warn(f"{path}: cannot be read ({reason}); products follow the timetable alone")
        return []


def find_no_product(wall_ns: int) -> RecordTag:
    """Return no product, whatever the time."""
    del wall_ns
    return RecordTag()


def make_tag_finder(project: Project[RunSettings], changes: Sequence[Change]) -> Callable[[int], RecordTag]:
    """Return the function that gives a record's product by the system clock's time.

    The newest change counts: of the timetable, or of ``changes``, which people made; before the first of them the
    settings' first product. Densities are those of the settings.
    """
    settings, production = project.settings, project.settings.production
    if not settings.products:
        return find_no_product
    by_name = {product.name: product for product in settings.products}
    zone, first = open_zone(production.time_zone), production.product or settings.products[0].name
    known = sorted(change for change in changes if change[1] in by_name)
    times = [wall_ns for wall_ns, _ in known]
    due_by_minute: dict[int, Change | None] = {}

    def find_due(wall_ns: int) -> Change | None:
        minute = wall_ns // _MINUTE_NS
        if minute not in due_by_minute:
            due = find_due_change(production.timetable, zone, minute * _MINUTE_NS)
            due_by_minute.clear()
            due_by_minute[minute] = None if due is None else (due.wall_ns, due.product)
        return due_by_minute[minute]

    def find_tag(wall_ns: int) -> RecordTag:
        due, place = find_due(wall_ns), bisect_right(times, wall_ns)
        made = known[place - 1] if place else None
        newest = max((one for one in (due, made) if one is not None), default=(0, first))
        product = by_name[newest[1]]
        return RecordTag(product.name, product.density_kg_m3, product.sigma_kg_m3)

    return find_tag
