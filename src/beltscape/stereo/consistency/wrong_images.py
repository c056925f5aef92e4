"""Searches for images that are exchanged, mirrored, turned or of another instant.

The frame fits the rig when they are put right: more of its points match where the rig predicts them. Images of
another instant fit those of the others one frame before or after.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Literal

import numpy as np

from beltscape.core.arrays import Array
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.core.translatable_message import make_message
from beltscape.stereo.consistency.isolation import compute_frame_residuals
from beltscape.stereo.consistency.residuals import compute_pair_residuals
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tie_points import (
    MAX_POINTS,
    TiePoints,
    UnguidedMatcher,
    detect_textured_points,
    make_unguided_matcher,
)
from beltscape.stereo.multiview.depth_range import compute_search_range

_FITS_PX = 1.0
"""Greatest systematic residual of a camera that fits, px of the small images."""
_LEAST_INLIERS = 0.6
"""Least share of inliers of a camera that fits."""
_POINTS = 150
"""Number of points that distinguishes a camera that fits from one that does not."""


class FittingPoints:
    """Counts the points of one frame that fit the rig; the rig's pairs are rectified once for all counts."""

    def __init__(self, frame_set: FrameSet, rig: Rig) -> None:
        self.frame_set, self.rig = frame_set, rig
        self.auxiliaries = tuple(name for name in rig.auxiliaries if name in frame_set.images)
        """The auxiliaries that have an image in the frame."""
        self._matched: dict[tuple[int, int, str, int], tuple[FrameSet, TiePoints]] = {}
        """By core image, auxiliary's image, auxiliary and number of points; the frame sets are kept, so that no image
        takes another's identity."""
        self._points_px: dict[tuple[int, int], tuple[Image, Array]] = {}
        """By core image and number of points, the image kept as well."""

    @cached_property
    def unchanged(self) -> dict[str, int]:
        """The points that fit by auxiliary, with the images as they are."""
        return {name: self._count(self.frame_set, name) for name in self.auxiliaries}

    def count_with(self, changed: Mapping[str, Image], above: Mapping[str, int]) -> dict[str, int] | None:
        """Return by auxiliary the points that fit with these images by camera in place of the frame's own.

        None as soon as an auxiliary that the images concern has no more points than ``above`` states for it.
        """
        frame_set = replace(self.frame_set, images={**self.frame_set.images, **changed})
        points = dict(self.unchanged)
        for name in self.list_affected(changed):
            points[name] = self._count(frame_set, name)
            if points[name] <= above[name]:
                return None
        return points

    def list_affected(self, changed: Collection[str]) -> tuple[str, ...]:
        """Return the auxiliaries whose points depend on the images of these cameras."""
        return self.auxiliaries if self.rig.core in changed else tuple(changed)

    def count_agreeing(self, frame_set: FrameSet, names: tuple[str, ...]) -> list[int]:
        """Return by auxiliary the number of points within a pixel of their lines, whether or not it fits."""
        counts: list[int] = []
        for name in names:
            tie_points = self._match(frame_set, name, MAX_POINTS)
            epipolar_px = compute_pair_residuals(tie_points, self.rig, name).epipolar_px
            counts.append(int((np.abs(epipolar_px) < _FITS_PX * tie_points.pixel_scale).sum()))
        return counts

    def count_searched(self, frame_set: FrameSet, names: tuple[str, ...]) -> list[int]:
        """Return by auxiliary the number of points that were searched in its image."""
        return [int(self._match(frame_set, name, MAX_POINTS).searched[name].sum()) for name in names]

    def _count(self, frame_set: FrameSet, name: str) -> int:
        """Return the number of an auxiliary's points on their epipolar lines; 0 if it does not fit."""
        tie_points = self._match(frame_set, name, _POINTS)
        residual = compute_frame_residuals(tie_points, self.rig, (name,)).epipolar[name]
        fits = (
            np.isfinite(residual.rms_px)
            and residual.inlier_share > _LEAST_INLIERS
            and residual.rms_px < _FITS_PX * tie_points.pixel_scale
        )
        return residual.points if fits else 0

    def _match(self, frame_set: FrameSet, name: str, max_points: int) -> TiePoints:
        core, auxiliary = frame_set.images[self.rig.core], frame_set.images[name]
        key = id(core), id(auxiliary), name, max_points
        if key not in self._matched:
            points_px = self._detect_points(core, max_points)
            self._matched[key] = frame_set, self._matcher.match(frame_set, (name,), points_px)
        return self._matched[key][1]

    def _detect_points(self, core: Image, max_points: int) -> Array:
        key = id(core), max_points
        if key not in self._points_px:
            self._points_px[key] = (
                core,
                detect_textured_points(core, self.rig.core_camera, max_points=max_points),
            )
        return self._points_px[key][1]

    @cached_property
    def _matcher(self) -> UnguidedMatcher:
        return make_unguided_matcher(self.rig, compute_search_range(self.rig, self.auxiliaries))


_INSTANT_GAIN = 1.3
"""Least ratio of the points that agree at one instant to those that do at the other, beside `_SIGMAS`: a small change
of occlusions is no evidence."""
_SIGMAS = 3.0
"""Least difference of both numbers of points, in its standard deviations by counting."""
_AMONG_GAIN = 1.6
"""Least ratio of the share of points in which auxiliaries agree with each other to that in which they do with the
core: 1.6 is chosen; on sound rendered rooms it is below 1, since two auxiliaries stand farther apart, and 2.2 to 2.5
with a core of another instant."""
_LEAST_AMONG = 0.25
"""Least share of points in which auxiliaries of one instant agree; heaps of stones have 0.12 to 0.3."""


@dataclass(frozen=True, slots=True)
class OtherInstant:
    """A camera whose images are of another instant than the others'."""

    camera: str
    frames: int
    """Frames by which its images are late; negative: early; 0: by an unknown time."""
    points: int
    """Number of points that agree at its instant, or among the others."""
    own_points: int
    """Number of points that agree at the frame's own instant, or of the others with it."""

    def describe(self) -> str:
        """Return the message of the fault."""
        if not self.frames:
            return make_message(
                "camera_sync_other", camera=self.camera, points=self.points, own=self.own_points
            )
        key = "camera_sync_frame_late" if self.frames > 0 else "camera_sync_frame_early"
        return make_message(key, subject=self.camera, points=self.points, own=self.own_points)


def find_other_instant(
    fitting: FittingPoints, consistency: RigConsistency, previous: FrameSet | None
) -> OtherInstant | None:
    """Return the camera whose images are of another instant; None if the frame does not show one.

    ``previous`` is the frame set before. A camera is late if its image fits the others' of that frame, and early if
    its image of that frame fits the others' of this one. Without it, only a core is found, with which no auxiliary
    agrees although they agree with each other.
    """
    doubted = consistency.find_auxiliaries("contradicting", "unmatched", "undecided")
    is_core_doubted = not consistency.find_auxiliaries("sound")
    if previous is not None:
        for camera in (fitting.rig.core,) if is_core_doubted else doubted:
            found = _compare_frames(fitting, camera, previous)
            if found is not None:
                return found
    return _compare_among_auxiliaries(fitting) if is_core_doubted and len(consistency.cameras) > 1 else None


def is_of_own_instant(fitting: FittingPoints, before: OtherInstant, previous: FrameSet) -> bool:
    """Return whether a frame shows that a camera's images are no longer of another instant.

    Where nothing moves, it shows neither.
    """
    own, other = _count_pair(fitting, before.camera, previous, before.frames)
    return _exceeds(own, other)


def _exceeds(points: int, others: int) -> bool:
    """Return whether significantly more points agree at one instant than at the other."""
    return (
        points >= _INSTANT_GAIN * others and points - others >= _SIGMAS * float(np.sqrt(points + others)) > 0
    )


def _compare_frames(fitting: FittingPoints, camera: str, previous: FrameSet) -> OtherInstant | None:
    """Return by how many frames a camera is late or early; None if its image fits its own frame as well."""
    for frames in (1, -1):
        own, other = _count_pair(fitting, camera, previous, frames)
        if _exceeds(other, own):
            return OtherInstant(camera, frames, other, own)
    return None


def _count_pair(fitting: FittingPoints, camera: str, previous: FrameSet, frames: int) -> tuple[int, int]:
    """Return how many points of a camera agree with the others at its frame, and if it is late by ``frames``."""
    rig, images = fitting.rig, fitting.frame_set.images
    names = fitting.auxiliaries if camera == rig.core else (camera,)
    names = tuple(name for name in names if name in previous.images)
    if rig.core not in previous.images or not names:
        return 0, 0
    cameras = (rig.core, *names)
    is_old = {name: (name == camera) != (frames > 0) for name in cameras}
    mixed = {name: (previous if is_old[name] else fitting.frame_set).images[name] for name in cameras}
    if any(mixed[name].shape != images[name].shape for name in cameras):
        return 0, 0
    return (
        sum(fitting.count_agreeing(fitting.frame_set, names)),
        sum(fitting.count_agreeing(replace(fitting.frame_set, images=mixed), names)),
    )


def _compare_among_auxiliaries(fitting: FittingPoints) -> OtherInstant | None:
    """Return the core if the auxiliaries agree with each other in many more points than with it."""
    rig, names = fitting.rig, fitting.auxiliaries
    with_core = _measure_share(fitting, names)
    others = FittingPoints(fitting.frame_set, _leave_core_out(rig, names))
    among = _measure_share(others, names[1:])
    if among < _AMONG_GAIN * with_core or among < _LEAST_AMONG:
        return None
    return OtherInstant(rig.core, 0, round(100 * among), round(100 * with_core))


def _measure_share(fitting: FittingPoints, names: tuple[str, ...]) -> float:
    """Return the share of the searched points in which auxiliaries agree with the core, as a mean over them."""
    counts = fitting.count_agreeing(fitting.frame_set, names)
    return float(np.mean(np.array(counts) / np.maximum(fitting.count_searched(fitting.frame_set, names), 1)))


def _leave_core_out(rig: Rig, names: tuple[str, ...]) -> Rig:
    """Return the rig of the auxiliaries alone, about the first of them."""
    poses = {name: rig.relative_pose(name, names[0]) for name in names}
    return Rig(names[0], {name: rig.cameras[name] for name in names}, poses)


Flip = Literal["left to right", "upside down", "by 180°"]
_STEPS: dict[Flip, tuple[int, int]] = {"left to right": (1, -1), "upside down": (-1, 1), "by 180°": (-1, -1)}
"""Steps of rows and columns that undo each flip."""


_WELL_CONFIRMED = 2
"""With this number of sound auxiliaries, the core's image is not flipped."""
_FLIP_GAIN = 1.3
"""Least ratio of the points that fit after the flip to those that fit before: where all cameras look in parallel, a
flip of all images leaves corresponding rows together."""
_SHARE = 0.4
"""A flipped image fits if it finds this share of the points of the best auxiliary."""


@dataclass(frozen=True, slots=True)
class Mirroring:
    """Cameras whose images are mirrored or turned by half a turn."""

    cameras: tuple[str, ...]
    flip: Flip


def find_mirroring(fitting: FittingPoints, consistency: RigConsistency) -> Mirroring | None:
    """Return the cameras whose flipped images fit the rig: all, the core, or one unmatched auxiliary.

    The result is None if a knock of one camera explains the frame, or if no image is unmatched: hardly any point of a
    mirrored image lies where the rig predicts it.
    """
    change = consistency.pose_change
    if change is not None and change.is_plausible:
        return None
    core, names = fitting.rig.core, fitting.auxiliaries
    if len(consistency.find_auxiliaries("sound")) >= _WELL_CONFIRMED:
        suspects = [(name,) for name in consistency.find_auxiliaries("unmatched")]
    else:
        suspects = [(core, *names), (core,), *((name,) for name in consistency.inconsistent)]
    before = fitting.unchanged if suspects else {}
    best: Mirroring | None = None
    most = _FLIP_GAIN * sum(before.values()) + 1
    for cameras in suspects:
        affected = fitting.list_affected(cameras)
        for flip in _STEPS:
            images = fitting.frame_set.images
            flipped = {name: _flip_image(images[name], flip) for name in cameras}
            points = fitting.count_with(flipped, before)
            if points is None:
                continue
            total = sum(points.values())
            if total >= most and all(points[n] > _SHARE * max(points.values()) for n in affected):
                best, most = Mirroring(cameras, flip), total
    return best


def _flip_image(image: Image, flip: Flip) -> Image:
    rows, columns = _STEPS[flip]
    return np.ascontiguousarray(image[::rows, ::columns])


_EXCHANGE_GAIN = 1.3
"""Least ratio of the points that fit after the exchange to those that fit before."""


def find_exchange(fitting: FittingPoints, consistency: RigConsistency) -> tuple[str, str] | None:
    """Return the two exchanged cameras; None if none is inconsistent or a knock of one camera explains the frame."""
    inconsistent, pose_change = consistency.inconsistent, consistency.pose_change
    has_sound = bool(consistency.find_auxiliaries("sound"))
    if len(consistency.cameras) < 2 or not inconsistent:
        return None
    if pose_change is None and len(inconsistent) < 2 and has_sound:
        return None
    if pose_change is not None and pose_change.is_plausible:
        return None
    suspects = inconsistent if len(inconsistent) > 1 and has_sound else fitting.auxiliaries
    return find_exchange_among(fitting, suspects)


def find_exchange_among(fitting: FittingPoints, suspects: tuple[str, ...]) -> tuple[str, str] | None:
    """Return the two of the suspected cameras whose exchange makes the images fit the rig best, or None.

    The core is suspected as well if all auxiliaries are.
    """
    rig, images = fitting.rig, fitting.frame_set.images
    best: tuple[str, str] | None = None
    most = _EXCHANGE_GAIN * sum(fitting.unchanged.values()) + 1
    cameras = (rig.core, *suspects) if len(suspects) == len(fitting.auxiliaries) else suspects
    for one, other in combinations(cameras, 2):
        exchanged = {one: images[other], other: images[one]}
        if any(image.shape[1::-1] != tuple(rig.cameras[name].size_px) for name, image in exchanged.items()):
            continue
        points = fitting.count_with(exchanged, dict.fromkeys(fitting.auxiliaries, 0))
        total = 0 if points is None else sum(points.values())
        if total >= most:
            best, most = (one, other), total
    return best
