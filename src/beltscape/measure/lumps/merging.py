"""Hierarchical merging of regions across their weakest borders."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.lumps.basins import Borders


def merge_regions(number: int, borders: Borders, limit: float) -> NDArray[np.int64]:
    """Return the new number of each region (number,), from 0, after merging across borders below the limit.

    The weakest border is merged first. A border's strength is its mean over its length, so the borders of merged
    regions are pooled (the boundary-mean hierarchy of Arbeláez et al. 2011, 10.1109/TPAMI.2010.161).
    """
    beside: list[dict[int, tuple[float, int]]] = [{} for _ in range(number)]
    queue: list[tuple[float, int, int]] = []
    columns = (borders.first, borders.second, borders.sum, borders.length)
    for a, b, total, length in zip(*(column.tolist() for column in columns), strict=True):
        beside[a][b] = beside[b][a] = (total, length)
        queue.append((total / length, a, b))
    heapify(queue)
    root = np.arange(number)
    while queue and queue[0][0] < limit:
        strength, a, b = heappop(queue)
        border = beside[a].get(b)
        if border is None or border[0] / border[1] != strength:
            continue  # merged or extended meanwhile
        keep, give = (a, b) if len(beside[a]) >= len(beside[b]) else (b, a)
        root[give] = keep
        del beside[keep][give], beside[give][keep]
        for other, (total, length) in beside[give].items():
            del beside[other][give]
            more = beside[keep].get(other, (0.0, 0))
            joint = (total + more[0], length + more[1])
            beside[keep][other] = beside[other][keep] = joint
            heappush(queue, (joint[0] / joint[1], min(keep, other), max(keep, other)))
        beside[give] = {}
    while True:
        further = root[root]
        if (further == root).all():
            return np.unique(root, return_inverse=True)[1]
        root = further
