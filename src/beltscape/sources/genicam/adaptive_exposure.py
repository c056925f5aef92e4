"""Adaptive exposure: exposure times that bring the pictures to a wanted brightness, within the engineer's bounds."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.core.frames import Image
from beltscape.core.quantities import EXPOSURE

_BRIGHT = 0.98
"""Quantile of the pixels that is brought to the wanted level: few glints, few bright stones."""
_STRIDE = 8
"""Every eighth pixel in either direction is examined."""
_SATURATED = 250.0
"""From this level on the brightness itself is not known: the exposure falls by the largest step."""
_FAULT = 0.1
"""Share of the wanted level below which nothing is changed: a lens is covered, or the light is off."""
_LEAST_LEVELS = 3
"""Number of frames before the first change, and between two changes."""
_NEGLIGIBLE = 1.02
"""A smaller change is not made."""


class AdaptiveExposureSettings(BaseModel):
    """Settings of ``[cameras.adaptive_exposure]``; all cameras change by the same factor."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    shortest_us: Annotated[float, EXPOSURE]
    """Shortest exposure time of any camera."""
    longest_us: Annotated[float, EXPOSURE]
    """Longest exposure time of any camera."""
    level: float = Field(default=150.0, ge=20, le=240)
    """Wanted level of the brightest pixels (98 %) in the median camera, of 255."""
    tolerance: float = Field(default=1.3, gt=1.05, le=4)
    """Factor by which the level may differ from the wanted one before anything is changed."""
    largest_step: float = Field(default=1.5, gt=1.05, le=10)
    """Largest factor of one change."""
    every_s: float = Field(default=2.0, gt=0, le=3600)
    """Least time between two changes."""
    hold_s: float = Field(default=30.0, ge=0, le=36000)
    """The exposure becomes longer only after all pictures were too dark for this time: an empty belt is dark."""
    blur_px: float = Field(default=0.5, gt=0, le=10)
    """Largest motion blur, in pixels of the core camera on the belt at its present speed."""

    @model_validator(mode="after")
    def _check(self) -> AdaptiveExposureSettings:
        if self.shortest_us >= self.longest_us:
            raise ValueError(
                f"shortest_us = {self.shortest_us:g} must be below longest_us = {self.longest_us:g}"
            )
        return self


@dataclass(frozen=True, slots=True)
class ExposureChange:
    """A change of the exposure times."""

    exposures_us: Mapping[str, float]
    """The new exposure time of every camera."""
    factor: float
    """The new over the old exposure times."""
    level: float
    """The level that caused it, of 255."""
    is_by_motion: bool
    """Whether the speed of the belt, not the level, demands it."""


class ExposureController:
    """Decides on changes of the exposure times; it depends on levels and times only."""

    def __init__(self, settings: AdaptiveExposureSettings, exposures_us: Mapping[str, float]) -> None:
        """``exposures_us`` are the exposure times of all cameras at the start, within the bounds."""
        self.exposures_us = dict(exposures_us)
        """The present exposure times."""
        self._settings = settings
        self._recent: deque[float] = deque(maxlen=_LEAST_LEVELS)
        self._dark_since_s: float | None = None
        """Time since which every level was below the tolerance; None: the last one was not."""
        self._brightest = 0.0
        """Greatest level since then."""
        self._changed_s = -np.inf

    def update(self, time_s: float, level: float, blur_limit_us: float = np.inf) -> ExposureChange | None:
        """Return the change that a frame's level demands; None if there is none.

        ``level`` is that of `measure_level`; ``blur_limit_us`` is the longest exposure that motion blur allows.
        """
        settings = self._settings
        longest = max(settings.shortest_us, min(settings.longest_us, blur_limit_us))
        self._follow(time_s, level)
        if max(self.exposures_us.values()) > _NEGLIGIBLE * longest:
            return self._change(time_s, level, longest / max(self.exposures_us.values()), is_by_motion=True)
        if len(self._recent) < _LEAST_LEVELS or time_s - self._changed_s < settings.every_s:
            return None
        wanted = self._find_factor(time_s)
        step = float(np.clip(wanted, 1 / settings.largest_step, settings.largest_step))
        upper = longest / max(self.exposures_us.values())
        lower = settings.shortest_us / min(self.exposures_us.values())
        factor = float(np.clip(step, min(lower, 1.0), max(upper, 1.0)))
        if 1 / _NEGLIGIBLE < factor < _NEGLIGIBLE:
            return None
        return self._change(time_s, level, factor, is_by_motion=False)

    def _follow(self, time_s: float, level: float) -> None:
        self._recent.append(level)
        wanted = self._settings.level
        if not _FAULT * wanted <= level < wanted / self._settings.tolerance:
            self._dark_since_s, self._brightest = None, 0.0
            return
        self._dark_since_s = time_s if self._dark_since_s is None else self._dark_since_s
        self._brightest = max(self._brightest, level)

    def _find_factor(self, time_s: float) -> float:
        """Return the factor that the levels demand, without bounds; 1 within the tolerance."""
        settings = self._settings
        recent = median(self._recent)
        if recent >= _SATURATED:
            return 1 / settings.largest_step
        if recent > settings.level * settings.tolerance:
            return settings.level / recent
        is_held = self._dark_since_s is not None and time_s - self._dark_since_s >= settings.hold_s
        return settings.level / self._brightest if is_held else 1.0

    def _change(self, time_s: float, level: float, factor: float, *, is_by_motion: bool) -> ExposureChange:
        self.exposures_us = {name: round(factor * us, 1) for name, us in self.exposures_us.items()}
        self._recent.clear()
        self._dark_since_s, self._brightest, self._changed_s = None, 0.0, time_s
        return ExposureChange(dict(self.exposures_us), factor, level, is_by_motion)


def measure_level(images: Mapping[str, Image]) -> float:
    """Return the level of the brightest pixels in the median camera, in counts of 255; at least one image."""
    return median(
        float(np.quantile(image[::_STRIDE, ::_STRIDE], _BRIGHT)) * 255 / float(np.iinfo(image.dtype).max)
        for image in images.values()
    )
