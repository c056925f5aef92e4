"""Near depth steps a pixel may take over its neighbours' surface: candidates from eight directions, one choice."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.surface import Surface, detect_depth_steps
from beltscape.stereo.multiview.frame.visibility import OCCLUDER_PX

_DIRECTIONS = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)], float)


@dataclass(frozen=True, slots=True, eq=False)
class PropagationResult:
    """The surface of the chosen candidates, and how clear the choice was."""

    surface: Surface
    cost: NDArray[np.float32]
    """(H, W) dissimilarity of the chosen candidate, 0..1."""
    margin: NDArray[np.float32]
    """(H, W) how far the next different candidate lies above it."""


def offsets(distances_px: tuple[int, ...], turn: int | None = None) -> NDArray[np.int32]:
    """(8 · n, 2) offsets (du, dv) in eight directions at so many distances.

    With a ``turn`` half of them, straight ones at every other distance and diagonals at the rest, in the next turn
    the other half.
    """
    unit = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
    straight, diagonal = unit[:4], unit[4:]
    taken = [unit if turn is None else (straight, diagonal)[(i + turn) % 2] for i in range(len(distances_px))]
    return np.concatenate(
        [np.rint(directions * distance) for directions, distance in zip(taken, distances_px, strict=True)]
    ).astype(np.int32)


def propagate(
    surface: Surface,
    prepared: PreparedFrame,
    distances_px: tuple[int, ...],
    kernels: Kernels,
    threads: int,
    turn: int | None = None,
) -> PropagationResult:
    """One round: shifted, slope-extrapolated copies of the surface compete where the views see them.

    They come from all directions at every distance, or, with a ``turn``, from half of these in alternation.
    """
    buffers = kernels.inverse_depth_buffers(surface.s, prepared.views, prepared.sizes, threads=threads)
    active = mask_near_steps(surface.s, reach_px=max(1, min(distances_px) // 2))
    chosen = kernels.propagate(
        surface.s, surface.slope_u, surface.slope_v, prepared.core, prepared.images, prepared.views, buffers,
        offsets=offsets(distances_px, turn), floor=prepared.noise.floor, tolerance=OCCLUDER_PX, active=active,
        threads=threads,
    )  # fmt: skip
    return PropagationResult(Surface(chosen.s, chosen.slope_u, chosen.slope_v), chosen.cost, chosen.margin)


def mask_near_steps(s: NDArray[np.float32], reach_px: int) -> NDArray[np.uint8]:
    """(H, W) 1 where a depth step is within reach: elsewhere all candidates are the same surface."""
    step = detect_depth_steps(fill_nan(s)).astype(np.uint8)
    return np.asarray(cv2.dilate(step, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)), np.uint8)
