"""Repeated images: a camera, or all, delivers an image that it delivered before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.alarm_catalogue import FROZEN_IMAGE
from beltscape.core.arrays import Float32Array
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import make_message

_QUIET = 0.15
"""Change over noise below which an image repeats: two images of a standing belt differ by the noise itself."""
_STILL = 0.15
"""Change over texture, over that of the other cameras, below which an image repeats while the belt moves."""
_MOVING = 4.0
"""Change over noise in the other cameras from which the belt certainly moves."""


@dataclass(frozen=True, slots=True)
class ImageChange:
    """The change of a camera's image since the one before; NaN for a black or uniform image."""

    noise_ratio: float
    """Over √2 of the noise."""
    texture_ratio: float
    """Over the spread of the image's levels."""


def measure_changes(
    before: Mapping[str, Float32Array], now: Mapping[str, Float32Array], noise: float
) -> dict[str, ImageChange]:
    """Return the change of each camera that is in both frames.

    ``before`` and ``now`` are rows of `ImageSample`; ``noise`` is the least variance over the cameras, because
    texture everywhere in a picture raises its estimate.
    """
    changes: dict[str, ImageChange] = {}
    for name, other in now.items():
        one = before.get(name)
        if one is None or one.shape != other.shape:
            continue
        if np.ptp(other) < 4:
            changes[name] = ImageChange(float("nan"), float("nan"))
            continue
        difference = one - other
        rms = float(np.sqrt(np.mean(difference * difference)))
        changes[name] = ImageChange(rms / float(np.sqrt(2 * noise)), rms / float(other.std()))
    return changes


def check_repeated(changes: Mapping[str, ImageChange]) -> list[Finding]:
    """Return the finding "frozen_image" of every camera, from `measure_changes`; one repeated image suffices."""
    return [
        _check_camera(name, change, [other for key, other in changes.items() if key != name])
        for name, change in changes.items()
    ]


def _check_camera(camera: str, change: ImageChange, others: Sequence[ImageChange]) -> Finding:
    finding = Finding(FROZEN_IMAGE, change.noise_ratio, 0.05, _QUIET, "σ of noise", camera)
    known = [other for other in others if np.isfinite(other.noise_ratio)]
    is_still = False
    if known and float(np.median([other.noise_ratio for other in known])) > _MOVING:
        is_still = change.texture_ratio < _STILL * float(np.median([other.texture_ratio for other in known]))
    if not (change.noise_ratio < _QUIET or is_still):
        return finding
    text = make_message("frozen_image", subject=camera)
    return replace(finding, text=text, effect="missing", is_momentary=True)
