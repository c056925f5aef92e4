"""The monitor of the images: it carries the checks from frame to frame and decides what is matched."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Float32Array
from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding, worst_effect
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.health.image_statistics import ImageSample, ImageStatistics, sample_images
from beltscape.health.images.exposure import (
    check_brightness,
    check_flicker,
    check_saturation,
    check_sunlight,
    measure_light_step,
)
from beltscape.health.images.lamp import check_lamp
from beltscape.health.images.obstruction import (
    SHORT_MEMORY,
    LightMap,
    accumulate_light,
    check_obstruction,
    compute_block_rays,
    learn_light,
    sample_light,
)
from beltscape.health.images.projected_pattern import check_projected_pattern, is_partly_dark, measure_light
from beltscape.health.images.repeated import ImageChange, check_repeated, measure_changes
from beltscape.health.images.sharpness import check_contrast
from beltscape.health.reference import ImageReferences, Reference, learn_reference
from beltscape.health.settings import HealthSettings

_FLICKER_FRAMES = 8
"""Number of frames whose median brightness the present one is compared with."""
_CONTINUOUS = 0.15
"""Largest difference of the bare belt's log brightness from the light that follows from the frames before."""
_KEPT_CHANGE = 0.05
"""Change of the log light from which it is kept again: a third of `_CONTINUOUS`, so that a next run can follow it."""
_COVERED_SIGMA = 0.3
"""σ of the log light while no bare belt shows it."""
_LIGHT_FRAMES = 12
"""Number of frames of a moving belt before dirt is searched."""
_LEAST_COMPARED = 3
"""Number of cameras from which on one that is darker than the others can be told."""
_MOVING = 3.0
"""Change over noise from which a frame shows other material than the one before."""
_AUXILIARY_SHARE = 0.25
"""Share of a fault's volume error that it has in one of several auxiliaries, instead of the core."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageCheck:
    """The result of the checks of a frame's images."""

    findings: tuple[Finding, ...]
    frames: FrameSet
    """The frame set with the cameras that can be matched; without images if nothing can be measured."""
    is_whole: bool
    """Whether no camera was left out of a frame that is matched."""
    window_light: Mapping[str, Float32Array] | None = None
    """Light of the cameras without another fault, which shows dirt on their windows; None: it says nothing."""
    is_moving: bool = False
    """Whether the frame shows other material than the one before."""
    is_still: bool = False
    """Whether every image shows what that camera's image before showed, but for noise; False: not known either."""


@dataclass(frozen=True, slots=True)
class ExpectedCheck:
    """What the checks of a frame will probably find; the fields of `ImageCheck` that others prepare for."""

    left_out: frozenset[str] = frozenset()
    """Cameras whose image is not matched."""
    matches: bool = True
    """Whether anything is matched."""
    window_cameras: tuple[str, ...] | None = None
    """Cameras whose light shows dirt on their windows; None: it says nothing, or the belt stands."""


class ImageMonitor:
    """Checks the images of successive frame sets of one rig; the same frames give the same findings."""

    def __init__(
        self,
        rig: Rig,
        settings: HealthSettings,
        learned: ImageReferences | None = None,
        keep: Callable[[ImageReferences], None] | None = None,
    ) -> None:
        """``learned`` is what an earlier run learned; ``keep`` receives it whenever it has changed."""
        self._rig, self._settings, self._keep = rig, settings, keep
        self._must_forget = False
        self._set_learned(learned)
        self._rows_before: dict[str, Float32Array] = {}
        self._expected, self._last = ExpectedCheck(), ExpectedCheck()
        self._recorded = ""
        """Of the frame before, the recorded frame that it shows."""
        self._lit_before: dict[str, ImageStatistics] = {}
        """The last frame whose exposure times are known."""
        self._lights: deque[float] = deque(maxlen=_FLICKER_FRAMES)
        self._rays: NDArray[np.float64] | None = None

    def _set_learned(self, learned: ImageReferences | None) -> None:
        """Compare with ``learned`` from now on; None: learn from the next sound frames."""
        self._reference: Reference | None = None if learned is None else learned.reference
        self._learned: list[dict[str, ImageStatistics]] = []
        self._light = self._kept_light = 0.0 if learned is None else learned.light
        """Logarithm of the light over that of the reference; ``_kept_light``: when it was kept."""
        self._light_maps: dict[str, LightMap] = {}
        self._light_references: dict[str, Float32Array] = (
            {} if learned is None else dict(learned.window_light)
        )
        self._recent_maps: dict[str, LightMap] = {}
        self._moving_frames = 0
        self._dirt: tuple[Finding, ...] = ()

    def learn_anew(self) -> None:
        """Forget what was learned, before the next frame is checked; any thread may call it."""
        self._must_forget = True

    @property
    def reference(self) -> Reference | None:
        """Return what was learned from the first sound frames; None before."""
        return self._reference

    @property
    def checks_images(self) -> bool:
        """Return whether the settings have images checked."""
        return self._settings.images

    @property
    def is_learning(self) -> bool:
        """Return whether what sound images show is not known yet, and being learned."""
        return self._settings.images and self._settings.learning and self._reference is None

    def expect(self) -> ExpectedCheck:
        """Return what the check of a coming frame will probably find: what two frames in a row have shown."""
        return self._expected

    def check_images(self, frames: FrameSet, sampled: Mapping[str, ImageSample] | None = None) -> ImageCheck:
        """Return the findings about a frame's images, and what of them can be matched.

        ``sampled`` is the result of `sample_images` for all its images, where it is known.
        """
        if self._must_forget:
            self._must_forget = False
            self._set_learned(None)
        images = {name: image for name, image in frames.images.items() if name in self._rig.cameras}
        if not self._settings.images or not images:
            return ImageCheck((), frames, True)
        known = sampled if sampled is not None and sampled.keys() >= images.keys() else sample_images(images)
        rows = {name: known[name].rows for name in images}
        statistics = {
            name: replace(known[name].statistics, exposure_us=frames.exposures_us.get(name, 1.0))
            for name in images
        }
        if frames.recorded and frames.recorded == self._recorded:
            self._rows_before = {}  # a loop shows it again, with the frames between left out
        self._recorded = frames.recorded
        noise = min(one.noise for one in statistics.values())
        changes = measure_changes(self._rows_before, rows, noise)
        findings = self._check(statistics, changes)
        is_sound = worst_effect(findings) == "none" and _has_known_exposure(statistics)
        if self._settings.learning and self._reference is None and is_sound:
            self._learn(statistics)
        self._rows_before = rows
        blind = {one.subject for one in findings if one.effect == "missing"}
        check = self._select(frames, blind, tuple(map(self._weight_camera, findings)))
        light = _select_window_light(statistics, findings)
        check = replace(
            check, window_light=light, is_moving=_is_moving(changes), is_still=_is_still(images, changes)
        )
        self._note_expected(check, frozenset(images) - check.frames.images.keys())
        return check

    def _note_expected(self, check: ImageCheck, left_out: frozenset[str]) -> None:
        """Expect what a frame has shown where the one before showed it, too; a single frame changes nothing."""
        light = tuple(check.window_light) if check.is_moving and check.window_light is not None else None
        before, self._last = self._last, ExpectedCheck(left_out, bool(check.frames.images), light)
        if (before.left_out, before.matches) == (self._last.left_out, self._last.matches):
            self._expected = self._last

    def check_depth(
        self, check: ImageCheck, depth: DepthMap, light: Mapping[str, LightMap] | None = None
    ) -> tuple[Finding, ...]:
        """Return the findings that need the depth of a frame whose images were checked.

        Dirt is searched in frames of a moving belt; while it stands the last findings hold. ``light`` is the result
        of `sample_light` for this depth, where it is known; it holds for the cameras that it was sampled of.
        """
        if check.window_light is None:
            return ()
        self._moving_frames += check.is_moving
        if check.is_moving:
            if light is None or light.keys() != check.window_light.keys():
                self._rays = compute_block_rays(self._rig) if self._rays is None else self._rays
                light = sample_light(check.window_light, self._rig, self._rays, depth)
            self._dirt = tuple(map(self._weight_camera, self._check_dirt(light)))
        return self._dirt

    def _check_dirt(self, lights: Mapping[str, LightMap]) -> list[Finding]:
        for name, light in lights.items():
            self._light_maps[name] = accumulate_light(self._light_maps.get(name), light)
            self._recent_maps[name] = accumulate_light(self._recent_maps.get(name), light, SHORT_MEMORY)
        if self._moving_frames < _LIGHT_FRAMES:
            return []
        if not self._light_references and self._moving_frames >= max(
            _LIGHT_FRAMES, self._settings.learning_frames
        ):
            self._light_references = {
                name: learn_light(light, self._settings) for name, light in self._light_maps.items()
            }
            self._keep_learned()
        return [
            check_obstruction(
                name, light, self._recent_maps[name], self._light_references.get(name), self._settings
            )
            for name, light in self._light_maps.items()
            if name in lights
        ]

    def _check(
        self, statistics: dict[str, ImageStatistics], changes: Mapping[str, ImageChange]
    ) -> tuple[Finding, ...]:
        """Return the findings of images that have changed so much since the frame before."""
        settings, reference = self._settings, self._reference
        step_sigma, light, light_sigma = self._follow_light(statistics)
        pattern = check_projected_pattern(statistics, reference, self._light, settings)
        flicker = check_flicker(tuple(self._lights), step_sigma, settings)
        # cameras see different shares of a dark part, and it comes at once
        compared = (
            [] if is_partly_dark(pattern) else [*check_contrast(statistics, reference, settings), flicker]
        )
        findings = [
            *check_saturation(statistics, settings),
            *check_brightness(statistics, reference, settings),
            *compared,
            *check_repeated(changes),
            *pattern,
            check_sunlight(statistics, reference, settings),
            check_lamp(statistics, reference, light, light_sigma, settings),
        ]
        return tuple(findings)

    def _follow_light(self, statistics: dict[str, ImageStatistics]) -> tuple[float, float, float]:
        """Update the light; return the σ of its last step, and the light with its σ, NaN where they are not known.

        The bare belt's brightness is taken where it follows from the light before: else material covers the belt.
        """
        if not _has_known_exposure(statistics):
            return float("nan"), float("nan"), float("nan")
        before, self._lit_before = self._lit_before, statistics
        step, step_sigma = measure_light_step(before, statistics) if before else (0.0, float("nan"))
        step = step if np.isfinite(step) else 0.0
        self._lights.append((self._lights[-1] if self._lights else 0.0) + step)
        self._light += step
        if self._reference is None:
            return step_sigma, float("nan"), float("nan")
        light, sigma = measure_light(statistics, self._reference)
        if abs(light - self._light) < _CONTINUOUS:
            self._light = light
            if abs(light - self._kept_light) > _KEPT_CHANGE:
                self._keep_learned()
        else:
            sigma = _COVERED_SIGMA
        return step_sigma, self._light, sigma

    def _learn(self, statistics: dict[str, ImageStatistics]) -> None:
        self._learned.append(statistics)
        if len(self._learned) >= self._settings.learning_frames:
            self._reference, self._learned, self._light = learn_reference(self._learned), [], 0.0
            self._keep_learned()

    def _keep_learned(self) -> None:
        if self._keep is not None and self._reference is not None:
            self._kept_light = self._light
            self._keep(ImageReferences(self._reference, self._light_references, self._light))

    def _weight_camera(self, finding: Finding) -> Finding:
        """Return the finding as it concerns the volume: an auxiliary that fails is left out, the core is not."""
        if finding.subject in ("", self._rig.core) or not finding.is_fault:
            return finding
        effect = "degraded" if finding.effect == "missing" else finding.effect
        sigma = _AUXILIARY_SHARE * finding.relative_sigma
        return replace(finding, effect=effect, relative_sigma=sigma)

    def _select(self, frames: FrameSet, blind: set[str], findings: tuple[Finding, ...]) -> ImageCheck:
        """Return the check with the images of cameras that are not ``blind``; "" stands for all cameras."""
        images = {name: image for name, image in frames.images.items() if name not in blind}
        if not blind & {"", self._rig.core} and len(images) > 1:
            return ImageCheck(findings, replace(frames, images=images), not blind)
        return ImageCheck(findings, replace(frames, images={}), True)


def _is_moving(changes: Mapping[str, ImageChange]) -> bool:
    """Return whether most images show other material than the ones before."""
    finite = [one.noise_ratio for one in changes.values() if np.isfinite(one.noise_ratio)]
    return bool(finite) and float(np.median(finite)) > _MOVING


def _is_still(cameras: Collection[str], changes: Mapping[str, ImageChange]) -> bool:
    """Return whether each camera's image shows what its image before showed: then no camera has moved, either."""
    return set(cameras) == changes.keys() and all(one.noise_ratio <= _MOVING for one in changes.values())


def _select_window_light(
    statistics: Mapping[str, ImageStatistics], findings: Sequence[Finding]
) -> dict[str, Float32Array] | None:
    """Return the light of the cameras whose image has no other fault; None where it says nothing about dirt.

    Sunlight, dust or the projector may change the light of all cameras, and two cannot be told apart.
    """
    faulty = {one.subject for one in findings if one.is_fault}
    has_other_light = any(one.effect != "none" and not one.subject for one in findings)
    light = {name: one.level for name, one in statistics.items() if name not in faulty}
    return None if has_other_light or len(light) < _LEAST_COMPARED else light


def _has_known_exposure(statistics: dict[str, ImageStatistics]) -> bool:
    return all(np.isfinite(one.exposure_us) for one in statistics.values())
