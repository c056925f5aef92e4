"""Identity of two ledgers to the last digit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from beltscape.reprocessing.comparison.ledger import LedgerColumns

_NUMBERING = ("number", "run")
"""Columns that say nothing of the belt: they count records and starts of the program."""


def count_differing_values(first: LedgerColumns, second: LedgerColumns) -> Mapping[str, int]:
    """Return the columns in which two ledgers differ, each with the number of records; empty if they are identical.

    Numbers of records and runs and the wall clock do not count. Ledgers of different length differ in ``records``, by
    the difference of their numbers.
    """
    if len(first) != len(second):
        return {"records": abs(len(first) - len(second))}
    found: dict[str, int] = {}
    for name in LedgerColumns.__dataclass_fields__:
        one, other = getattr(first, name), getattr(second, name)
        if name in _NUMBERING:
            continue
        differs = one != other
        if one.dtype.kind == "f":
            differs &= ~(np.isnan(one) & np.isnan(other))
        if count := int(np.count_nonzero(differs)):
            found[name] = count
    return found
