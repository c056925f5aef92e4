"""A line laser and the core camera over a moving belt: the image of the line, profile by profile.

Rays fill the laser's fan, along the line and over its thickness. Where one meets the scene first is lit; where the
camera sees that place, unhidden, it lands in the image through the lens's distortion and blur, as bright as surface
and angle make it. Photon and read noise come from the camera's sensor; the hall's light is taken to be filtered out.

Laser light on a rough surface is coherent: speckle moves the line's middle by a standard deviation of

    δx = C · λ / (2π · sin u),

C the contrast of the speckle, λ the wavelength, sin u the lens's aperture as the surface sees it (Dorsch, Häusler &
Herrmann, Applied Optics 33(7), 1994, 1306-1314, doi:10.1364/AO.33.001306); it is drawn anew for each column.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.camera import Camera
from beltscape.core.errors import InputError
from beltscape.core.pose import Pose
from beltscape.simulate.geometry.ray_casting import RayScene
from beltscape.simulate.geometry.reflectance import reflectance_at
from beltscape.simulate.geometry.world import Station, World
from beltscape.simulate.rendering.sensor import Sensor, expose
from beltscape.simulate.scene_assembly import EXPOSURE_SHARE
from beltscape.simulate.sensors.profile_scan import positions_mm
from beltscape.simulate.truth.visibility import is_in_image

Array = NDArray[np.float64]
Length = Annotated[float, Field(gt=0, le=1e5)]

_BLUR_PX = 3
"""Pixels on each side to which the lens spreads a point."""
_EXPOSED_ON = 9
"""Profiles from which the exposure is chosen."""
_BRIGHT = 0.98
"""Quantile of their columns' brightest pixels that just fits."""


class LaserSettings(BaseModel):
    """The laser, and how the camera sees it."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    offset_mm: Length = 300.0
    """Of the laser from the core along the belt, as high as it: the baseline. The line lies below the core."""
    fan_deg: Annotated[float, Field(gt=1, lt=150)] = 75.0
    thickness_mm: Annotated[float, Field(ge=0, le=20)] = 1.0
    """Of the line at 1/e² of its brightness, on the belt."""
    step_mm: Length = 1.0
    """Belt from profile to profile: 1000 profiles a second at 1 m/s."""
    wavelength_nm: Annotated[float, Field(gt=100, le=3000)] = 660.0
    aperture_mm: Length = 2.0
    """Of the camera's lens: 8 mm at f/4."""
    speckle_contrast: Annotated[float, Field(ge=0, le=1)] = 0.5
    rays_per_px: Annotated[int, Field(ge=1, le=16)] = 2
    """Along the line."""
    sheets: Annotated[int, Field(ge=1, le=15)] = 5
    """Over its thickness."""


@dataclass(frozen=True, slots=True, eq=False)
class Laser:
    """A plane of light in the world while the belt's position is 0; it goes through a line across the belt."""

    eye_mm: Array
    """(3,) where it comes from."""
    normal: Array
    """(3,) of the plane."""


@dataclass(frozen=True, slots=True, eq=False)
class LineImage:
    """One image of the line."""

    along_mm: float
    """Belt position: the scene's world y at which the sensor's own y = 0 stands."""
    first_row: int
    image: NDArray[np.uint8]
    """(h, W) rows first_row … of the camera's image: its region of interest."""
    drift_px: Array
    """(W,) what speckle adds to the line's middle, px; known to nobody but the simulator."""


def make_laser(settings: LaserSettings, height_mm: float) -> Laser:
    """A laser as high as the core, its plane through the x axis of the belt's level middle."""
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
    """The images that the core camera takes while the belt carries the scene past it, every ``step_mm``.

    Raises
    ------
    InputError
        When the camera sees nothing of the line.
    """
    scanner = _Scanner(world, station, laser, settings, blur_px)
    places = positions_mm(along_mm, settings.step_mm)
    probes = [scanner.light(float(y)) for y in places[:: max(1, len(places) // _EXPOSED_ON)]]
    peaks = np.concatenate([light.max(axis=0) for light in probes])
    peaks = peaks[peaks > 0]
    if not peaks.size:
        raise InputError("the camera sees nothing of the laser's line; move the laser or the camera")
    electrons = EXPOSURE_SHARE * sensor.full_well_e / float(np.quantile(peaks, _BRIGHT)) / sensor.gain
    exposed = sensor.model_copy(update={"colour": "grey", "bits": 8, "electrons_at_1": electrons})
    rows = np.flatnonzero(np.max([light.max(axis=1) for light in probes], axis=0) > 0)
    spare = 4 * _BLUR_PX + scanner.camera.size_px[1] // 50
    first, last = max(0, rows[0] - spare), min(scanner.camera.size_px[1], rows[-1] + 1 + spare)
    rng = np.random.default_rng([seed, 1])
    drift = speckle_sigma_px(settings, scanner.camera, float(station.core_from_world.center_mm[2]))
    for index, y in enumerate(places):
        light = scanner.light(float(y))[first:last].astype(np.float32)
        image = expose(light[..., None], exposed, [seed, 2, index])
        wander = rng.normal(scale=drift, size=scanner.camera.size_px[0])
        yield LineImage(float(y), int(first), image.astype(np.uint8), wander)


def speckle_sigma_px(settings: LaserSettings, camera: Camera, distance_mm: float) -> float:
    """Standard deviation of the line's middle by speckle, px of the image."""
    sine = settings.aperture_mm / 2 / distance_mm
    on_surface = settings.speckle_contrast * settings.wavelength_nm * 1e-6 / (2 * np.pi * sine)
    return float(on_surface * camera.focal_px[1] / distance_mm)


class _Scanner:
    """What stays the same from profile to profile."""

    def __init__(
        self, world: World, station: Station, laser: Laser, settings: LaserSettings, blur_px: float
    ) -> None:
        self.camera, self._pose = station.rig.core_camera, station.core_from_world
        self._world, self._scene, self._laser = world, RayScene(world.solids), laser
        self._blur_px = max(blur_px, 1e-3)
        self._directions, self._power = _make_fan(laser, settings, self.camera.size_px[0])

    def light(self, along_mm: float) -> Array:
        """(H, W) light of the line, in units of its own."""
        carried = np.array([0.0, along_mm, 0.0])
        eye = self._laser.eye_mm + carried
        pose = Pose(self._pose.rotation, self._pose.translation_mm - self._pose.rotation @ carried)
        hits = self._scene.cast(eye, self._directions)
        met = np.flatnonzero(hits.face >= 0)
        points = eye + hits.distance[met, None] * self._directions[met]
        inside = is_in_image(self.camera, pose, points)
        met, points = met[inside], points[inside]
        face = hits.face[met]
        normals = self._scene.face_normals(face)
        seen = self._scene.is_visible_from(points, normals, pose.center_mm)
        met, points, face, normals = met[seen], points[seen], face[seen], normals[seen]
        way = pose.center_mm - points
        far = np.linalg.norm(way, axis=1)
        back = (normals * way).sum(axis=1) / far**3  # what a matt surface sends into the lens
        bright = reflectance_at(self._scene, self._world.solids, face, points)
        pixels = self.camera.project(pose.apply(points))
        return _blur_points(pixels, self._power[met] * bright * back, self.camera.size_px, self._blur_px)


def _make_fan(laser: Laser, settings: LaserSettings, width_px: int) -> tuple[Array, Array]:
    """(R, 3) directions of the fan's rays, over its thickness too, and (R,) the light that each carries."""
    half = np.deg2rad(settings.fan_deg) / 2
    angles = np.linspace(-half, half, settings.rays_per_px * width_px)
    down = -laser.eye_mm / np.linalg.norm(laser.eye_mm)
    middle = np.cos(angles)[:, None] * down + np.sin(angles)[:, None] * np.array([1.0, 0.0, 0.0])
    sigma = settings.thickness_mm / 4 / np.linalg.norm(laser.eye_mm)  # 1/e² lies at two standard deviations
    tilts = np.linspace(-2, 2, settings.sheets) if settings.sheets > 1 else np.zeros(1)
    sheets = [middle + tilt * sigma * laser.normal for tilt in tilts]
    power = np.exp(-(tilts**2) / 2)
    return np.concatenate(sheets), np.repeat(power / power.sum(), len(angles))


def _blur_points(pixels: Array, light: Array, size_px: tuple[int, int], sigma_px: float) -> Array:
    """(H, W) image of points at pixels (N, 2), each blurred by the lens and gathered by the pixels' areas."""
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
