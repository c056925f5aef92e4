"""How many of the examples of a property are tried: a part in ``make test``, all in ``make thorough``.

A test or case with the mark ``thorough`` shows on more inputs what another test shows in ``make test``; it runs in
``make thorough`` only.
"""

from __future__ import annotations

import os

from hypothesis import settings

THOROUGH = os.environ.get("BELTSCAPE_THOROUGH") == "1"
"""Whether all is tried."""


def count_examples(most: int) -> int:
    """Return how many of at most this number of examples are tried."""
    return most if THOROUGH else max(3, most // 4)


def examples(most: int) -> settings:
    """Return the setting of a property that is tried with at most this number of examples."""
    return settings(max_examples=count_examples(most), deadline=None)
