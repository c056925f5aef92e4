"""Lumps of a depth map: their outlines, sizes, size distribution, and the oversize alarm.

Size is the aperture of the sieve that a lump just passes, which its intermediate axis approximates (Krumbein 1941,
J. Sediment. Petrol. 11(2)). Lumps rest on their flat side, so the longest and the intermediate axis are visible from
above: they are the sides of the smallest rectangle around the outline, as in Thurley (2011,
10.1016/j.jprocont.2010.11.011). Occlusion by neighbours makes the rectangle too small: the size is then shrunk
towards the typical size of the frame's lumps.

The size distribution is by mass: passing shares of sieves, and the percentiles d10 to d90.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from beltscape.core.arguments import require_depth_of
from beltscape.core.depth import DepthMap
from beltscape.core.display import Displayed
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.measure.belt.empty_belt import Belt
from beltscape.measure.lumps.features import Raster, make_raster
from beltscape.measure.lumps.segment import Rims, Segmentation, measure_rims, segment_lumps
from beltscape.measure.lumps.settings import LumpSettings

OCCLUDED = 0.15
"""A lump counts as occluded above this hidden share of its outline."""
_HIDDEN = np.array([0.0, 0.12, 0.20, 0.27, 0.42, 0.60])
"""Hidden shares of the tables below, interpolated linearly: log(size/typical) = offset + slope·log(width/typical),
fitted to simulated heaps. A fully visible lump keeps its width; the more is hidden, the larger the size becomes
relative to the width, and the more the typical width of the frame's lumps counts."""
_OFFSET = np.array([0.03, 0.03, 0.07, 0.15, 0.32, 0.42])
"""Offset by hidden share."""
_SLOPE = np.array([1.0, 1.0, 0.9, 0.8, 0.7, 0.7])
"""Slope by hidden share."""
_SPREAD = np.array([0.08, 0.09, 0.15, 0.25, 0.33, 0.35])
"""Standard deviation of the logarithm."""
_BULK = 0.40
"""Factor of the volume: volume = factor · size³ · (outline's area / width²)^1.5."""
_FOOT = 0.2
"""Quantile of the visible heights at which the silhouette is measured."""
_OUTLINE_CELLS = 0.6
"""One standard deviation of the width due to the position of the outline, in cells."""


@dataclass(frozen=True, slots=True)
class Lump:
    """One lump of the top layer; lengths along and across the up direction of its frame."""

    number: int
    """Value in the label image, from 1."""
    center_mm: tuple[float, float, float]
    """Centre of the visible surface, in `Lumps.frame`."""
    size_mm: float
    """Estimated sieve size."""
    sigma_mm: float
    """One standard deviation of the size."""
    width_mm: float
    """Short side of the smallest rectangle around the visible part, from above."""
    length_mm: float
    """Long side of that rectangle."""
    area_mm2: float
    """Visible area, from above."""
    height_mm: float
    """Height difference between the lowest and the highest visible point."""
    volume_mm3: float
    """Volume estimated from size and outline."""
    hidden: float
    """Share of the outline, 0..1, that a nearer surface occludes."""
    occluded: bool
    """Whether ``hidden`` exceeds `OCCLUDED`."""
    cut: bool
    """Whether the lump touches the border of the frame or of the measured area."""
    outline: float
    """Mean probability of an outline along the rim, 0..1."""


def measure_shapes(
    raster: Raster, labels: NDArray[np.int64], outline: NDArray[np.float32], up_from_core: Pose
) -> tuple[Lump, ...]:
    """Measure the lumps of a label image (R, C); ``up_from_core`` transforms into a frame whose z points upwards."""
    count = int(labels.max())
    rims = measure_rims(raster, labels, outline, count)
    order = np.argsort(labels, axis=None, kind="stable")
    ends = np.searchsorted(labels.ravel()[order], np.arange(count + 2))
    points = up_from_core.apply(raster.points_mm).reshape(-1, 3)
    rays = np.concatenate([raster.rays, np.ones((*labels.shape, 1))], axis=-1).reshape(-1, 3)
    rays = rays @ up_from_core.rotation.T
    parts: list[_VisiblePart] = []
    for number in range(1, count + 1):
        cells = order[ends[number] : ends[number + 1]]
        parts.append(
            _measure_visible_part(points[cells], rays[cells], up_from_core.translation_mm, raster.cell_rad)
        )
    area = np.array([part.area_mm2 for part in parts])
    typical = float(np.sum([part.width_mm for part in parts] * area) / max(area.sum(), 1e-9))
    return tuple(_estimate_lump(number, part, rims, typical) for number, part in enumerate(parts, 1))


@dataclass(frozen=True, slots=True)
class _VisiblePart:
    """The visible part of a lump."""

    center_mm: tuple[float, float, float]
    width_mm: float
    length_mm: float
    area_mm2: float
    height_mm: float
    cell_mm: float


def _measure_visible_part(
    points: NDArray[np.float64], rays: NDArray[np.float64], eye_mm: NDArray[np.float64], cell_rad: float
) -> _VisiblePart:
    """Measure outline and area from points (n, 3) and the rays (n, 3) to them.

    The silhouette is projected onto a level near the lump's foot, where a round lump's outline lies. The depths at
    the outline itself may be those of the surface below, which would displace it laterally off the optical axis.
    """
    x, y, _ = np.median(points, axis=0)
    low, foot, top, high = np.quantile(points[:, 2], [0.02, _FOOT, 0.5, 0.98])
    distance = (foot - eye_mm[2]) / rays[:, 2]
    level = eye_mm[:2] + distance[:, None] * rays[:, :2]
    cell = float(np.median(distance)) * cell_rad
    _, sides, _ = cv2.minAreaRect((level - [x, y]).astype(np.float32))
    area = float(((distance * cell_rad) ** 2 / np.abs(rays[:, 2])).sum())
    # add the outermost cells' halves, less what the raster adds: at a step it keeps the upper surface
    width, length = min(sides) + 0.5 * cell, max(sides) + 0.5 * cell
    return _VisiblePart((float(x), float(y), float(top)), width, length, area, float(high - low), cell)


def _estimate_lump(number: int, part: _VisiblePart, rims: Rims, typical_mm: float) -> Lump:
    """Estimate a lump from its visible part and the typical width of the frame's lumps (their mean by area)."""
    length = max(rims.length[number], 1)
    hidden = float(rims.hidden[number] / length)
    offset, slope, spread = (float(np.interp(hidden, _HIDDEN, table)) for table in (_OFFSET, _SLOPE, _SPREAD))
    size = typical_mm * np.exp(offset) * (part.width_mm / typical_mm) ** slope
    volume = _BULK * size**3 * (part.area_mm2 / part.width_mm**2) ** 1.5
    return Lump(
        number=number,
        center_mm=part.center_mm,
        size_mm=float(size),
        sigma_mm=float(np.hypot(spread * size, _OUTLINE_CELLS * part.cell_mm)),
        width_mm=part.width_mm,
        length_mm=part.length_mm,
        area_mm2=part.area_mm2,
        height_mm=part.height_mm,
        volume_mm3=float(volume),
        hidden=hidden,
        occluded=hidden > OCCLUDED,
        cut=bool(rims.open[number]),
        outline=float(rims.strength[number] / length),
    )


SHARES = (0.1, 0.5, 0.8, 0.9)
"""Mass shares of d10, d50, d80, d90."""
_RESAMPLES = 300
"""Bootstrap samples of the lumps: σ itself is then known to 4 %."""
_METHOD_SIGMA = 0.08
"""σ of d10 to d90, as a share, by the method: outlines, hidden parts and lumps that were missed or joined are wrong
alike in a whole heap. On the fused belts of six simulated heaps (three to five cameras) the errors are 9.0 % RMS,
mostly low, at a bootstrap σ of 4.9 %; on five others that it was not set on, errors over σ are 1.10 RMS."""


@dataclass(frozen=True, slots=True, eq=False)
class SizeDistribution:
    """The size distribution of lumps by estimated mass, at uniform density."""

    count: int
    """Number of lumps."""
    d_mm: tuple[float, float, float, float]
    """d10, d50, d80, d90; NaN with less than two lumps."""
    d_sigma_mm: tuple[float, float, float, float]
    """One standard deviation each: from the number of lumps (bootstrap, Efron 1979, 10.1214/aos/1176344552), and 8 %
    of the method; the top layer's bias against the whole load is not included."""
    sieves_mm: NDArray[np.float64]
    """(K,) apertures."""
    passing: NDArray[np.float64]
    """(K,) share of the mass that passes, 0..1; NaN with less than two lumps."""


def compute_distribution(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], sieves_mm: NDArray[np.float64]
) -> SizeDistribution:
    """Compute the distribution of sizes (N,) mm weighted by masses (N,) in any unit."""
    if len(size_mm) < 2:  # of one lump nothing says how others are
        no_percentiles = (np.nan, np.nan, np.nan, np.nan)
        no_shares = np.full(len(sieves_mm), np.nan)
        return SizeDistribution(len(size_mm), no_percentiles, no_percentiles, sieves_mm, no_shares)
    rng = np.random.default_rng(0)
    samples: list[NDArray[np.float64]] = []
    for _ in range(_RESAMPLES):
        indices = rng.integers(0, len(size_mm), len(size_mm))
        samples.append(compute_passing_sizes(size_mm[indices], mass[indices], SHARES))
    percentiles = compute_passing_sizes(size_mm, mass, SHARES)
    few = np.sqrt(len(size_mm) / (len(size_mm) - 1))  # samples of n lumps vary by (n - 1) / n of the variance
    spread = np.hypot(few * np.std(samples, axis=0), _METHOD_SIGMA * percentiles)
    return SizeDistribution(
        len(size_mm),
        _as_four_floats(percentiles),
        _as_four_floats(spread),
        sieves_mm,
        compute_passing_shares(size_mm, mass, sieves_mm),
    )


def _as_four_floats(values: NDArray[np.float64]) -> tuple[float, float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]), float(values[3]))


def compute_passing_sizes(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], shares: tuple[float, ...]
) -> NDArray[np.float64]:
    """Return the sizes below which these shares of the mass lie, interpolated; half of each lump counts below."""
    order = np.argsort(size_mm, kind="stable")
    size, part = size_mm[order], mass[order] / mass.sum()
    return np.interp(shares, np.cumsum(part) - part / 2, size)


def compute_passing_shares(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], sieves_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the share of the mass (K,) in lumps no larger than each aperture (K,)."""
    small = size_mm[None] <= sieves_mm[:, None]
    return (small * mass).sum(axis=1) / mass.sum()


FINES = 65_535
"""Label of load that is not part of a lump."""
MAX_LUMPS = FINES - 1
"""The labels are 16-bit."""
FUSED_BELT = "fused belt"
"""`Lumps.frame` of a fused belt."""
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
    """(H, W) uint16 on the core's pinhole grid, or on the fused belt's cells: a lump's number, `FINES` for load
    outside lumps (if the empty belt is given), else 0."""
    frame: str
    """"belt" or "core": the frame of the lumps' centres; `FUSED_BELT`: x, the position s along the belt, z."""
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
    kept = [lump for lump in lumps if lump.width_mm >= settings.smallest_px * cell_mm][:MAX_LUMPS]
    lumps, cells = _renumber(kept, segmentation)
    fines = np.nan
    if load is not None:
        cells, fines = mark_fines(cells, load & raster.measured)
    along_mm = float(np.ptp(raster.points_mm[..., 1][raster.measured]))
    labels = _enlarge(cells, raster.factor, depth.depth_mm.shape)
    frame = "core" if belt is None else "belt"
    return make_lumps(lumps, labels, frame, cell_mm, settings, fines_share=fines, along_mm=along_mm)


def mark_fines(cells: NDArray[np.int64], loaded: NDArray[np.bool_]) -> tuple[NDArray[np.int64], float]:
    """Return numbers of lumps (R, C) with `FINES` where a loaded cell has none, and the share of these cells."""
    fine = (cells == 0) & loaded
    return np.where(fine, FINES, cells), float(fine.sum() / max(loaded.sum(), 1))


def make_lumps(
    lumps: tuple[Lump, ...],
    labels: NDArray[np.uint16],
    frame: str,
    cell_mm: float,
    settings: LumpSettings,
    *,
    fines_share: float,
    along_mm: float,
) -> Lumps:
    """Return measured lumps with their distribution and alarm; ``along_mm`` is the view's length along the belt."""
    uncut = [lump for lump in lumps if not lump.cut]
    whole = [lump for lump in uncut if not lump.occluded]
    reach = along_mm if any(lump.cut for lump in lumps) else np.inf
    return Lumps(
        lumps=lumps,
        labels=labels,
        frame=frame,
        cell_mm=cell_mm,
        smallest_mm=settings.smallest_px * cell_mm,
        fines_share=fines_share,
        all=_compute_weighted_distribution(uncut, reach, settings),
        whole=_compute_weighted_distribution(whole, reach, settings),
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


def _compute_weighted_distribution(
    chosen: Sequence[Lump], along_mm: float, settings: LumpSettings
) -> SizeDistribution:
    """Return the distribution by mass; a lump's weight is 1/P(not cut), as the ends cut large ones more often.

    ``along_mm`` is infinite where none was cut.
    """
    size = np.array([lump.size_mm for lump in chosen])
    # Miles & Lantuéjoul, see Serra 1982, Image Analysis and Mathematical Morphology, ch. VIII
    reach = np.array([lump.length_mm for lump in chosen])
    mass = np.array([lump.volume_mm3 for lump in chosen]) / np.clip(1 - reach / along_mm, 0.25, 1)
    return compute_distribution(size, mass, np.array(settings.sieves_mm))


def assess_oversize(lumps: Sequence[Lump], limit_mm: float) -> Oversize:
    """Assess which lumps exceed a limit, with probabilities; a lump cut by the frame counts by its visible part."""
    probabilities = [(lump.number, float(ndtr((lump.size_mm - limit_mm) / lump.sigma_mm))) for lump in lumps]
    none = float(np.prod([1 - probability for _, probability in probabilities]))
    likely = sorted((pair for pair in probabilities if pair[1] >= 0.05), key=lambda pair: (-pair[1], pair[0]))
    return Oversize(limit_mm, 1 - none, any(probability > 0.5 for _, probability in likely), tuple(likely))
