"""Reference values of the cameras: what the images of a sound system showed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from beltscape.health.image_statistics import FloatArray, ImageStatistics

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
    level: FloatArray
    """`GRID` median level, counts of 255, at the exposure time `exposure_us`."""
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
    window_light: Mapping[str, FloatArray]
    """By camera, `GRID` float32: light through clean windows, logarithms over the median camera; NaN: not known."""
    light: float
    """Logarithm of the present light over that of ``reference``."""


def learn_reference(frames: Sequence[FrameStatistics]) -> Reference:
    """Return the medians over sound frames; only cameras that are in all of them have a reference."""
    names = [name for name in frames[0] if all(name in frame for frame in frames)]
    mean_level, contrast, sharpness, shading = (
        [compare_cameras(frame, value) for frame in frames]
        for value in (log_brightness, log_contrast, log_sharpness, log_shading)
    )
    cameras = {
        name: CameraReference(
            _learn_offset(mean_level, name),
            _learn_offset(contrast, name),
            _learn_offset(sharpness, name, 2 * _LARGEST_OFFSET),
            _learn_offset(shading, name, 4 * _LARGEST_OFFSET),
            float(np.median([log_contrast(frame[name]) for frame in frames])),
            float(np.median([log_sharpness(frame[name]) for frame in frames])),
            float(np.median([log_shading(frame[name]) for frame in frames])),
            np.median(
                [
                    frame[name].level * (frames[0][name].exposure_us / frame[name].exposure_us)
                    for frame in frames
                ],
                axis=0,
            ).astype(np.float32),
            frames[0][name].exposure_us,
        )
        for name in names
    }
    return Reference(cameras, float(np.median([measure_speckle(frame) for frame in frames])) > LEAST_SPECKLE)


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


def _learn_offset(frames: Sequence[Mapping[str, float]], name: str, limit: float = _LARGEST_OFFSET) -> float:
    return float(np.clip(np.median([frame[name] for frame in frames]), -limit, limit))
