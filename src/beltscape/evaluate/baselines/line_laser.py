"""Laser-line profiler: sub-pixel line centres and their intersection with the laser plane.

The line centre in each column is the centre of gravity of the counts above a threshold around the brightest pixel,
which is as accurate as other common methods for lines of two to three pixels (Naidu & Fisher, A comparative
analysis of algorithms for determining the peak position of a stripe to sub-pixel accuracy, British Machine Vision
Conference 1991, 217-225, doi:10.1007/978-1-4471-1921-0_28).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.simulate.geometry.world import Station
from beltscape.simulate.sensors.line_laser import Laser, LineImage
from beltscape.simulate.sensors.profile_scan import ProfileScan

_SECOND_PEAK = 0.5
"""Height of a second peak, over the highest one, from which a column is ambiguous; chosen."""

Array = NDArray[np.float64]


class PeakSettings(BaseModel):
    """Detection of the laser line."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    least: Annotated[float, Field(ge=1, le=255)] = 12.0
    """Smallest counts of its brightest pixel."""
    window_px: Annotated[int, Field(ge=1, le=50)] = 4
    """Rows on each side of it that are evaluated."""
    base: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Share of the brightest pixel's counts below which a pixel has no weight."""
    brightest: Annotated[int, Field(ge=1, le=255)] = 254
    """Largest counts of its brightest pixel; above lies saturation."""
    read_noise: Annotated[float, Field(ge=0, le=100)] = 0.4
    """Read noise of the camera, counts."""
    electrons_per_count: Annotated[float, Field(gt=0, le=1e6)] = 55.0
    """Electrons per count: a full well of 14,000 over 255 counts."""


def locate_line_centers(
    image: NDArray[np.uint8], settings: PeakSettings | None = None
) -> tuple[Array, Array]:
    """Return the rows (W,) of the line centre in an image (h, W) and their σ (W,) by camera noise; NaN: no line.

    A column with a second peak of `_SECOND_PEAK` of the height outside the window is ambiguous and gives NaN.
    """
    settings = settings or PeakSettings()
    counts = image.astype(np.float64)
    rows = np.arange(len(counts))[:, None]
    top, peak = counts.argmax(axis=0), counts.max(axis=0)
    near = np.abs(rows - top) <= settings.window_px
    second = np.where(near, 0, counts).max(axis=0)
    weight = np.where(near, np.maximum(counts - settings.base * peak, 0), 0)
    total = weight.sum(axis=0)
    good = (peak >= settings.least) & (second < _SECOND_PEAK * peak) & (peak <= settings.brightest)
    with np.errstate(invalid="ignore", divide="ignore"):
        middle = (rows * weight).sum(axis=0) / total
        variance = settings.read_noise**2 + counts / settings.electrons_per_count
        spread = np.where(weight > 0, (rows - middle) ** 2 * variance, 0).sum(axis=0)
        sigma = np.sqrt(spread) / total
    return np.where(good, middle, np.nan), np.where(good, sigma, np.nan)


def measure_profiles(
    images: Iterable[LineImage],
    station: Station,
    laser: Laser,
    step_mm: float,
    *,
    speckle_px: float = 0.0,
    settings: PeakSettings | None = None,
) -> ProfileScan:
    """Return the profiles from the line's images; camera and laser plane are calibrated.

    ``speckle_px`` is the contribution of laser speckle to σ.
    """
    camera, world_from_core = station.rig.core_camera, station.core_from_world.inverse()
    columns = np.arange(camera.size_px[0], dtype=np.float64)
    points: list[Array] = []
    sigmas: list[Array] = []
    for one in images:
        middle, sigma_px = locate_line_centers(one.image, settings)
        row = middle + one.first_row + one.drift_px
        met = [
            _intersect_laser_plane(columns, row + off, station, laser, world_from_core.rotation)
            for off in (0.0, 0.5)
        ]
        per_px = 2 * np.abs(met[1][:, 2] - met[0][:, 2])
        points.append(met[0] + [0.0, one.along_mm, 0.0])
        sigmas.append(per_px * np.hypot(sigma_px, speckle_px))
    return ProfileScan(np.stack(points), np.stack(sigmas), step_mm)


def _intersect_laser_plane(
    columns: Array, rows: Array, station: Station, laser: Laser, world_from_core: Array
) -> Array:
    """Return where distorted pixels' rays meet the laser plane, (W, 3) in the world at belt position 0."""
    ideal = station.rig.core_camera.undistort(np.column_stack([columns, rows]))
    rays = np.column_stack([ideal, np.ones(len(ideal))]) @ world_from_core.T
    eye = station.core_from_world.center_mm
    with np.errstate(invalid="ignore", divide="ignore"):
        far = ((laser.eye_mm - eye) @ laser.normal) / (rays @ laser.normal)
    return eye + far[:, None] * rays
