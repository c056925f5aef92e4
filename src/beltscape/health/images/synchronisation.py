"""Synchronisation of a camera, from the images: the belt's motion displaces what an early or late camera shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.findings import Finding
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.health.settings import HealthSettings

FloatArray = NDArray[np.float64]
_ROUNDS = 5
_HUBER = 1.5
"""Residuals beyond this number of σ are weighted down."""
_SIGMAS = 3.0
"""A skew is a fault where it exceeds the limit and this number of σ."""


@dataclass(frozen=True, slots=True)
class MotionOffset:
    """The displacement of a camera's points along the belt's image motion."""

    delay_ms: float
    """Displacement as time: positive for a camera that took its image later than the core."""
    sigma_ms: float
    speed_mm_s: float
    """Signed speed of the belt at that frame."""


def estimate_motion_offset(
    residual_px: FloatArray, motion_px_per_ms: FloatArray, speed_mm_s: float
) -> MotionOffset:
    """Estimate a camera's delay from the residuals of its tie points.

    Parameters
    ----------
    residual_px
        (N, 2) observed less predicted position of each point in the camera; NaN: not known. A row may hold the
        component across the epipolar line only, if ``motion_px_per_ms`` is projected onto the same direction.
    motion_px_per_ms
        (N, 2) motion of the points' images per millisecond, see `predict_image_motion`.
    speed_mm_s
        Speed of the belt.

    Returns
    -------
    MotionOffset
        With an infinite σ for a standing belt or too few points.
    """
    good = np.isfinite(residual_px).all(axis=1) & np.isfinite(motion_px_per_ms).all(axis=1)
    residual, motion = residual_px[good], motion_px_per_ms[good]
    energy = (motion * motion).sum(axis=1)
    if len(residual) < 8 or not energy.sum() > 1e-6:
        return MotionOffset(0.0, float("inf"), speed_mm_s)
    weights, delay, scale = np.ones(len(residual)), 0.0, 1.0
    for _ in range(_ROUNDS):
        delay = float((weights * (residual * motion).sum(axis=1)).sum() / (weights * energy).sum())
        misfit = np.linalg.norm(residual - delay * motion, axis=1)
        scale = max(float(np.median(misfit)) * MAD_TO_SIGMA, 1e-3)
        weights = np.minimum(1.0, _HUBER * scale / np.maximum(misfit, 1e-9))
    return MotionOffset(delay, float(scale / np.sqrt((weights * energy).sum())), speed_mm_s)


def predict_image_motion(points_mm: FloatArray, velocity_mm_s: FloatArray, rig: Rig, name: str) -> FloatArray:
    """Return the motion (N, 2) in px per millisecond of the core's points (N, 3) in a camera's image.

    ``velocity_mm_s`` (3,) is the belt's velocity in the core camera's frame.
    """
    camera, pose = rig.cameras[name], rig.cam_from_core[name]
    step = 0.5e-3 * np.asarray(velocity_mm_s)
    return camera.project(pose.apply(points_mm + step)) - camera.project(pose.apply(points_mm - step))


def separate_delay(offsets: Sequence[MotionOffset]) -> tuple[float, float]:
    """Return a camera's delay in ms and its σ from frames at different speeds.

    A camera that moved displaces its points by the same pixels at every speed, an unsynchronised one in proportion to
    the speed. At one speed only the two cannot be told apart, and σ is infinite.
    """
    used = [one for one in offsets if np.isfinite(one.sigma_ms) and one.speed_mm_s]
    if len(used) < 2:
        return float("nan"), float("inf")
    speed = np.array([one.speed_mm_s for one in used])
    shift = np.array([one.delay_ms for one in used]) * speed  # µm along the belt: delay · speed + constant
    sigma = np.array([one.sigma_ms for one in used]) * np.abs(speed)
    design = np.stack([speed, np.ones_like(speed)], axis=1) / sigma[:, None]
    normal = design.T @ design
    if np.linalg.cond(normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal)))) > 1e8:
        return float("nan"), float("inf")
    covariance = np.linalg.inv(normal)
    delay = float((covariance @ (design.T @ (shift / sigma)))[0])
    return delay, float(np.sqrt(covariance[0, 0]))


def check_synchronisation(camera: str, delay_ms: float, sigma_ms: float, settings: HealthSettings) -> Finding:
    """Return the finding "camera_sync" of a camera from its delay and σ."""
    finding = Finding("camera_sync", delay_ms, sigma_ms, settings.skew_ms, "ms", camera)
    if not abs(delay_ms) > max(settings.skew_ms, _SIGMAS * sigma_ms):
        return finding
    text = (
        f"{camera}: its images are taken {abs(delay_ms):.1f} ms {'after' if delay_ms > 0 else 'before'} the core's; "
        "check its trigger cable, its trigger delay and its clock"
    )
    return Finding(
        "camera_sync", delay_ms, sigma_ms, settings.skew_ms, "ms", camera, text, "degraded", 0.0, 0.02
    )
