"""Synchronisation of the cameras, from the images: an early or late camera shows the moving material displaced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.rig import Rig
from beltscape.core.live.findings import Finding
from beltscape.core.live.translatable_message import Message
from beltscape.health.settings import SYNCHRONISATION, HealthSettings

SIGMAS = 3.0
"""A delay is a fault where it exceeds the limit and this number of σ."""
_LEAST_SPREAD = 0.1
"""Least relative difference of speeds that separates a delay from a moved camera; less amplifies errors tenfold."""
_RELATIVE_SIGMA = 0.01
"""Relative error of the volume beside that of the depth: fewer points are measured at steps."""


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay of a camera against the core; NaN: not measured."""

    displacement_mm: float
    """Displacement of the moving material along the travel: positive for a camera that exposes later."""
    sigma_mm: float
    speed_mm_s: float
    """Speed of the belt, positive."""

    @property
    def delay_ms(self) -> float:
        """Return the displacement as time."""
        return 1000 * self.displacement_mm / self.speed_mm_s

    @property
    def sigma_ms(self) -> float:
        """Return one standard deviation of the delay."""
        return 1000 * self.sigma_mm / self.speed_mm_s

    def exceeds(self, limit_ms: float) -> bool:
        """Return whether the delay is beyond the limit and `SIGMAS`."""
        return abs(self.delay_ms) > max(limit_ms, SIGMAS * self.sigma_ms)


def separate_delay(delays: Sequence[Delay]) -> tuple[float, float]:
    """Return a camera's delay in ms and its σ from frames at different speeds.

    A camera that moved displaces the material by the same length at every speed, an unsynchronised one in proportion
    to the speed. At a single speed the two cannot be distinguished, and σ is infinite.
    """
    used = [one for one in delays if np.isfinite(one.displacement_mm)]
    speed = np.array([one.speed_mm_s for one in used])
    if len(used) < 2 or np.ptp(speed) < _LEAST_SPREAD * speed.max():
        return float("nan"), float("inf")
    shift = np.array([one.displacement_mm for one in used])
    sigma = np.array([one.sigma_mm for one in used])
    design = np.stack([speed, np.ones_like(speed)], axis=1) / sigma[:, None]
    normal = design.T @ design
    covariance = np.linalg.inv(normal)
    slope = float((covariance @ (design.T @ (shift / sigma)))[0])
    return 1000 * slope, 1000 * float(np.sqrt(covariance[0, 0]))


def compute_core_delay(delays: Mapping[str, Delay]) -> Delay:
    """Return the core's delay against the auxiliary that it is nearest to: a late core is late for all."""
    nearest = min(delays.values(), key=lambda one: abs(one.displacement_mm))
    return Delay(-nearest.displacement_mm, nearest.sigma_mm, nearest.speed_mm_s)


def find_late_core(delays: Mapping[str, Delay], limit_ms: float) -> Delay | None:
    """Return the core's delay if all auxiliaries, at least two, are displaced by the same; else None."""
    if len(delays) < 2 or not all(one.exceeds(limit_ms) for one in delays.values()):
        return None
    middle = float(np.median([one.displacement_mm for one in delays.values()]))
    for one in delays.values():
        if abs(one.displacement_mm - middle) > max(SIGMAS * one.sigma_mm, 0.25 * abs(middle)):
            return None
    return replace(compute_core_delay(delays), displacement_mm=-middle)


def check_synchronisation(
    camera: str, delay: Delay, systematic_mm: float, settings: HealthSettings
) -> Finding:
    """Return the finding "camera_sync" of a camera; ``systematic_mm`` is the error of depth that the delay causes."""
    limit = max(settings.skew_ms, SIGMAS * delay.sigma_ms)
    finding = Finding(SYNCHRONISATION, delay.delay_ms, delay.sigma_ms, limit, "ms", camera)
    if not delay.exceeds(settings.skew_ms):
        return finding
    side = "after" if delay.delay_ms > 0 else "before"
    shown_ms, travel_mm = round(abs(delay.delay_ms), 2), round(abs(delay.displacement_mm), 2)
    text = Message(
        f"{camera}: its images are taken {shown_ms:g} ms {side} the other cameras' "
        f"({travel_mm:g} mm of the belt's travel); check its trigger cable, delay and clock",
        "camera_sync_late" if delay.delay_ms > 0 else "camera_sync_early",
        delay=shown_ms,
        travel=travel_mm,
    )
    return Finding(
        SYNCHRONISATION,
        delay.delay_ms,
        delay.sigma_ms,
        limit,
        "ms",
        camera,
        text,
        "degraded",
        systematic_mm,
        _RELATIVE_SIGMA,
    )


def make_unmeasured_finding(camera: str, settings: HealthSettings) -> Finding:
    """Return the finding of a camera whose delay the frame does not show."""
    return Finding(SYNCHRONISATION, float("nan"), float("nan"), settings.skew_ms, "ms", camera)


def compute_depth_error(
    camera: str, displacement_mm: float, along: NDArray[np.float64], distance_mm: float, rig: Rig
) -> float:
    """Return the error of the depth, mm, by a camera that shows the material displaced along ``along`` (3,).

    The auxiliaries are averaged; a late core displaces the material against all of them.
    """
    slopes = {
        name: float(abs(center @ along) / (center @ center))
        for name, center in ((name, rig.cam_from_core[name].center_mm) for name in rig.auxiliaries)
    }
    if camera == rig.core:
        share = float(np.sqrt(np.mean(np.square(list(slopes.values()))) / len(slopes)))
    else:
        share = slopes[camera] / len(slopes)
    return abs(displacement_mm) * distance_mm * share
