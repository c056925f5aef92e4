"""Synchronisation of the cameras, from the images: an early or late camera shows the moving material displaced.

By many checks together a delay becomes significant that a single check leaves below its noise.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.alarm_catalogue import CAMERA_SYNC
from beltscape.core.findings import Finding
from beltscape.core.geometry.rig import Rig
from beltscape.core.translatable_message import make_message
from beltscape.health.settings import HealthSettings

SIGMAS = 3.0
"""A delay is a fault where it exceeds the limit and this number of σ."""
_LEAST_SPREAD = 0.1
"""Least relative difference of speeds that separates a delay from a moved camera; less amplifies errors tenfold."""
_RELATIVE_SIGMA = 0.01
"""Relative error of the volume beside that of the depth: fewer points are measured at steps."""


@dataclass(frozen=True, slots=True)
class CameraDelay:
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


def separate_delay(delays: Sequence[CameraDelay]) -> tuple[float, float]:
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


def compute_core_delay(delays: Mapping[str, CameraDelay]) -> CameraDelay:
    """Return the core's delay against the auxiliary that it is nearest to: a late core is late for all."""
    nearest = min(delays.values(), key=lambda one: abs(one.displacement_mm))
    return CameraDelay(-nearest.displacement_mm, nearest.sigma_mm, nearest.speed_mm_s)


def find_late_core(delays: Mapping[str, CameraDelay], limit_ms: float) -> CameraDelay | None:
    """Return the core's delay if all auxiliaries, at least two, are displaced by the same; else None."""
    if len(delays) < 2 or not all(one.exceeds(limit_ms) for one in delays.values()):
        return None
    middle = float(np.median([one.displacement_mm for one in delays.values()]))
    for one in delays.values():
        if abs(one.displacement_mm - middle) > max(SIGMAS * one.sigma_mm, 0.25 * abs(middle)):
            return None
    return replace(compute_core_delay(delays), displacement_mm=-middle)


def check_synchronisation(
    camera: str, delay: CameraDelay, systematic_mm: float, settings: HealthSettings
) -> Finding:
    """Return the finding "camera_sync" of a camera; ``systematic_mm`` is the error of depth that the delay causes."""
    limit = max(settings.skew_ms, SIGMAS * delay.sigma_ms)
    finding = Finding(CAMERA_SYNC, delay.delay_ms, delay.sigma_ms, limit, "ms", camera)
    if not delay.exceeds(settings.skew_ms):
        return finding
    text = make_message(
        "camera_sync_late" if delay.delay_ms > 0 else "camera_sync_early",
        subject=camera,
        delay=round(abs(delay.delay_ms), 2),
        travel=round(abs(delay.displacement_mm), 2),
    )
    return Finding(
        CAMERA_SYNC,
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
    return Finding(CAMERA_SYNC, float("nan"), float("nan"), settings.skew_ms, "ms", camera)


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


_POOLED_CHECKS, _LEAST_CHECKS = 12, 6
"""Number of checks that are pooled, and from which on they are: the error common to all material is reached then."""
_APART = 0.5
"""Travel between two pooled checks, over the distance of the belt, so that they show different material."""
_CHANGED = 4.0
"""A check that differs from the pooled ones by this number of its σ begins a new pool."""
_COMMON = 1.5e-4
"""σ of the displacement of all auxiliaries against the core, over the distance; -0.0002 to 0.0001 in four rigs."""
_PARALLAX = 5e-4
"""σ of the displacement over the baseline along the travel: the camera sees other sides of the stones; 0.0001 to
0.0004 in three rigs."""
_OWN = 5e-5
"""σ of a camera's own displacement beside both, over the distance; up to 4e-5 in three rigs."""
_CAUTION = 1.2
"""Factor on σ, whose parts are known from four rigs only: of 1000 sound rigs fewer than ten are accused."""
_UNKNOWN = 1e3
"""σ, over the largest displacement, of the delay of a camera that is known to be late."""
_STATIC = 0.5
"""Share of its delay by which a camera's image is displaced at the same instant, from which it may have moved."""
_SEPARATE = 4.0
"""A late camera must explain the displacements better than any other, by this difference of χ² (2 σ)."""


@dataclass(frozen=True, slots=True)
class PairCheck:
    """Displacements of the auxiliaries against the core in one pair of frames, by name, mm along the travel."""

    moving_mm: Mapping[str, float]
    """Of what moves with the belt."""
    same_mm: Mapping[str, float]
    """Of the images of one instant."""
    noise_mm: Mapping[str, float]
    """One standard deviation of ``moving_mm`` that is independent of other checks."""
    speed_mm_s: float
    distance_mm: float


class CheckPool:
    """The last checks that showed different material."""

    def __init__(self) -> None:
        self._checks: deque[PairCheck] = deque(maxlen=_POOLED_CHECKS)
        self._position_mm = -np.inf

    def add(self, check: PairCheck, position_mm: float) -> tuple[PairCheck, ...]:
        """Add the check at a position of the belt and return the pooled ones; a change begins a new pool."""
        travel = abs(position_mm - self._position_mm)
        if self._is_changed(check):
            self._checks.clear()
        elif travel < _APART * check.distance_mm:
            return tuple(self._checks)
        self._checks.append(check)
        self._position_mm = position_mm
        return tuple(self._checks)

    def _is_changed(self, check: PairCheck) -> bool:
        for name, newest in check.moving_mm.items():
            known = [one.moving_mm[name] for one in self._checks if name in one.moving_mm]
            if known and abs(newest - np.mean(known)) > _CHANGED * (
                np.hypot(check.noise_mm[name], _COMMON * check.distance_mm) * np.sqrt(1 + 1 / len(known))
            ):
                return True
        return False


def pool_delays(
    checks: Sequence[PairCheck], core: str, baseline_mm: Mapping[str, float]
) -> dict[str, CameraDelay]:
    """Return each camera's delay by all checks; without a camera whose delay they leave open.

    What all auxiliaries have in common, and what grows with the baseline, is an error of the comparison within its σ;
    a camera is late if its displacement is explained by neither, and by no other camera's delay as well. The others'
    delays are then given beside that one. A camera whose images of the same instant are displaced, too, may have
    moved: its delay is open.

    Parameters
    ----------
    checks
        Checks of different material; fewer than six give no delay.
    core
        Name of the core.
    baseline_mm
        Of each auxiliary, along the travel.
    """
    least = max(_LEAST_CHECKS, 0.5 * len(checks))
    names = [name for name in baseline_mm if sum(name in one.moving_mm for one in checks) >= least]
    if not names:
        return {}
    mean = _average(checks, "moving_mm", names)
    covariance = _compute_covariance(checks, names, np.array([baseline_mm[name] for name in names]))
    effects = np.vstack([-np.ones(len(names)), np.eye(len(names))])
    cameras = [core, *names] if len(names) > 1 else names
    effects = effects if len(names) > 1 else effects[1:]
    shift, sigma = _estimate(mean, covariance, effects)
    gains = (shift / sigma) ** 2
    late = int(np.argmax(gains))
    if gains[late] > SIGMAS**2:
        candidates = [
            name for name, gain in zip(cameras, gains, strict=True) if gain > gains[late] - _SEPARATE
        ]
        at_rest = _estimate(_average(checks, "same_mm", names), covariance, effects)[0][late]
        if len(candidates) > 1 or abs(at_rest) > _STATIC * abs(shift[late]):
            return {}
        own = shift[late], sigma[late]
        free = covariance + (_UNKNOWN * np.abs(mean).max()) ** 2 * np.outer(effects[late], effects[late])
        shift, sigma = _estimate(mean, free, effects)
        shift[late], sigma[late] = own
    speed = float(np.mean([one.speed_mm_s for one in checks]))
    return {
        name: CameraDelay(float(d), float(s), speed) for name, d, s in zip(cameras, shift, sigma, strict=True)
    }


def _average(checks: Sequence[PairCheck], what: str, names: Sequence[str]) -> NDArray[np.float64]:
    """Return each camera's mean (N,) over the checks that have it."""
    return np.array([np.mean(_collect(checks, what, name)) for name in names], np.float64)


def _collect(checks: Sequence[PairCheck], what: str, name: str) -> list[float]:
    """Return a camera's values in the checks that have it."""
    return [getattr(one, what)[name] for one in checks if name in one.moving_mm]


def _compute_covariance(
    checks: Sequence[PairCheck], names: Sequence[str], baseline_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariance (N, N) of the mean displacements of sound cameras, mm²."""
    distance = float(np.mean([one.distance_mm for one in checks]))
    noise: list[float] = []
    for name in names:
        moving, sigmas = _collect(checks, "moving_mm", name), _collect(checks, "noise_mm", name)
        variance = max(float(np.mean(np.square(sigmas))), float(np.var(moving, ddof=1)))
        noise.append(variance / len(moving))
    own = np.diag(np.array(noise) + (_OWN * distance) ** 2)
    shared = (_COMMON * distance) ** 2 + _PARALLAX**2 * np.outer(baseline_mm, baseline_mm)
    return np.asarray(_CAUTION**2 * (own + shared), np.float64)


def _estimate(
    mean: NDArray[np.float64], covariance: NDArray[np.float64], effects: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the displacement (K,) of each camera, were it alone late, and its σ; ``effects`` is (K, N)."""
    weighted = effects @ np.linalg.inv(covariance)
    information = np.einsum("kn,kn->k", weighted, effects)
    return weighted @ mean / information, 1 / np.sqrt(information)
