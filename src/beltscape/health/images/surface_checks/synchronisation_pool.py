"""Delays of the cameras by many checks together: what a single check leaves below its noise becomes significant."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.health.images.surface_checks.synchronisation import SIGMAS, Delay

_WINDOW, _LEAST_CHECKS = 12, 6
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
        self._checks: deque[PairCheck] = deque(maxlen=_WINDOW)
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


def pool_delays(checks: Sequence[PairCheck], core: str, baseline_mm: Mapping[str, float]) -> dict[str, Delay]:
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
    return {name: Delay(float(d), float(s), speed) for name, d, s in zip(cameras, shift, sigma, strict=True)}


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
