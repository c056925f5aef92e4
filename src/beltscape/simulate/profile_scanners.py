"""Sensors that measure profile by profile while the belt carries the scene past them: a line laser and a LiDAR.

The line laser's image is taken by the core camera. Rays fill the laser's fan, along the line and over its
thickness. The first surface point on each ray is lit; where the camera sees that point, it is projected through the
lens's distortion and blur, as bright as surface and angle make it. Photon and read noise come from the camera's
sensor; ambient light is assumed to be filtered out.

Laser light on a rough surface is coherent: speckle shifts the line's centre by a standard deviation of

    δx = C · λ / (2π · sin u),

C the contrast of the speckle, λ the wavelength, sin u the lens's aperture seen from the surface (Dorsch, Häusler &
Herrmann, Applied Optics 33(7), 1994, 1306-1314, doi:10.1364/AO.33.001306); it is drawn independently per column.

The LiDAR is a profile scanner vertically above the belt: ranges in a fan across it.

The beam has a width: the range is the mean over rays spread over it, weighted by the returned light, so that a beam
on an edge reports a point in between. Range noise is added. The geometry is of the class of SICK's LMS4000: 70° in
steps of 0.0833° (operating instructions 8023198). Assumed are 600 profiles a second, a range noise of 1 mm, a spot
of 3 mm, and that no surface is too dark.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.arrays import Array
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.core_truth import is_in_image
from beltscape.simulate.ray_casting import RayScene, reflectance_at
from beltscape.simulate.rendering.sensor import Sensor, expose
from beltscape.simulate.scene_assembly import EXPOSURE_SHARE
from beltscape.simulate.world import Station, World


@dataclass(frozen=True, slots=True, eq=False)
class ProfileScan:
    """Profiles one after another, each at its own position of the belt by the encoder."""

    points_mm: Array
    """(P, C, 3) in the scene's world at belt position 0; NaN: not measured."""
    sigma_mm: Array
    """(P, C) predicted standard deviation of the height; NaN as the points."""
    step_mm: float
    """Distance of consecutive profiles along the belt."""


def positions_mm(along_mm: tuple[float, float], step_mm: float) -> Array:
    """Return (P,) positions along the belt, from end to end."""
    first, last = along_mm
    return np.arange(first, last + step_mm / 2, step_mm)


Length = Annotated[float, Field(gt=0, le=1e5)]

_BLUR_PX = 3
"""Radius of the square of pixels over which the lens spreads a point."""
_EXPOSED_ON = 9
"""Number of profiles from which the exposure is chosen."""
_BRIGHT = 0.98
"""Quantile of these columns' brightest pixels that the exposure places just below saturation."""


class LaserSettings(BaseModel):
    """The laser and its image in the camera."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    offset_mm: Length = 300.0
    """Distance of the laser from the core along the belt, at the core's height: the baseline."""
    fan_deg: Annotated[float, Field(gt=1, lt=150)] = 75.0
    thickness_mm: Annotated[float, Field(ge=0, le=20)] = 1.0
    """Thickness of the line on the belt, at 1/e² of its brightness."""
    step_mm: Length = 1.0
    """Belt travel from profile to profile: 1000 profiles a second at 1 m/s."""
    wavelength_nm: Annotated[float, Field(gt=100, le=3000)] = 660.0
    aperture_mm: Length = 2.0
    """Aperture of the camera's lens: 8 mm at f/4."""
    speckle_contrast: Annotated[float, Field(ge=0, le=1)] = 0.5
    rays_per_px: Annotated[int, Field(ge=1, le=16)] = 2
    """Rays per pixel along the line."""
    sheets: Annotated[int, Field(ge=1, le=15)] = 5
    """Rays over the thickness of the line."""


@dataclass(frozen=True, slots=True, eq=False)
class Laser:
    """A plane of light in the world at belt position 0; it contains a line across the belt."""

    eye_mm: Array
    """(3,) position of the laser."""
    normal: Array
    """(3,) normal of the plane."""


@dataclass(frozen=True, slots=True, eq=False)
class LineImage:
    """One image of the line."""

    along_mm: float
    """Belt position: the scene's world y at the sensor's own y = 0."""
    first_row: int
    image: NDArray[np.uint8]
    """(h, W) rows first_row … of the camera's image: the region of interest."""
    drift_px: Array
    """(W,) shift of the line's centre by speckle, px; the simulator's truth."""


def make_laser(settings: LaserSettings, height_mm: float) -> Laser:
    """Return a laser at the core's height, its plane through the x axis of the belt's level middle."""
    eye = np.array([0.0, settings.offset_mm, height_mm])
    normal = np.cross([1.0, 0.0, 0.0], eye)
    return Laser(eye, normal / np.linalg.norm(normal))


def render_line_images(
    world: World,
    station: Station,
    laser: Laser,
    settings: LaserSettings,
    sensor: Sensor,
    *,
    along_mm: tuple[float, float],
    blur_px: float,
    seed: int = 0,
) -> Iterator[LineImage]:
    """Yield the images of the core camera while the belt carries the scene past it, every ``step_mm``.

    Raises
    ------
    InputError
        If the line is not in the camera's image.
    """
    scanner = _Scanner(world, station, laser, settings, blur_px)
    positions = positions_mm(along_mm, settings.step_mm)
    probes = [scanner.light(float(y)) for y in positions[:: max(1, len(positions) // _EXPOSED_ON)]]
    peaks = np.concatenate([light.max(axis=0) for light in probes])
    peaks = peaks[peaks > 0]
    if not peaks.size:
        raise InputError("the camera sees nothing of the laser's line; move the laser or the camera")
    electrons = EXPOSURE_SHARE * sensor.full_well_e / float(np.quantile(peaks, _BRIGHT)) / sensor.gain
    exposed = sensor.model_copy(update={"colour": "grey", "bits": 8, "electrons_at_1": electrons})
    rows = np.flatnonzero(np.max([light.max(axis=1) for light in probes], axis=0) > 0)
    margin = 4 * _BLUR_PX + scanner.camera.size_px[1] // 50
    first, last = max(0, rows[0] - margin), min(scanner.camera.size_px[1], rows[-1] + 1 + margin)
    rng = np.random.default_rng([seed, 1])
    speckle_sigma = speckle_sigma_px(settings, scanner.camera, float(station.core_from_world.center_mm[2]))
    for index, y in enumerate(positions):
        light = scanner.light(float(y))[first:last].astype(np.float32)
        image = expose(light[..., None], exposed, [seed, 2, index])
        shift = rng.normal(scale=speckle_sigma, size=scanner.camera.size_px[0])
        yield LineImage(float(y), int(first), image.astype(np.uint8), shift)


def speckle_sigma_px(settings: LaserSettings, camera: Camera, distance_mm: float) -> float:
    """Return the standard deviation of the line's centre by speckle, px of the image."""
    sine = settings.aperture_mm / 2 / distance_mm
    on_surface = settings.speckle_contrast * settings.wavelength_nm * 1e-6 / (2 * np.pi * sine)
    return float(on_surface * camera.focal_px[1] / distance_mm)


class _Scanner:
    """The parts of a scan that do not change from profile to profile."""

    def __init__(
        self, world: World, station: Station, laser: Laser, settings: LaserSettings, blur_px: float
    ) -> None:
        self.camera, self._pose = station.rig.core_camera, station.core_from_world
        self._world, self._scene, self._laser = world, RayScene(world.solids), laser
        self._blur_px = max(blur_px, 1e-3)
        self._directions, self._power = _make_fan(laser, settings, self.camera.size_px[0])

    def light(self, along_mm: float) -> Array:
        """Return (H, W) light of the line, in arbitrary units."""
        travel = np.array([0.0, along_mm, 0.0])
        eye = self._laser.eye_mm + travel
        pose = Pose(self._pose.rotation, self._pose.translation_mm - self._pose.rotation @ travel)
        hits = self._scene.cast(eye, self._directions)
        hit_rays = np.flatnonzero(hits.face >= 0)
        points = eye + hits.distance[hit_rays, None] * self._directions[hit_rays]
        inside = is_in_image(self.camera, pose, points)
        hit_rays, points = hit_rays[inside], points[inside]
        face = hits.face[hit_rays]
        normals = self._scene.face_normals(face)
        is_visible = self._scene.is_visible_from(points, normals, pose.center_mm)
        hit_rays, points, face, normals = (
            hit_rays[is_visible],
            points[is_visible],
            face[is_visible],
            normals[is_visible],
        )
        to_camera = pose.center_mm - points
        distance = np.linalg.norm(to_camera, axis=1)
        form_factor = (normals * to_camera).sum(axis=1) / distance**3  # light of a matt surface into the lens
        reflectance = reflectance_at(self._scene, self._world.solids, face, points)
        pixels = self.camera.project(pose.apply(points))
        return _blur_points(
            pixels, self._power[hit_rays] * reflectance * form_factor, self.camera.size_px, self._blur_px
        )


def _make_fan(laser: Laser, settings: LaserSettings, width_px: int) -> tuple[Array, Array]:
    """Return (R, 3) directions of the fan's rays, over its thickness too, and (R,) the light of each."""
    half = float(np.deg2rad(settings.fan_deg) / 2)
    angles = np.linspace(-half, half, settings.rays_per_px * width_px)
    down = -laser.eye_mm / np.linalg.norm(laser.eye_mm)
    middle = np.cos(angles)[:, None] * down + np.sin(angles)[:, None] * np.array([1.0, 0.0, 0.0])
    sigma = settings.thickness_mm / 4 / np.linalg.norm(laser.eye_mm)  # 1/e² is at two standard deviations
    tilts = np.linspace(-2, 2, settings.sheets) if settings.sheets > 1 else np.zeros(1)
    sheets = [middle + tilt * sigma * laser.normal for tilt in tilts]
    power = np.exp(-(tilts**2) / 2)
    return np.concatenate(sheets), np.repeat(power / power.sum(), len(angles))


def _blur_points(pixels: Array, light: Array, size_px: tuple[int, int], sigma_px: float) -> Array:
    """Return (H, W) image of points at pixels (N, 2), each blurred by the lens and integrated over the pixels."""
    from scipy.special import ndtr

    width, height = size_px
    nearest = np.rint(pixels).astype(int)
    steps = np.arange(-_BLUR_PX, _BLUR_PX + 1)
    off = (nearest[:, :, None] + steps) - pixels[:, :, None]
    weights = ndtr((off + 0.5) / sigma_px) - ndtr((off - 0.5) / sigma_px)
    total = np.zeros(width * height)
    for j, row_step in enumerate(steps):
        row = nearest[:, 1] + row_step
        for i, column_step in enumerate(steps):
            column = nearest[:, 0] + column_step
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            value = (light * weights[:, 1, j] * weights[:, 0, i])[inside]
            total += np.bincount((row * width + column)[inside], value, minlength=width * height)
    return total.reshape(height, width)


class LidarSettings(BaseModel):
    """The scanner."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    height_mm: Length = 1000.0
    """Height above the belt's level middle; nearer than 700 mm such a scanner does not measure."""
    field_deg: Annotated[float, Field(gt=1, lt=170)] = 70.0
    step_deg: Annotated[float, Field(gt=0.001, le=5)] = 0.0833
    profiles_per_s: Annotated[float, Field(gt=0, le=1e6)] = 600.0
    range_noise_mm: Annotated[float, Field(ge=0, le=1000)] = 1.0
    """Standard deviation."""
    spot_mm: Annotated[float, Field(ge=0, le=100)] = 3.0
    """Edge of the square, uniform beam."""
    rays: Annotated[int, Field(ge=1, le=9)] = 3
    """Rays over the spot, in each direction."""


def scan_lidar(
    world: World,
    settings: LidarSettings,
    *,
    speed_mm_s: float,
    along_mm: tuple[float, float],
    seed: int = 0,
) -> ProfileScan:
    """Scan a world that the belt carries past at a speed; the encoder is assumed to be perfect."""
    scene = RayScene(world.solids)
    half = float(np.deg2rad(settings.field_deg) / 2)
    angles = np.arange(-half, half + 1e-9, float(np.deg2rad(settings.step_deg)))
    directions = np.column_stack([np.sin(angles), np.zeros(len(angles)), -np.cos(angles)])
    across = np.column_stack([np.cos(angles), np.zeros(len(angles)), np.sin(angles)])
    step = speed_mm_s / settings.profiles_per_s
    rng = np.random.default_rng(seed)
    profiles: list[NDArray[np.float64]] = []
    sigmas: list[NDArray[np.float64]] = []
    for y in positions_mm(along_mm, step):
        eye = np.array([0.0, y, settings.height_mm])
        distance = _mean_ranges(scene, world, eye, directions, across, settings)
        distance = distance + rng.normal(scale=settings.range_noise_mm, size=len(angles))
        profiles.append(eye + distance[:, None] * directions)
        sigmas.append(np.where(np.isfinite(distance), settings.range_noise_mm * np.cos(angles), np.nan))
    return ProfileScan(np.stack(profiles), np.stack(sigmas), step)


def _mean_ranges(
    scene: RayScene,
    world: World,
    eye: NDArray[np.float64],
    directions: NDArray[np.float64],
    across: NDArray[np.float64],
    settings: LidarSettings,
) -> NDArray[np.float64]:
    """Return (C,) ranges without noise; NaN where a beam hits nothing."""
    offsets = ((np.arange(settings.rays) + 0.5) / settings.rays - 0.5) * settings.spot_mm
    total, weight = np.zeros(len(directions)), np.zeros(len(directions))
    for right in offsets:
        for ahead in offsets:
            start = eye + right * across + np.array([0.0, ahead, 0.0])
            hits = scene.cast(start, directions)
            is_hit = hits.face >= 0
            points = start + np.where(is_hit, hits.distance, 0.0)[:, None] * directions
            cosine = np.abs((scene.face_normals(hits.face) * directions).sum(axis=1))
            returned = reflectance_at(scene, world.solids, hits.face, points) * cosine
            light = np.where(is_hit, returned / np.maximum(hits.distance, 1.0) ** 2, 0.0)
            total += np.where(is_hit, light * hits.distance, 0.0)
            weight += light
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weight > 0, total / weight, np.nan)
