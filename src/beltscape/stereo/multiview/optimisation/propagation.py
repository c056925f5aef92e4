"""Propagation: pixels near depth steps may take over the surface of a pixel in one of eight directions."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.parallel import run_pair
from beltscape.stereo.multiview.frame.surface import OCCLUDER_PX, Surface, detect_depth_steps

_DIRECTIONS = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)], float)
"""Directions (columns, rows) from which candidates come."""


@dataclass(frozen=True, slots=True, eq=False)
class PropagationResult:
    """The surface of the selected candidates, with cost and margin."""

    surface: Surface
    cost: NDArray[np.float32]
    """(H, W) dissimilarity of the selected candidate, 0..1."""
    margin: NDArray[np.float32]
    """(H, W) difference to the cost of the next candidate with another s."""


def list_propagation_offsets(distances_px: tuple[int, ...], turn: int | None = None) -> NDArray[np.int32]:
    """Return the (8 · n, 2) offsets (du, dv) in eight directions at n distances.

    With a ``turn`` it is half of them: the straight directions at every other distance and the diagonals at the rest;
    the next turn has the other half.
    """
    unit = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
    straight, diagonal = unit[:4], unit[4:]
    taken = [unit if turn is None else (straight, diagonal)[(i + turn) % 2] for i in range(len(distances_px))]
    return np.concatenate(
        [np.rint(directions * distance) for directions, distance in zip(taken, distances_px, strict=True)]
    ).astype(np.int32)


def propagate(
    surface: Surface, prepared: PreparedFrame, distances_px: tuple[int, ...], turn: int | None = None
) -> PropagationResult:
    """Return the best of the surfaces continued from neighbours, compared in the views that see them.

    Candidates come from all directions at every distance or, with a ``turn``, from half of these in alternation.
    """
    context = prepared.context
    kernels, threads = context.kernels, context.threads
    buffers, active = run_pair(
        lambda: kernels.inverse_depth_buffers(surface.s, prepared.views, prepared.sizes, threads=threads),
        lambda: mask_near_steps(surface.s, reach_px=max(1, min(distances_px) // 2)),
        threads,
    )
    selected = kernels.propagate(
        surface.s, surface.slope_u, surface.slope_v, prepared.core, prepared.images, prepared.views, buffers,
        offsets=list_propagation_offsets(distances_px, turn), floor=prepared.noise.floor, tolerance=OCCLUDER_PX,
        active=active, threads=threads,
    )  # fmt: skip
    return PropagationResult(
        Surface(selected.s, selected.slope_u, selected.slope_v), selected.cost, selected.margin
    )


def mask_near_steps(s: NDArray[np.float32], reach_px: int) -> NDArray[np.uint8]:
    """Return (H, W) 1 within reach of a depth step; elsewhere all candidates are the same surface."""
    step = detect_depth_steps(s).astype(np.uint8)
    return np.asarray(cv2.dilate(step, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)), np.uint8)
