"""Plays rows in several processes at the same time."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from faults.capture import RoundCapture
from faults.case import Case
from faults.matching import Cache
from faults.player import play
from faults.verdict import RowResult, assess

_cache: Cache = {}
"""Depth maps of the sound plant's images, of this process."""


def play_rows(
    captures: Mapping[float | None, RoundCapture],
    cases: Sequence[Case],
    *,
    jobs: int = 1,
    minutes: float = math.inf,
) -> Iterator[RowResult]:
    """Yield the verdicts in the order of the rows; no row begins after ``minutes``.

    ``captures`` are those of the belts' widths.
    """
    end = time.monotonic() + 60 * minutes
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        own = [captures[case.belt_width_mm] for case in cases]
        for verdict in pool.map(partial(play_row, end), own, cases):
            if verdict is not None:
                yield verdict


def play_row(end: float, capture: RoundCapture, case: Case) -> RowResult | None:
    """Play a row; None where it would begin after ``end``, on the monotonic clock."""
    if time.monotonic() > end:
        return None
    own: Cache = dict(_cache)
    verdict = assess(capture, play(capture, case, own))
    if case.is_sound or set(case.faults) == {"encoder"}:
        _cache.update(own)
    return verdict
