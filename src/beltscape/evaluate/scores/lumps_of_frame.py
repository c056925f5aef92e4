"""Lumps of a reconstructed frame, or of the true depth itself, against the heap they were simulated from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.evaluate.scores.lumps import LumpScore, score_lumps
from beltscape.files.reconstruction import read_frame
from beltscape.files.rig_json import read_rig
from beltscape.measure.lumps.lumps import measure_lumps
from beltscape.measure.lumps.settings import LumpSettings

_FULL = 0.5
"""Rows of which a matcher reached less than this share of what it did in the middle do not count."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueHeap:
    """What a simulated frame shows of its rocks, on the core's grid of H × W pixels."""

    camera: Camera
    depth: DepthMap
    """A perfect one."""
    rock: NDArray[np.int32]
    """(H, W) number of the rock that each pixel shows, -1 where it shows none."""
    size_mm: NDArray[np.float64]
    """(N,) of the rocks."""
    volume_mm3: NDArray[np.float64]
    """(N,) of the rocks."""

    @property
    def pixel_mm(self) -> float:
        """Width of a pixel on the rocks."""
        return float(np.median(self.depth.depth_mm[self.rock >= 0])) / float(self.camera.focal_px.mean())


def read_heap(truth: Path) -> TrueHeap:
    """The heap of a truth folder of ``beltscape simulate``.

    Raises
    ------
    InputError
        When it holds no scene with rocks, or several.
    """
    if not truth.is_dir():
        raise InputError(f"{truth}: no such folder; give truth/ of one loaded belt by beltscape simulate")
    rocks = sorted(truth.glob("*_rocks.npz"))
    if len(rocks) != 1:
        raise InputError(
            f"{truth}: holds {len(rocks)} *_rocks.npz; give truth/ of one loaded belt by beltscape simulate"
        )
    with np.load(rocks[0]) as arrays:
        size, volume = (arrays[name].astype(np.float64) for name in ("size_mm", "volume_mm3"))
    seen = rocks[0].with_name(rocks[0].name.replace("_rocks", "_depth"))
    if not seen.is_file():
        raise InputError(f"{seen}: is missing beside {rocks[0].name}; simulate the scene again")
    with np.load(seen) as arrays:
        depth = arrays["depth_mm"].astype(np.float32)
        rock = arrays["rock"].astype(np.int32) if "rock" in arrays else np.full(depth.shape, -1, np.int32)
    if depth.ndim != 2 or not (rock >= 0).any():
        raise InputError(f"{seen}: shows no rock in a single frame; simulate belt_loaded with rocks")
    known = np.isfinite(depth)
    perfect = DepthMap(
        depth,
        np.where(known, 0.01, np.nan).astype(np.float32),
        known.astype(np.uint8),
        known.astype(np.float32),
    )
    return TrueHeap(read_rig(truth / "rig.json").core_camera, perfect, rock, size, volume)


def score_frame(heap: TrueHeap, frame: Path | None, settings: LumpSettings, over_mm: float) -> LumpScore:
    """Lumps measured in a frame's folder (None: by the true depth, the ceiling of what depth tells).

    Of a matched frame the rows are compared that the matcher reached.

    Raises
    ------
    InputError
        When the frame has another size than the truth.
    """
    camera, depth = heap.camera, heap.depth
    if frame is not None:
        seen = read_frame(frame)
        camera, depth = seen.rig.core_camera, seen.depth
    if depth.depth_mm.shape != heap.rock.shape:
        sizes = ["{1}×{0}".format(*shape) for shape in (depth.depth_mm.shape, heap.rock.shape)]
        raise InputError(f"{frame}: has {sizes[0]} pixels, its truth {sizes[1]}; give both of one capture")
    full = depth.measured.mean(axis=1)
    rows = np.flatnonzero(full > _FULL * np.median(full))
    region = np.zeros(heap.rock.shape, bool)
    if rows.size:
        region[rows[0] : rows[-1] + 1] = True
    return score_lumps(
        measure_lumps(depth, camera, settings), heap.rock, heap.size_mm, heap.volume_mm3,
        pixel_mm=heap.pixel_mm, over_mm=over_mm, region=region, measured=depth.measured,
    )  # fmt: skip
