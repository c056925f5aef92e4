"""Depth map → lumps, their size distribution, and whether any is too large."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from beltscape.core.arguments import require_depth_of
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.pose import Pose
from beltscape.measure.belt.empty_belt import Belt
from beltscape.measure.lumps.distribution import SizeDistribution, distribution
from beltscape.measure.lumps.raster import Raster, make_raster
from beltscape.measure.lumps.segment import Segmentation, segment
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.measure.lumps.shape import Lump, shapes

FINES = 65_535
"""Label of what lies on the belt and is no lump."""
_MOST = FINES - 1
_DOWN = Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""Without an empty belt the camera is taken to look straight down; z is upwards, with its origin at the camera."""
BIAS = (
    "Only the top layer is seen. Large lumps stand out and are cut by the frame more often; small ones slip "
    "between and beneath others; hidden parts make lumps look smaller. The distribution is that of the lumps in "
    "view, fines left out; it follows changes of the material, but is not the sieve analysis of the whole load."
)
"""What the distribution does not tell; see Thurley 2011, 10.1016/j.jprocont.2010.11.011, section 1."""


@dataclass(frozen=True, slots=True)
class Oversize:
    """The alarm."""

    limit_mm: float
    probability: float
    """That at least one lump in view is larger than the limit, 0..1."""
    alarm: bool
    """Whether any lump is so more likely than not."""
    lumps: tuple[tuple[int, float], ...]
    """(number, probability) of each lump over the limit with at least 5 %, the likeliest first."""


@dataclass(frozen=True, slots=True, eq=False)
class Lumps:
    """All lumps of a frame."""

    lumps: tuple[Lump, ...]
    """In the order of their numbers."""
    labels: NDArray[np.uint16]
    """(H, W) uint16 on the core's pinhole grid: a lump's number, `FINES` where the empty belt is known and what
    lies on it is no lump, else 0."""
    frame: str
    """"belt" or "core": the frame of the lumps' middles."""
    cell_mm: float
    """Width of a cell of the raster that the lumps were told apart on, at the median depth."""
    smallest_mm: float
    """Below this size nothing is told apart: fines."""
    fines_share: float
    """Share of the load's visible area that is no lump; NaN where the empty belt is not known."""
    all: SizeDistribution
    """Of all lumps that the frame does not cut."""
    whole: SizeDistribution
    """Of those of them that are fully visible."""
    oversize: Oversize | None


def measure_lumps(depth: DepthMap, camera: Camera, settings: LumpSettings, belt: Belt | None = None) -> Lumps:
    """Tell the lumps of a depth map apart and measure them.

    With the empty ``belt`` places are given in its frame, and only what rises above it can be a lump; without,
    the optical axis counts as vertical.

    Raises
    ------
    InputError
        if the depth map is not the camera's size.
    """
    require_depth_of(camera, depth, "lumps")
    raster = make_raster(depth, camera, settings.raster_pixels)
    if raster is None:
        return _nothing(depth, settings, belt)
    cell_mm = float(np.median(raster.depth_mm[raster.measured])) * raster.cell_rad
    load = None if belt is None else _over_belt(raster, belt, cell_mm)
    found = segment(raster, settings.split, settings.smallest_px, allowed=load)
    lumps = shapes(raster, found.labels, found.outline, _DOWN if belt is None else belt.belt_from_core)
    # an error that all pixels share moves a lump's edges by up to itself
    lumps = [replace(lump, sigma_mm=float(np.hypot(lump.sigma_mm, depth.systematic_mm))) for lump in lumps]
    kept = [lump for lump in lumps if lump.width_mm >= settings.smallest_px * cell_mm][:_MOST]
    lumps, cells = _renumbered(kept, found)
    loaded = None if load is None else load & raster.measured
    fines = np.nan if loaded is None else float(((cells == 0) & loaded).sum() / max(loaded.sum(), 1))
    if loaded is not None:
        cells = np.where((cells == 0) & loaded, FINES, cells)
    entire = [lump for lump in lumps if not lump.cut]
    return Lumps(
        lumps=lumps,
        labels=_enlarged(cells, raster.factor, depth.depth_mm.shape),
        frame="core" if belt is None else "belt",
        cell_mm=cell_mm,
        smallest_mm=settings.smallest_px * cell_mm,
        fines_share=fines,
        all=_distribution(entire, lumps, raster, settings),
        whole=_distribution([lump for lump in entire if not lump.occluded], lumps, raster, settings),
        oversize=None if settings.oversize_mm is None else oversize(lumps, settings.oversize_mm),
    )


def _nothing(depth: DepthMap, settings: LumpSettings, belt: Belt | None) -> Lumps:
    empty = np.zeros(0)
    none = distribution(empty, empty, np.array(settings.sieves_mm))
    alarm = None if settings.oversize_mm is None else oversize((), settings.oversize_mm)
    labels = np.zeros(depth.depth_mm.shape, np.uint16)
    frame = "core" if belt is None else "belt"
    return Lumps((), labels, frame, np.nan, np.nan, np.nan, none, none, alarm)


def _over_belt(raster: Raster, belt: Belt, cell_mm: float) -> NDArray[np.bool_]:
    """(R, C) what rises above the empty belt."""
    points = belt.belt_from_core.apply(raster.points_mm)
    over = points[..., 2] - belt.height_mm(points[..., 0])
    return over > max(6 * belt.noise_mm, 2 * cell_mm)


def _renumbered(kept: Sequence[Lump], found: Segmentation) -> tuple[tuple[Lump, ...], NDArray[np.int64]]:
    """The kept lumps numbered from 1, and (R, C) their numbers."""
    number = np.zeros(found.count + 1, np.int64)
    for new, lump in enumerate(kept, 1):
        number[lump.number] = new
    return tuple(replace(lump, number=new) for new, lump in enumerate(kept, 1)), number[found.labels]


def _enlarged(cells: NDArray[np.int64], factor: int, shape: tuple[int, ...]) -> NDArray[np.uint16]:
    """(H, W) the raster's numbers on the depth map's pixels; the rest at the far ends as the last cell."""
    large = np.repeat(np.repeat(cells.astype(np.uint16), factor, axis=0), factor, axis=1)
    missing = [(0, whole - part) for whole, part in zip(shape, large.shape, strict=True)]
    return np.pad(large, missing, mode="edge")


def _distribution(
    chosen: Sequence[Lump], lumps: Sequence[Lump], raster: Raster, settings: LumpSettings
) -> SizeDistribution:
    """By mass. The frame cuts large lumps more often than small ones: each stands for 1/P(it is not cut)."""
    size = np.array([lump.size_mm for lump in chosen])
    mass = np.array([lump.volume_mm3 for lump in chosen])
    if any(lump.cut for lump in lumps):
        # Miles & Lantuéjoul, see Serra 1982, Image Analysis and Mathematical Morphology, ch. VIII
        along = float(np.ptp(raster.points_mm[..., 1][raster.measured]))
        reach = np.array([lump.length_mm for lump in chosen])
        mass = mass / np.clip(1 - reach / along, 0.25, 1)
    return distribution(size, mass, np.array(settings.sieves_mm))


def oversize(lumps: Sequence[Lump], limit_mm: float) -> Oversize:
    """Which lumps are larger than a limit, and how surely; one that the frame cuts counts as far as it is seen."""
    chances = [(lump.number, float(ndtr((lump.size_mm - limit_mm) / lump.sigma_mm))) for lump in lumps]
    none = float(np.prod([1 - chance for _, chance in chances]))
    likely = sorted((pair for pair in chances if pair[1] >= 0.05), key=lambda pair: (-pair[1], pair[0]))
    return Oversize(limit_mm, 1 - none, any(chance > 0.5 for _, chance in likely), tuple(likely))
