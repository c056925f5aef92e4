"""Matching of a sequence's frames on workers, which read the images themselves where they can see the files."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from uuid import uuid4

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.progress import Reporter, Silent
from beltscape.files.rasters.images import read_image
from beltscape.pipeline.reconstructing.match_pool import FrameMatcher
from beltscape.pipeline.reconstructing.matcher_factory import MatcherFactory
from beltscape.workers.options import WorkerOptions
from beltscape.workers.tasks import PendingTask, TaskPool, open_pool

_AHEAD = 2
"""Frames handed out for each worker: one is matched, one waits, so that no worker waits for this process."""
_MOST_BYTES = 4 << 30
"""Memory of the frames that are handed out; a frame of five 1.3 MP cameras takes 25 MB with its depth map."""
_DEPTH_BYTES = 13
"""Bytes of a pixel of a depth map: depth, σ and confidence in float32, the number of views in one byte."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchParameters:
    """Parameters that all frames of a reconstruction share."""

    token: str
    """Identity of the reconstruction: a worker keeps the matchers of one."""
    make_matcher: MatcherFactory


@dataclass(frozen=True, slots=True, eq=False)
class MatchTask:
    """A frame to match."""

    auxiliaries: tuple[str, ...]
    """The matcher's auxiliaries."""
    frame_set: FrameSet
    """The frame; without images where the worker is to read them."""
    files: Mapping[str, tuple[Path, int]]
    """Camera → file and the checksum of its decoded image."""


_matchers: dict[tuple[str, tuple[str, ...]], FrameMatcher] = {}
"""The matchers of this worker by reconstruction and auxiliaries."""


def match_frame(parameters: MatchParameters, task: MatchTask) -> DepthMap | None:
    """Return the depth of a frame; None if this worker does not see the driver's images in the files."""
    frame_set = task.frame_set
    if task.files:
        images = _read_images(task.files)
        if images is None:
            return None
        frame_set = replace(frame_set, images=images)
    return _get_matcher(parameters, task.auxiliaries).reconstruct(frame_set, Silent())


def _read_images(files: Mapping[str, tuple[Path, int]]) -> dict[str, Image] | None:
    images: dict[str, Image] = {}
    for name, (path, checksum) in files.items():
        try:
            images[name] = read_image(path)
        except InputError:
            return None
        if compute_checksum(images[name]) != checksum:
            return None
    return images


def _get_matcher(parameters: MatchParameters, auxiliaries: tuple[str, ...]) -> FrameMatcher:
    key = parameters.token, auxiliaries
    if key not in _matchers:
        for other in [other for other in _matchers if other[0] != parameters.token]:
            del _matchers[other]
        _matchers[key] = parameters.make_matcher(auxiliaries)
    return _matchers[key]


def compute_checksum(image: Image) -> int:
    """Return the CRC-32 of an image's pixels and shape."""
    return zlib.crc32(
        np.ascontiguousarray(image).data, zlib.crc32(repr((image.shape, image.dtype.str)).encode())
    )


@dataclass(frozen=True, slots=True, eq=False)
class _PendingFrame:
    """A frame that a worker matches."""

    workers: MatchWorkers
    task: MatchTask
    images: Mapping[str, Image]
    pending: PendingTask[DepthMap | None]

    def result(self) -> DepthMap | None:
        """Return the depth; None if no worker could match the frame, of which this process then finds the reason."""
        end = self.pending.result()
        if end.value is None and not end.failure:
            end = self.workers.send_images(self.task, self.images).result()
        if end.failure and not end.worker:
            self.workers.report_death(self.task.frame_set.frame, end.failure)
        return end.value


class MatchWorkers:
    """Matches frames on workers; the images are sent from the first frame on whose files a worker did not see."""

    def __init__(
        self,
        pool: TaskPool[MatchTask, DepthMap | None],
        files: Callable[[str], Mapping[str, Path]],
        reporter: Reporter,
    ) -> None:
        """``files`` returns the files of a frame's images by camera."""
        self._pool, self._files, self._reporter = pool, files, reporter
        self._sends_images = False

    def count_frames_ahead(self, size_px: tuple[int, int], cameras: int) -> int:
        """Return how many frames to hand out at a time: enough for every worker, within `_MOST_BYTES`."""
        frame_bytes = size_px[0] * size_px[1] * (cameras + _DEPTH_BYTES)
        return max(2, min(_AHEAD * self._pool.workers, _MOST_BYTES // frame_bytes))

    def submit(
        self, frame_set: FrameSet, auxiliaries: tuple[str, ...], make_matcher: Callable[[], FrameMatcher]
    ) -> _PendingFrame:
        """Begin to match a frame; see `MatchPool`."""
        del make_matcher
        files = {} if self._sends_images else self._describe_files(frame_set)
        task = MatchTask(auxiliaries, replace(frame_set, images={}), files)
        images = frame_set.images
        pending = self._pool.submit(task, frame_set.frame) if files else self.send_images(task, images)
        return _PendingFrame(self, task, images, pending)

    def _describe_files(self, frame_set: FrameSet) -> dict[str, tuple[Path, int]]:
        """Return the files of all images with their checksums; empty where an image has no file."""
        files = self._files(frame_set.frame)
        if not frame_set.images.keys() <= files.keys():
            return {}
        return {
            name: (files[name].absolute(), compute_checksum(image))
            for name, image in frame_set.images.items()
        }

    def send_images(self, task: MatchTask, images: Mapping[str, Image]) -> PendingTask[DepthMap | None]:
        """Hand out a frame with its images, as all frames after it."""
        self._sends_images = True
        frame_set = replace(task.frame_set, images=images)
        return self._pool.submit(MatchTask(task.auxiliaries, frame_set, {}), frame_set.frame)

    def report_death(self, frame: str, failure: str) -> None:
        """Warn of a frame that no worker survived."""
        self._reporter.warn(f"frame {frame}: {failure}; it is matched by this process")


@contextmanager
def open_workers(
    make_matcher: MatcherFactory,
    options: WorkerOptions,
    files: Callable[[str], Mapping[str, Path]],
    reporter: Reporter,
) -> Generator[MatchWorkers]:
    """Yield workers that match frames; what they match at the end is cancelled. Errors as `open_pool`."""
    with open_pool(match_frame, MatchParameters(uuid4().hex, make_matcher), options) as pool:
        yield MatchWorkers(pool, files, reporter)
