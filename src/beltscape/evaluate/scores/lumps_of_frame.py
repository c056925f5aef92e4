"""Scores of the lumps of a reconstructed frame, or of the true depth, against their simulated heap."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.evaluate.scores.lumps import LumpScore, score_lumps
from beltscape.files.arrays import read_arrays
from beltscape.files.reconstruction import read_frame
from beltscape.files.rig_json import read_rig
from beltscape.measure.lumps.lumps import measure_lumps
from beltscape.measure.lumps.settings import LumpSettings

_FULL = 0.5
"""Rows with a coverage below this share of the median row's are not compared."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueHeap:
    """The rocks of a simulated frame on the core's grid of H × W pixels."""

    camera: Camera
    depth: DepthMap
    """True depth with a negligible σ."""
    rock: NDArray[np.int32]
    """(H, W) number of the rock that each pixel shows, -1: none."""
    size_mm: NDArray[np.float64]
    """(N,) of the rocks."""
    volume_mm3: NDArray[np.float64]
    """(N,) of the rocks."""

    @property
    def pixel_mm(self) -> float:
        """Width of a pixel on the rocks."""
        return float(np.median(self.depth.depth_mm[self.rock >= 0])) / float(self.camera.focal_px.mean())


def read_heap(truth: Path) -> TrueHeap:
    """Read the heap of a truth folder of ``beltscape simulate``.

    Raises
    ------
    InputError
        When it contains no scene with rocks, or several.
    """
    if not truth.is_dir():
        raise InputError(f"{truth}: no such folder; give truth/ of one loaded belt by beltscape simulate")
    rocks = sorted(truth.glob("*_rocks.npz"))
    if len(rocks) != 1:
        raise InputError(
            f"{truth}: holds {len(rocks)} *_rocks.npz; give truth/ of one loaded belt by beltscape simulate"
        )
    bodies = read_arrays(rocks[0])
    size, volume = (bodies[name].astype(np.float64) for name in ("size_mm", "volume_mm3"))
    seen = rocks[0].with_name(rocks[0].name.replace("_rocks", "_depth"))
    if not seen.is_file():
        raise InputError(f"{seen}: is missing beside {rocks[0].name}; simulate the scene again")
    arrays = read_arrays(seen)
    depth = arrays["depth_mm"].astype(np.float32)
    rock = arrays["rock"].astype(np.int32) if "rock" in arrays else np.full(depth.shape, -1, np.int32)
    if depth.ndim != 2 or not (rock >= 0).any():
        raise InputError(f"{seen}: shows no rock in a single frame; simulate belt_loaded with rocks")
    valid = np.isfinite(depth)
    perfect = DepthMap(
        depth,
        np.where(valid, 0.01, np.nan).astype(np.float32),
        valid.astype(np.uint8),
        valid.astype(np.float32),
    )
    return TrueHeap(read_rig(truth / "rig.json").core_camera, perfect, rock, size, volume)


def score_lumps_of_frame(
    heap: TrueHeap, frame: Path | None, settings: LumpSettings, over_mm: float
) -> LumpScore:
    """Score the lumps measured in a frame's folder, or in the true depth (None), which gives the upper bound.

    Only rows that the matcher covered are compared.

    Raises
    ------
    InputError
        When the frame has another size than the truth.
    """
    camera, depth = heap.camera, heap.depth
    if frame is not None:
        result = read_frame(frame)
        camera, depth = result.rig.core_camera, result.depth
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
