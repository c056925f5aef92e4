"""What candidate propagation is given, checked once at the wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import flags, float32, sampled_images

MOST_OFFSETS = 254
MOST_CANDIDATES = 8
FARTHEST_OFFSET = 32767


@dataclass(frozen=True, slots=True, eq=False)
class PropagateInput:
    """A surface, what the cameras see, and what the choice depends on."""

    s: NDArray[np.float32]
    """(H, W) nearness; NaN where there is none."""
    slope_u: NDArray[np.float32]
    """(H, W)"""
    slope_v: NDArray[np.float32]
    """(H, W)"""
    core: NDArray[np.float32]
    """(H, W) grey levels."""
    images: list[NDArray[np.float32]]
    """n of (h, w) grey levels, each at least 2 × 2."""
    views: NDArray[np.float32]
    """(n, 21), see `beltscape.kernels.reference.view.see`."""
    buffers: list[NDArray[np.float32]]
    """n of (h, w)."""
    offsets: NDArray[np.int32]
    """(m, 2) dx, dy."""
    candidates: int
    separation: float
    floor: float
    unseen_cost: float
    tolerance: float
    small_jump: float
    large_jump: float
    active: NDArray[np.uint8] | None
    """(H, W), or all are."""


def propagate_input(
    s: NDArray[np.floating],
    slope_u: NDArray[np.floating],
    slope_v: NDArray[np.floating],
    core: NDArray[np.floating],
    images: Sequence[NDArray[np.floating]],
    views: NDArray[np.floating],
    buffers: Sequence[NDArray[np.floating]],
    *,
    offsets: NDArray[np.integer],
    candidates: int,
    numbers: dict[str, float],
    active: NDArray[np.uint8] | None,
) -> PropagateInput:
    """The input of `propagate` as the kernels take it, or KernelError."""
    s = float32("s", s, ("H", "W"))
    if not images:
        raise KernelError("propagation needs at least one auxiliary image")
    images = sampled_images(images)
    if len(buffers) != len(images):
        raise KernelError(f"buffers must be {len(images)}, as the images are, not {len(buffers)}")
    if not 1 <= candidates <= MOST_CANDIDATES:
        raise KernelError(f"candidates must be 1 to {MOST_CANDIDATES}, not {candidates}")
    return PropagateInput(
        s=s,
        slope_u=float32("slope_u", slope_u, s.shape),
        slope_v=float32("slope_v", slope_v, s.shape),
        core=float32("core", core, s.shape),
        images=images,
        views=float32("views", views, (len(images), 21)),
        buffers=[float32(f"buffers[{i}]", b, images[i].shape) for i, b in enumerate(buffers)],
        offsets=_offsets(offsets),
        candidates=candidates,
        active=None if active is None else flags("active", active, s.shape),
        **_numbers(**numbers),
    )


def _offsets(offsets: NDArray[np.integer]) -> NDArray[np.int32]:
    offsets = np.asarray(offsets)
    if offsets.ndim != 2 or offsets.shape[1] != 2 or len(offsets) > MOST_OFFSETS:
        raise KernelError(
            f"offsets must have the shape (m, 2) with m of at most {MOST_OFFSETS}, not {offsets.shape}"
        )
    if not np.issubdtype(offsets.dtype, np.integer):
        raise KernelError(f"offsets must be integers, not {offsets.dtype}")
    if offsets.size and np.abs(offsets.astype(np.int64)).max() > FARTHEST_OFFSET:
        raise KernelError(f"offsets must be at most {FARTHEST_OFFSET} px, not {np.abs(offsets).max()}")
    return np.ascontiguousarray(offsets, dtype=np.int32)


def _numbers(
    separation: float,
    floor: float,
    unseen_cost: float,
    tolerance: float,
    small_jump: float,
    large_jump: float,
) -> dict[str, float]:
    for name, value in (("separation", separation), ("floor", floor)):
        if not 0 < value < np.inf:
            raise KernelError(f"{name} must be positive, not {value}")
    if not 0 <= unseen_cost <= 1:
        raise KernelError(f"unseen_cost must be 0 to 1, not {unseen_cost}")
    if not 0 <= tolerance < np.inf:
        raise KernelError(f"tolerance must not be negative, not {tolerance}")
    if not (0 <= small_jump < np.inf and 0 <= large_jump <= 100):
        raise KernelError(
            f"jumps must be 0 <= small_jump and 0 <= large_jump <= 100, not {small_jump} and {large_jump}"
        )
    return {
        "separation": separation,
        "floor": floor,
        "unseen_cost": unseen_cost,
        "tolerance": tolerance,
        "small_jump": small_jump,
        "large_jump": large_jump,
    }
