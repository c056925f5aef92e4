"""Requirements of a moving belt on exposure, frame rate and data link."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.plan.settings import PlanSettings


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
    )
