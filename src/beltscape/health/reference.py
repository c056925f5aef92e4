"""Reference values of the cameras: what the images of a sound system showed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from beltscape.core.arrays import Float32Array
from beltscape.health.image_statistics import ImageStatistics
from beltscape.health.settings import HealthSettings

FrameStatistics = Mapping[str, ImageStatistics]
"""Statistics of a frame's images by camera."""
_LARGEST_OFFSET = 0.3
"""Largest offset of a logarithm from the other cameras' that is learned: a fault from the start is not."""
LEAST_SPECKLE = 0.18
"""Contrast that four fifths of the lit blocks exceed under speckle (0.24 to 0.72 in seven rigs; ambient: to 0.12)."""
LEAST_CONTRAST = 0.03
"""Below this contrast there is no texture to compare (bare rubber in ambient light: 0.01)."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraReference:
    """Values of one camera in sound frames; logarithms."""

    mean_level: float
    """Brightness over that of the other cameras."""
    contrast: float
    """Contrast over that of the other cameras."""
    sharpness: float
    """Fine over coarse texture, over that of the other cameras."""
    shading: float
    """Spread between blocks over that of the other cameras."""
    own_contrast: float
    """Contrast of the camera itself."""
    own_sharpness: float
    """Sharpness of the camera itself."""
    own_shading: float
    """Spread between blocks of the camera itself."""
    level: Float32Array
    """`GRID` median level, counts of 255, at the exposure time `exposure_us`."""
    amplitude: Float32Array
    """`GRID` median amplitude of the texture, as ``level``; NaN in references of versions that did not keep it."""
    exposure_us: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Values of all cameras in sound frames."""

    cameras: Mapping[str, CameraReference]
    has_speckle: bool
    """Whether a projected pattern covered the picture."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageReferences:
    """All that a monitor of images has learned; it outlives a run."""

    reference: Reference
    window_light: Mapping[str, Float32Array]
    """By camera, `GRID` float32: light through clean windows, logarithms over the median camera; NaN: not known."""
    light: float
    """Logarithm of the present light over that of ``reference``."""


def has_projector(reference: Reference, settings: HealthSettings) -> bool:
    """Return whether a projector is to light the belt."""
    return settings.projector == "yes" or (settings.projector == "auto" and reference.has_speckle)


def learn_reference(frames: Sequence[FrameStatistics]) -> Reference:
    """Return the medians over sound frames, of the cameras that are in most of them."""
    names = {name: None for frame in frames for name in frame}
    common = [name for name in names if 2 * sum(name in frame for frame in frames) >= len(frames)]
    cameras = {name: _learn_camera([frame for frame in frames if name in frame], name) for name in common}
    return Reference(cameras, float(np.median([measure_speckle(frame) for frame in frames])) > LEAST_SPECKLE)


def _learn_camera(frames: Sequence[FrameStatistics], name: str) -> CameraReference:
    """Return the medians of one camera over frames that have its image."""
    own, first = [frame[name] for frame in frames], frames[0][name]

    def learn_offset(value: Callable[[ImageStatistics], float], limit: float = _LARGEST_OFFSET) -> float:
        # a camera alone in its frame is compared with none
        offsets = [compare_cameras(frame, value)[name] for frame in frames if len(frame) > 1]
        return float(np.clip(np.median(offsets), -limit, limit)) if offsets else float("nan")

    def learn_grid(value: Callable[[ImageStatistics], Float32Array]) -> Float32Array:
        values = [value(one) * (first.exposure_us / one.exposure_us) for one in own]
        return np.median(values, axis=0).astype(np.float32)

    return CameraReference(
        mean_level=learn_offset(log_brightness),
        contrast=learn_offset(log_contrast),
        sharpness=learn_offset(log_sharpness, 2 * _LARGEST_OFFSET),
        shading=learn_offset(log_shading, 4 * _LARGEST_OFFSET),
        own_contrast=float(np.median([log_contrast(one) for one in own])),
        own_sharpness=float(np.median([log_sharpness(one) for one in own])),
        own_shading=float(np.median([log_shading(one) for one in own])),
        level=learn_grid(lambda one: one.level),
        amplitude=learn_grid(lambda one: one.amplitude),
        exposure_us=first.exposure_us,
    )


def compare_cameras(frame: FrameStatistics, value: Callable[[ImageStatistics], float]) -> dict[str, float]:
    """Return each camera's value less the median of the others'; NaN for a single camera."""
    values = {name: value(one) for name, one in frame.items()}
    return {
        name: own - median(other for key, other in values.items() if key != name)
        if len(values) > 1
        else float("nan")
        for name, own in values.items()
    }


def measure_speckle(frame: FrameStatistics) -> float:
    """Return the contrast that four fifths of the lit blocks exceed, median over the cameras."""
    return median(one.lit_contrast for one in frame.values())


def log_brightness(one: ImageStatistics) -> float:
    """Return the logarithm of the mean level."""
    return float(np.log(one.mean_level))


def log_contrast(one: ImageStatistics) -> float:
    """Return the logarithm of the median contrast."""
    return float(np.log(one.contrast))


def log_sharpness(one: ImageStatistics) -> float:
    """Return the logarithm of fine over coarse texture."""
    return one.log_sharpness


def log_shading(one: ImageStatistics) -> float:
    """Return the logarithm of the spread between blocks."""
    return float(np.log(one.shading))
