"""The light budget of a pixel, and what a moving belt requires of exposure, frame rate and data link.

The budget goes from lumens on the belt to electrons, noise, and the required exposure.
Radiometry of a diffuse surface seen through a lens: luminance L = ρE/π; illuminance behind a lens of f-number N at
magnification m, E' = π L τ / (4 N² (1 + m)²) (the camera equation), the corner of the image darker by cos⁴. Photons
per lux follow from the light's lumens per watt and mean wavelength; the noise is shot noise and read noise (the
linear camera model of EMVA Standard 1288).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.plan.settings import REFERENCE_PATCH_PX, PlanSettings

PLANCK_J_S = 6.62607015e-34
"""Planck's constant (SI, exact)."""
LIGHT_M_S = 299_792_458.0
"""Speed of light (SI, exact)."""
REFERENCE_SNR = 255 / 2
"""Contrast over noise at which the matching σ is set: noise of 2 of 255 grey levels."""
REFERENCE_FLOOR_PX = 0.012
"""Part of the matching σ due to image noise there, with a patch of 21 px: √(2σ_n² / ΣI_x²) for 25,000 dots."""
WHITE = 0.8
"""Reflectance of a white surface, such as white paint or paper."""


@dataclass(frozen=True, slots=True)
class LightBudget:
    """Light of a lit dot and a dark gap on the darkest material, in the middle of the core's image."""

    illuminance_lux: float
    """Illuminance by the projector on the belt."""
    exposure_us: float
    dot_e: float
    """Electrons of a pixel in a lit dot."""
    gap_e: float
    """Electrons in a dark gap: ambient light alone."""
    noise_e: float
    """Shot and read noise in a dot, one standard deviation."""
    snr: float
    """Contrast between dot and gap over the noise in a dot."""
    corner: float
    """Relative illumination of the image's corner (cos⁴)."""
    needed_exposure_us: float
    """Exposure for the target SNR; inf where the projector is off."""
    needed_lumens: float
    """Luminous flux for the target SNR at this exposure."""
    saturated: bool
    """True if a white surface saturates the pixel."""
    matching_sigma_px: float
    """Matching σ as set, with its part of image noise raised to this light."""


def electrons_per_lux_s(settings: PlanSettings, depth_mm: float) -> float:
    """Return the electrons of a pixel per lux on the darkest material and second of exposure."""
    camera, light = settings.camera, settings.light
    magnification = camera.focal_mm / (depth_mm - camera.focal_mm)
    share = light.reflectance * camera.transmission / (4 * camera.f_number**2 * (1 + magnification) ** 2)
    photon_j = PLANCK_J_S * LIGHT_M_S / (light.wavelength_nm * 1e-9)
    pixel_m2 = (camera.pitch_um * 1e-6) ** 2
    return share / light.lumens_per_watt / photon_j * pixel_m2 * camera.quantum_efficiency


def compute_light_budget(
    settings: PlanSettings, depth_mm: float, lit_area_mm2: float, exposure_us: float
) -> LightBudget:
    """Return the light budget of material at a depth, under a projector picture of this area."""
    light, camera = settings.light, settings.camera
    projector_lux = light.projector_lm / (lit_area_mm2 * 1e-6)
    rate = electrons_per_lux_s(settings, depth_mm) * 1e-6  # per lux and µs
    gap = rate * light.ambient_lux * exposure_us
    contrast = rate * projector_lux * exposure_us
    noise = float(np.sqrt(contrast + gap + camera.read_noise_e**2))
    snr = contrast / noise
    contrast_needed = needed_contrast_e(light.target_snr, gap, camera.read_noise_e)
    diagonal = np.hypot(*camera.size_px) / 2 / camera.focal_px
    return LightBudget(
        illuminance_lux=projector_lux,
        exposure_us=exposure_us,
        dot_e=contrast + gap,
        gap_e=gap,
        noise_e=noise,
        snr=snr,
        corner=float((1 + diagonal**2) ** -2),
        needed_exposure_us=_needed_exposure_us(settings, rate, projector_lux),
        needed_lumens=contrast_needed / (rate * exposure_us) * lit_area_mm2 * 1e-6,
        saturated=(contrast + gap) * WHITE / light.reflectance > camera.full_well_e,
        matching_sigma_px=matching_sigma_px(settings, snr),
    )


def matching_sigma_px(settings: PlanSettings, snr: float) -> float:
    """Return the σ of a matched coordinate at an SNR; never better than as set."""
    if snr <= 0:
        return float("inf")
    floor = REFERENCE_FLOOR_PX * REFERENCE_PATCH_PX / settings.precision.patch_px
    excess = max(0.0, (REFERENCE_SNR / snr) ** 2 - 1)
    return float(np.sqrt(settings.precision.sigma_px**2 + floor**2 * excess))


def needed_contrast_e(snr: float, gap_e: float, read_noise_e: float) -> float:
    """Return the contrast c in electrons with c / √(c + gap + read²) = SNR."""
    return float(snr**2 + np.sqrt(snr**4 + 4 * snr**2 * (gap_e + read_noise_e**2))) / 2


def _needed_exposure_us(settings: PlanSettings, rate: float, projector_lux: float) -> float:
    """Return the exposure t with a t / √(b t + read²) = SNR; a, b electrons per µs of contrast and of all light."""
    a, b = rate * projector_lux, rate * (projector_lux + settings.light.ambient_lux)
    if a <= 0:
        return float("inf")
    k = settings.light.target_snr**2 / a**2
    return float((k * b + np.sqrt((k * b) ** 2 + 4 * k * settings.camera.read_noise_e**2)) / 2)


def defocus_px(settings: PlanSettings, focus_mm: float, depth_mm: float) -> float:
    """Return the diameter of the blur disc of a thin lens focused at ``focus_mm``, for a surface at ``depth_mm``."""
    camera = settings.camera
    aperture = camera.focal_mm / camera.f_number
    disc_mm = aperture * camera.focal_mm / (focus_mm - camera.focal_mm) * abs(depth_mm - focus_mm) / depth_mm
    return disc_mm * 1000 / camera.pitch_um


@dataclass(frozen=True, slots=True)
class Motion:
    """Exposure, blur and frame rates at the belt's speed."""

    exposure_us: float
    """Exposure of this plan."""
    max_exposure_us: float
    """Exposure at which the nearest material is blurred by the allowed pixels; inf where the belt stands still."""
    blur_mm: float
    """Travel of the belt during the exposure."""
    blur_px: float
    """That travel in the core's image of the nearest material, where it is longest."""
    frame_length_mm: float
    """Length of belt that one frame covers at full width and every height."""
    gap_free_fps: float
    """Frame rate at which consecutive frames just adjoin."""
    fps: float
    """Frame rate at which each piece of belt is in the requested number of frames."""
    data_mb_s: float
    """Data rate of all cameras at ``fps``, 10⁶ bytes a second."""
    max_speed_m_s: float
    """Speed at which the camera's maximum frame rate still gives the requested number of frames."""
    cores: float
    """Processor cores that measure ``fps`` with the preset fast, from images reduced to `CORE_WIDTH_PX`."""


CORE_WIDTH_PX = 612
"""Width of the images for which the cores are stated; narrower cameras' images stay as they are."""
_SET_S = 0.5
"""Seconds of a core for a frame set of five cameras, 612 × 512 px, fast, everything included: 0.39 with AVX-512
(benchmarks/realtime.py), a quarter more for other cores. `beltscape doctor` measures the machine at hand."""
_SET_PIXELS = 5 * 612 * 512
"""Pixels of that frame set: the time grows with them."""


def count_cores(fps: float, cameras: int, size_px: tuple[int, int]) -> float:
    """Return how many processor cores measure ``fps`` frame sets a second, preset fast."""
    scale = min(1.0, CORE_WIDTH_PX / size_px[0])
    return fps * _SET_S * cameras * size_px[0] * size_px[1] * scale**2 / _SET_PIXELS


def blur_mm(speed_m_s: float, exposure_us: float) -> float:
    """Return the travel of the belt during an exposure: 1 m/s is 0.001 mm/µs."""
    return speed_m_s * exposure_us * 1e-3


def max_exposure_us(speed_m_s: float, blur_px: float, pixel_mm: float) -> float:
    """Return the exposure during which the belt moves by ``blur_px`` pixels of this size."""
    return blur_px * pixel_mm / (speed_m_s * 1e-3) if speed_m_s > 0 else float("inf")


def frames_per_second(speed_m_s: float, length_mm: float, frames_per_point: float) -> float:
    """Return the rate at which each point of the belt is in this number of frames of a length."""
    return speed_m_s * 1000 * frames_per_point / length_mm if length_mm > 0 else float("inf")


def compute_motion(settings: PlanSettings, nearest_pixel_mm: float, frame_length_mm: float) -> Motion:
    """Return the requirements for the pixel size of the nearest material and the length of a frame."""
    speed, light = settings.belt.speed_m_s, settings.light
    longest = max_exposure_us(speed, light.max_blur_px, nearest_pixel_mm)
    exposure = light.exposure_us or min(longest, 1e6 / settings.camera.max_fps)
    width, height = settings.camera.size_px
    fps = frames_per_second(speed, frame_length_mm, settings.frames_per_point)
    cameras = settings.rig.auxiliaries + 1
    return Motion(
        exposure_us=exposure,
        max_exposure_us=longest,
        blur_mm=blur_mm(speed, exposure),
        blur_px=blur_mm(speed, exposure) / nearest_pixel_mm,
        frame_length_mm=frame_length_mm,
        gap_free_fps=frames_per_second(speed, frame_length_mm, 1),
        fps=fps,
        data_mb_s=cameras * width * height * settings.camera.bytes_per_pixel * fps / 1e6,
        max_speed_m_s=settings.camera.max_fps * frame_length_mm / settings.frames_per_point / 1000,
        cores=count_cores(fps, cameras, settings.camera.size_px),
    )
