"""What a moving belt asks of exposure, frame rate and data link."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.plan.settings import PlanSettings


@dataclass(frozen=True, slots=True)
class Motion:
    """At the belt's speed."""

    exposure_us: float
    """Of this plan."""
    max_exposure_us: float
    """At which the nearest material is blurred by the allowed pixels; inf where the belt stands still."""
    blur_mm: float
    """Way of the belt during the exposure."""
    blur_px: float
    """The same in the core's image of the nearest material, where it is longest."""
    frame_length_mm: float
    """Along the belt, what one frame gives over the full width at every height."""
    gap_free_fps: float
    """At which frames just meet."""
    fps: float
    """At which each piece of belt is in as many frames as asked for."""
    data_mb_s: float
    """Of all cameras at ``fps``, 10⁶ bytes a second."""
    max_speed_m_s: float
    """At which the camera's fastest frame rate still gives as many frames as asked for."""


def blur_mm(speed_m_s: float, exposure_us: float) -> float:
    """Way of the belt during an exposure: 1 m/s is 0.001 mm/µs."""
    return speed_m_s * exposure_us * 1e-3


def max_exposure_us(speed_m_s: float, blur_px: float, pixel_mm: float) -> float:
    """The exposure during which the belt moves by so many pixels of that edge."""
    return blur_px * pixel_mm / (speed_m_s * 1e-3) if speed_m_s > 0 else float("inf")


def frames_per_second(speed_m_s: float, length_mm: float, frames_per_point: float) -> float:
    """The rate at which each point of the belt is within that many frames of a length."""
    return speed_m_s * 1000 * frames_per_point / length_mm if length_mm > 0 else float("inf")


def compute_motion(settings: PlanSettings, nearest_pixel_mm: float, frame_length_mm: float) -> Motion:
    """For a plan whose nearest material has pixels of that edge and whose frames give that much belt."""
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
