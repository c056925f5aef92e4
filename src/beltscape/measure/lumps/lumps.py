"""Lumps of a depth map: their outlines, sizes, size distribution, and the oversize alarm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from beltscape.core.arguments import require_depth_of
from beltscape.core.depth import DepthMap
from beltscape.core.display import Displayed
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.measure.belt.empty_belt import Belt
from beltscape.measure.lumps.distribution import SizeDistribution, compute_distribution
from beltscape.measure.lumps.raster import Raster, make_raster
from beltscape.measure.lumps.segment import Segmentation, segment_lumps
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.measure.lumps.shape import Lump, measure_shapes

FINES = 65_535
"""Label of load that is not part of a lump."""
_MAX_LUMPS = FINES - 1
"""The labels are 16-bit."""
DOWN = Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""Without an empty belt the camera is assumed to point vertically down; z is upwards from the camera."""
BIAS = (
    "Only the top layer is seen. Large lumps stand out and are cut by the frame more often; small ones slip "
    "between and beneath others; hidden parts make lumps look smaller. The distribution is that of the lumps in "
    "view, fines left out; it follows changes of the material, but is not the sieve analysis of the whole load."
)
"""Limits of the distribution; see Thurley 2011, 10.1016/j.jprocont.2010.11.011, section 1."""


@dataclass(frozen=True, slots=True)
class Oversize:
    """The oversize alarm of a frame."""

    limit_mm: float
    probability: float
    """Probability that at least one lump in view is larger than the limit, 0..1."""
    alarm: bool
    """Whether any lump is larger than the limit with a probability above one half."""
    lumps: tuple[tuple[int, float], ...]
    """(number, probability) of each lump that exceeds the limit with at least 5 %, by descending probability."""


@dataclass(frozen=True, slots=True, eq=False)
class Lumps(Displayed):
    """All lumps of a frame."""

    lumps: tuple[Lump, ...]
    """In the order of their numbers."""
    labels: NDArray[np.uint16]
    """(H, W) uint16 on the core's pinhole grid: a lump's number, `FINES` for load outside lumps (if the empty belt is
    given), else 0."""
    frame: str
    """"belt" or "core": the frame of the lumps' centres."""
    cell_mm: float
    """Width of a cell of the segmented raster, at the median depth."""
    smallest_mm: float
    """Smaller lumps are not resolved and count as fines."""
    fines_share: float
    """Share of the load's visible area outside lumps; NaN without an empty belt."""
    all: SizeDistribution
    """Distribution of all lumps that the frame does not cut."""
    whole: SizeDistribution
    """Distribution of those among them that are fully visible."""
    oversize: Oversize | None

    def __repr__(self) -> str:
        d50, sigma = self.all.d_mm[1], self.all.d_sigma_mm[1]
        return f"Lumps({len(self.lumps)} lumps, d50 {d50:.1f} ± {sigma:.1f} mm)"


def measure_lumps(depth: DepthMap, camera: Camera, settings: LumpSettings, belt: Belt | None = None) -> Lumps:
    """Segment the lumps of a depth map and measure them.

    With the empty ``belt`` positions are given in its frame, and only points above it can belong to a lump; without
    it the optical axis counts as vertical.

    Raises
    ------
    InputError
        if the depth map is not the camera's size.
    """
    require_depth_of(camera, depth, "lumps")
    raster = make_raster(depth, camera, settings.raster_pixels)
    if raster is None:
        return _make_empty_result(depth, settings, belt)
    cell_mm = float(np.median(raster.depth_mm[raster.measured])) * raster.cell_rad
    load = None if belt is None else _mask_above_belt(raster, belt, cell_mm)
    segmentation = segment_lumps(raster, settings.split, settings.smallest_px, allowed=load)
    lumps = measure_shapes(
        raster, segmentation.labels, segmentation.outline, DOWN if belt is None else belt.belt_from_core
    )
    # a systematic error of all pixels moves a lump's edges by up to its size
    lumps = [replace(lump, sigma_mm=float(np.hypot(lump.sigma_mm, depth.systematic_mm))) for lump in lumps]
    kept = [lump for lump in lumps if lump.width_mm >= settings.smallest_px * cell_mm][:_MAX_LUMPS]
    lumps, cells = _renumber(kept, segmentation)
    loaded = None if load is None else load & raster.measured
    fines = np.nan if loaded is None else float(((cells == 0) & loaded).sum() / max(loaded.sum(), 1))
    if loaded is not None:
        cells = np.where((cells == 0) & loaded, FINES, cells)
    uncut = [lump for lump in lumps if not lump.cut]
    return Lumps(
        lumps=lumps,
        labels=_enlarge(cells, raster.factor, depth.depth_mm.shape),
        frame="core" if belt is None else "belt",
        cell_mm=cell_mm,
        smallest_mm=settings.smallest_px * cell_mm,
        fines_share=fines,
        all=_compute_distribution(uncut, lumps, raster, settings),
        whole=_compute_distribution([lump for lump in uncut if not lump.occluded], lumps, raster, settings),
        oversize=None if settings.oversize_mm is None else assess_oversize(lumps, settings.oversize_mm),
    )


def _make_empty_result(depth: DepthMap, settings: LumpSettings, belt: Belt | None) -> Lumps:
    """Return the result for a depth map without any measured pixel."""
    empty = np.zeros(0)
    none = compute_distribution(empty, empty, np.array(settings.sieves_mm))
    alarm = None if settings.oversize_mm is None else assess_oversize((), settings.oversize_mm)
    labels = np.zeros(depth.depth_mm.shape, np.uint16)
    frame = "core" if belt is None else "belt"
    return Lumps((), labels, frame, np.nan, np.nan, np.nan, none, none, alarm)


def _mask_above_belt(raster: Raster, belt: Belt, cell_mm: float) -> NDArray[np.bool_]:
    """Return the cells (R, C) that rise above the empty belt."""
    points = belt.belt_from_core.apply(raster.points_mm)
    over = points[..., 2] - belt.height_mm(points[..., 0])
    return over > max(6 * belt.noise_mm, 2 * cell_mm)


def _renumber(kept: Sequence[Lump], segmentation: Segmentation) -> tuple[tuple[Lump, ...], NDArray[np.int64]]:
    """Return the kept lumps numbered from 1, and their numbers on the raster (R, C)."""
    number = np.zeros(segmentation.count + 1, np.int64)
    for new, lump in enumerate(kept, 1):
        number[lump.number] = new
    return tuple(replace(lump, number=new) for new, lump in enumerate(kept, 1)), number[segmentation.labels]


def _enlarge(cells: NDArray[np.int64], factor: int, shape: tuple[int, ...]) -> NDArray[np.uint16]:
    """Return the raster's numbers on the depth map's pixels (H, W); the last cells extend to the far ends."""
    large = np.repeat(np.repeat(cells.astype(np.uint16), factor, axis=0), factor, axis=1)
    missing = [(0, whole - part) for whole, part in zip(shape, large.shape, strict=True)]
    return np.pad(large, missing, mode="edge")


def _compute_distribution(
    chosen: Sequence[Lump], lumps: Sequence[Lump], raster: Raster, settings: LumpSettings
) -> SizeDistribution:
    """Return the distribution by mass; a lump's weight is 1/P(not cut), as the frame cuts large ones more often."""
    size = np.array([lump.size_mm for lump in chosen])
    mass = np.array([lump.volume_mm3 for lump in chosen])
    if any(lump.cut for lump in lumps):
        # Miles & Lantuéjoul, see Serra 1982, Image Analysis and Mathematical Morphology, ch. VIII
        along = float(np.ptp(raster.points_mm[..., 1][raster.measured]))
        reach = np.array([lump.length_mm for lump in chosen])
        mass = mass / np.clip(1 - reach / along, 0.25, 1)
    return compute_distribution(size, mass, np.array(settings.sieves_mm))


def assess_oversize(lumps: Sequence[Lump], limit_mm: float) -> Oversize:
    """Assess which lumps exceed a limit, with probabilities; a lump cut by the frame counts by its visible part."""
    probabilities = [(lump.number, float(ndtr((lump.size_mm - limit_mm) / lump.sigma_mm))) for lump in lumps]
    none = float(np.prod([1 - probability for _, probability in probabilities]))
    likely = sorted((pair for pair in probabilities if pair[1] >= 0.05), key=lambda pair: (-pair[1], pair[0]))
    return Oversize(limit_mm, 1 - none, any(probability > 0.5 for _, probability in likely), tuple(likely))
