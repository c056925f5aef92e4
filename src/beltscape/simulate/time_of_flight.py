"""A time-of-flight camera: depth from phases, with the known errors of such cameras.

Light modulated at a frequency f comes back from the distance d with the phase φ = 4πfd/c; four samples a quarter of
a period apart give its phasor. A pixel's phasor is the sum over all light that reaches it. Consequences:

- the noise of the phase is noise over amplitude: it grows with distance and on dark surfaces (Lange & Seitz 2001);
- a pixel on a step mixes both surfaces' phasors: a *flying pixel* between them, or outside (Lefloch et al. 2013);
- light over a second surface arrives late: concave corners are measured too far away (`tof_multipath`; Jiménez et
  al. 2014);
- light scattered in the lens adds the image's mean phasor to all pixels and biases dark ones towards it (Foix et
  al. 2011);
- odd harmonics of the modulation alias into the four samples: *wiggling*, four cycles per range (Foix et al. 2011);
- pixels respond nonlinearly to little light: an error that depends on amplitude (Fürsattel et al. 2016). The
  dependence differs between cameras; here it is error · half / (half + amplitude), our own empirical form.

The geometry is that of the paper's time-of-flight camera (section 3.5: 640×480, 43°×33°, 6 m). The paper states
neither modulation nor noise: these defaults are typical of such cameras, not measured on that one.

Multipath: light over a second surface travels farther and shifts a pixel's phasor.
One bounce between diffuse surfaces is simulated. The image is divided into blocks; the surface at the centre of each
represents it as a disc of the block's area, lit by the camera. The share of a disc's light that a receiving point
gets is the radiosity form factor

    F = cos θ cos θ' A / (π r² + A)

and the light's path is camera – disc – point – camera. It is summed at every few pixels and interpolated in between.
Not modelled: occlusion between disc and point, surfaces outside the image or hidden from the camera, further bounces,
gloss. Jiménez et al., Image and Vision Computing 32(1), 2014, 1-13, fit the same model instead of applying it.

Frames of a world are taken by rays cast through every sub-pixel.

References
----------
Lange & Seitz, IEEE J. Quantum Electronics 37(3), 2001, doi:10.1109/3.910448; Foix, Alenyà & Torras, IEEE Sensors J.
11(9), 2011, doi:10.1109/JSEN.2010.2101060; Lefloch et al., Technical Foundation and Calibration Methods for
Time-of-Flight Cameras, LNCS 8200, 2013; Jiménez et al., Image and Vision Computing 32(1), 2014, 1-13; Fürsattel et
al., IEEE Trans. Computational Imaging 2(1), 2016, doi:10.1109/TCI.2015.2510506; Giancola, Valenti & Sala, A Survey
on 3D Cameras, 2018, doi:10.1007/978-3-319-91761-0.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.time_of_flight_signal import (
    LIGHT_MM_S,
    TofSettings,
    TofSurface,
    combine_phases,
    distance_sigma_mm,
    make_surface,
)
from beltscape.simulate.world import World


@dataclass(frozen=True, slots=True, eq=False)
class TofFrame:
    """A frame of the camera."""

    depth_mm: NDArray[np.float32]
    """(H, W) along the optical axis, on the camera's pinhole grid; NaN: too dark, saturated, or no surface."""
    amplitude_e: NDArray[np.float32]
    """(H, W) electrons of modulation, the minimum over the frequencies."""
    sigma_mm: NDArray[np.float32]
    """(H, W) predicted standard deviation of the depth by noise alone; NaN as the depth."""


@dataclass(frozen=True, slots=True, eq=False)
class TofTruth:
    """The true surfaces in front of the camera, hit by s×s rays through the sub-pixels of every pixel."""

    depth_mm: NDArray[np.float64]
    """(H·s, W·s) along the optical axis; NaN: no surface."""
    albedo: NDArray[np.float64]
    """(H·s, W·s) diffuse albedo for the camera's light."""
    cosine: NDArray[np.float64] | None = None
    """(H·s, W·s) cosine of ray and surface normal; None: computed from the depth's differences."""


def make_tof_camera(settings: TofSettings) -> Camera:
    """Return the camera's pinhole with its two angles of view and the axis in the middle."""
    size = np.array(settings.size_px, np.float64)
    focal = size / 2 / np.tan(np.deg2rad(settings.angle_deg) / 2)
    return Camera("tof", settings.size_px, focal, (size - 1) / 2, np.zeros(5))


def compute_subpixel_rays(settings: TofSettings, samples: int) -> NDArray[np.float64]:
    """Return (H·s, W·s, 2) x/z, y/z of s×s rays spread evenly over every pixel."""
    camera, (width, height) = make_tof_camera(settings), settings.size_px
    places = (
        ((np.arange(n * samples, dtype=np.float64) + 0.5) / samples - 0.5 - float(camera.center_px[i]))
        / float(camera.focal_px[i])
        for i, n in enumerate((width, height))
    )
    return np.stack(np.meshgrid(*places), axis=-1)


def simulate_tof_frame(truth: TofTruth, settings: TofSettings, seed: int) -> TofFrame:
    """Return one frame; the same truth, settings and seed give the same bytes.

    Raises
    ------
    InputError
        If the arrays do not match each other or the camera.
    """
    samples = _rays_per_pixel(truth, settings)
    rays = compute_subpixel_rays(settings, samples)
    surface = make_surface(truth.depth_mm, truth.albedo, truth.cosine, rays, samples)
    rng = np.random.default_rng(seed)
    phasors = np.array(
        [_compute_phasor(surface, settings, frequency) for frequency in settings.modulation_hz]
    )
    offset = _compute_offset(surface, settings)
    noise = np.sqrt((np.maximum(offset, 1e-12) + settings.read_noise_e**2) / 2)
    normal = rng.normal(size=(2, *phasors.shape))
    measured = phasors + noise * (normal[0] + 1j * normal[1])
    amplitude = np.abs(measured)
    sigma = distance_sigma_mm(noise, np.maximum(np.abs(phasors), 1e-12), settings.modulation_hz)
    distance, sigma = combine_phases(np.angle(measured), sigma, settings.modulation_hz)
    min_amplitude = amplitude.min(axis=0)
    distance = distance + settings.intensity_error_mm * settings.intensity_half_e / (
        settings.intensity_half_e + min_amplitude
    )
    is_measured = surface.hit & (min_amplitude >= settings.min_amplitude_e) & (offset <= settings.full_well_e)
    depth_per_distance = 1 / np.linalg.norm(surface.rays, axis=-1)
    return TofFrame(
        np.where(is_measured, distance * depth_per_distance, np.nan).astype(np.float32),
        np.where(surface.hit, min_amplitude, 0).astype(np.float32),
        np.where(is_measured, sigma * depth_per_distance, np.nan).astype(np.float32),
    )


def compute_wiggling_mm(
    distance_mm: NDArray[np.float64], settings: TofSettings, frequency_hz: float
) -> NDArray[np.float64]:
    """Return the cyclic error of the distance at one frequency: the rotation of the phasor by aliased harmonics."""
    phase = 4 * np.pi * frequency_hz * np.asarray(distance_mm) / LIGHT_MM_S
    third, fifth = settings.harmonics
    rotation = np.angle(1 + third * np.exp(-4j * phase) + fifth * np.exp(4j * phase))
    return rotation * LIGHT_MM_S / (4 * np.pi * frequency_hz)


def _rays_per_pixel(truth: TofTruth, settings: TofSettings) -> int:
    width, height = settings.size_px
    rows, columns = truth.depth_mm.shape
    samples = rows // height
    if samples < 1 or (rows, columns) != (height * samples, width * samples):
        raise InputError(
            f"time-of-flight truth of {columns}×{rows} is no multiple of {width}×{height}; give s×s rays per pixel"
        )
    for name, array in (("albedo", truth.albedo), ("cosine", truth.cosine)):
        if array is not None and array.shape != (rows, columns):
            raise InputError(
                f"time-of-flight {name} is {array.shape}, depth is {(rows, columns)}; give the same"
            )
    return samples


def _compute_phasor(
    surface: TofSurface, settings: TofSettings, frequency_hz: float
) -> NDArray[np.complex128]:
    """Return (H, W) electrons of modulation from four samples, without noise."""
    phasor = np.exp(4j * np.pi * frequency_hz / LIGHT_MM_S * surface.distance_mm)
    direct = surface.average_pixels(
        settings.amplitude_e * surface.strength * _add_harmonics(phasor, settings)
    )
    total = direct
    if settings.multipath:
        indirect = settings.amplitude_e * compute_one_bounce(surface, settings, frequency_hz)
        total = total + np.where(surface.hit, indirect, 0)
    return settings.contrast * ((1 - settings.scatter) * total + settings.scatter * total.mean())


def _add_harmonics(phasor: NDArray[np.complex128], settings: TofSettings) -> NDArray[np.complex128]:
    """Return the phasor exp(iφ) with third and fifth harmonic, which four samples alias to exp(-3iφ) and exp(5iφ)."""
    third, fifth = settings.harmonics
    return phasor + third * np.conj(phasor) ** 3 + fifth * phasor**5


def _compute_offset(surface: TofSurface, settings: TofSettings) -> NDArray[np.float64]:
    """Return (H, W) electrons of a sample, modulated or not, which cause the shot noise."""
    direct = surface.average_pixels(
        settings.amplitude_e * surface.strength + settings.ambient_e * surface.albedo
    )
    return (1 - settings.scatter) * direct + settings.scatter * direct.mean()


_PAIRS = 1 << 19
"""Pairs of points and discs processed at a time."""


def compute_one_bounce(
    surface: TofSurface, settings: TofSettings, frequency_hz: float
) -> NDArray[np.complex128]:
    """Return (H, W) phasor of the light over one second surface, in units of `TofSurface.strength`."""
    discs, points = _block_centres(surface, settings.patch_px), _block_centres(surface, settings.receiver_px)
    albedo = surface.average_pixels(surface.albedo)
    area = _areas_mm2(surface, settings.patch_px)[discs]
    radiosity = (
        albedo[discs]
        * _cosine(surface)[discs]
        / (np.linalg.norm(surface.points_mm[discs], axis=1) / 1000) ** 2
    )
    has_normal = np.isfinite(surface.normals[points]).all(axis=1)
    irradiance = np.zeros(len(points[0]), np.complex128)
    disc_points, disc_normals = surface.points_mm[discs], surface.normals[discs]
    is_source = np.isfinite(radiosity) & np.isfinite(area)
    sources = (disc_points[is_source], disc_normals[is_source], area[is_source], radiosity[is_source])
    receivers = np.flatnonzero(has_normal)
    rows = max(1, _PAIRS // max(1, int(is_source.sum())))
    for start in range(0, len(receivers), rows):
        chunk = receivers[start : start + rows]
        receiver = (points[0][chunk], points[1][chunk])
        irradiance[chunk] = integrate_irradiance(
            surface.points_mm[receiver], surface.normals[receiver], sources, frequency_hz
        )
    grid = _reshape(irradiance, surface, settings.receiver_px)
    return albedo * _interpolate(grid, surface.hit.shape, settings.receiver_px)


def integrate_irradiance(
    points: Array, normals: Array, sources: tuple[Array, Array, Array, Array], frequency_hz: float
) -> NDArray[np.complex128]:
    """Return (N,) phasor of irradiance at points (N, 3) from discs: positions, normals, areas mm², radiosity."""
    positions, source_normals, area, radiosity = sources
    to_source = positions[None] - points[:, None]
    distance2 = (to_source**2).sum(axis=-1)
    receiver_cosine = np.einsum("nmi,ni->nm", to_source, normals).clip(min=0)
    source_cosine = (-np.einsum("nmi,mi->nm", to_source, source_normals)).clip(min=0)
    squared = np.maximum(distance2, 1e-9)
    form_factor = receiver_cosine * source_cosine / squared * area / (np.pi * squared + area)
    length = (
        np.linalg.norm(positions, axis=1)[None] + np.sqrt(distance2) + np.linalg.norm(points, axis=1)[:, None]
    )
    phase = 2 * np.pi * frequency_hz / LIGHT_MM_S * length
    return ((form_factor * radiosity) * np.exp(1j * phase)).sum(axis=1)


def _block_centres(surface: TofSurface, step: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of the pixels at the centres of step×step blocks."""
    rows, columns = (np.arange(step // 2, int(n), step) for n in surface.hit.shape)
    row, column = np.meshgrid(rows, columns, indexing="ij")
    return row.ravel(), column.ravel()


def _cosine(surface: TofSurface) -> Array:
    """Return (H, W) cosines of normal and direction to the camera; NaN where unknown."""
    return -(surface.normals * surface.rays).sum(axis=-1) / np.linalg.norm(surface.rays, axis=-1)


def _areas_mm2(surface: TofSurface, step: int) -> Array:
    """Return (H, W) area of surface behind a step×step block at each pixel: solid angle · distance² / cosine."""
    du = surface.rays[0, 1, 0] - surface.rays[0, 0, 0]
    dv = surface.rays[1, 0, 1] - surface.rays[0, 0, 1]
    slant = np.linalg.norm(surface.rays, axis=-1) * np.maximum(_cosine(surface), 0.05)
    return surface.points_mm[..., 2] ** 2 * du * dv * step**2 / slant


def _reshape(values: NDArray[np.complex128], surface: TofSurface, step: int) -> NDArray[np.complex128]:
    rows, columns = (len(range(step // 2, n, step)) for n in surface.hit.shape)
    return values.reshape(rows, columns)


def _interpolate(grid: NDArray[np.complex128], shape: tuple[int, ...], step: int) -> NDArray[np.complex128]:
    """Return (H, W) values of pixels between those of the grid, bilinear; constant beyond its border."""
    rows, columns = ((np.arange(n) - step // 2) / step for n in shape)
    x, y = (grid.astype(np.float32) for grid in np.meshgrid(columns, rows))
    parts = [
        cv2.remap(np.ascontiguousarray(part), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in (grid.real, grid.imag)
    ]
    return parts[0].astype(np.float64) + 1j * parts[1].astype(np.float64)


def render_tof(
    world: World,
    tof_from_world: Pose,
    settings: TofSettings | None = None,
    *,
    seed: int = 0,
    samples: int = 3,
) -> TofFrame:
    """Return the frame of a camera at a pose; only its own light acts, projector and textures are ignored."""
    chosen = settings or TofSettings()
    return simulate_tof_frame(trace_tof_truth(world, tof_from_world, chosen, samples), chosen, seed)


def trace_tof_truth(world: World, tof_from_world: Pose, settings: TofSettings, samples: int) -> TofTruth:
    """Return depth, albedo (the mean of a solid's red, green and blue) and cosine for samples² rays per pixel."""
    rays = compute_subpixel_rays(settings, samples)
    along = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1).reshape(-1, 3)
    directions = along @ tof_from_world.rotation
    scene = RayScene(world.solids)
    hits = scene.cast(tof_from_world.center_mm, directions)
    is_hit = hits.face >= 0
    normals = scene.face_normals(np.where(is_hit, hits.face, 0))
    cosine = np.abs((normals * directions).sum(axis=1)) / np.linalg.norm(directions, axis=1)
    solid_albedo = np.array([float(np.mean(solid.reflectance)) for solid in world.solids])
    albedo = solid_albedo[np.where(is_hit, scene.solid_of_face[hits.face], 0)]
    shape = rays.shape[:2]
    return TofTruth(  # the rays have z = 1, so that a distance in lengths of a ray is a depth
        np.where(is_hit, hits.distance, np.nan).reshape(shape),
        np.where(is_hit, albedo, 0).reshape(shape),
        np.where(is_hit, cosine, 0).reshape(shape),
    )
