"""Matching of a sequence's frames side by side: while one frame is measured, the next ones are matched already.

They are matched on threads, or on workers: on processes of this machine, which share memory with this one, or on a
cluster, whose workers read the images themselves where they can see the files.
"""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal
from uuid import uuid4

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter, Silent
from beltscape.core.system_calls import count_usable_cores
from beltscape.files.images import read_image
from beltscape.kernels import gpu_failures, is_gpu_expected
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher
from beltscape.pipeline.reconstructing.frame_measurements import (
    FrameMeasurer,
    MeasuredDepth,
    MeasurementRequest,
)
from beltscape.pipeline.reconstructing.monitored_matcher import MonitoredMatcher, PendingFrame
from beltscape.pipeline.reconstructing.pending_match import FrameMatcher, MatchPool, PendingMatch
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.pairwise.reconstructor import PairwiseReconstructor
from beltscape.stereo.settings import MultiviewSettings, PairwiseSettings
from beltscape.workers.calls import CallMaker, CallsOfPool, make_call
from beltscape.workers.options import WorkerOptions
from beltscape.workers.processes import ProcessPool
from beltscape.workers.tasks import PendingTask, TaskPool, open_pool
from beltscape.workers.transport import SharedObject

_MOST_FRAMES = 2
"""Frames that are matched side by side. The steps between the kernels run on one thread, so one frame keeps two cores
busy for about three quarters of its time; two frames on a thread each, for all of it."""
_MOST_PIXELS = 3_000_000
"""Pixels of a frame above which it is matched alone: the preset ``standard`` takes 550 bytes for each, so that two
frames of this size take 3.3 GB."""


def choose_threads(frames: int, size_px: tuple[int, int]) -> tuple[int, int]:
    """Return how many frames of a sequence to match side by side, and the number of threads for each of them."""
    cores = count_usable_cores()
    is_large = size_px[0] * size_px[1] > _MOST_PIXELS
    at_a_time = 1 if is_large else max(1, min(_MOST_FRAMES, cores, frames))
    return at_a_time, max(1, cores // at_a_time)


class MatchThreads:
    """Matches frames on threads of this process."""

    def __init__(self, pool: ThreadPoolExecutor) -> None:
        self._pool = pool

    def submit(
        self,
        frame_set: FrameSet,
        auxiliaries: tuple[str, ...],
        make_matcher: Callable[[], FrameMatcher],
        request: MeasurementRequest | None = None,
    ) -> Future[MeasuredDepth]:
        """Begin to match a frame; see `MatchPool`. Nothing else is measured."""
        del auxiliaries, request
        matcher = make_matcher()
        return self._pool.submit(lambda: MeasuredDepth(matcher.reconstruct(frame_set, Silent())))


@contextmanager
def open_threads(at_a_time: int) -> Generator[MatchThreads]:
    """Yield threads that match frames; what is not begun at the end is left out."""
    pool = ThreadPoolExecutor(at_a_time)
    try:
        yield MatchThreads(pool)
    finally:
        pool.shutdown(cancel_futures=True)


def match_ahead(
    frames: Iterable[FrameSet], matcher: CheckedMatcher, pool: MatchPool, at_a_time: int
) -> Generator[tuple[FrameSet, PendingMatch | None]]:
    """Yield the frames in order, each with its match, which was begun while the frames before it were measured.

    At most ``at_a_time`` frames are handed out at a time, and one more is read; a single one is left to the caller.
    """
    if at_a_time < 2:
        yield from ((frame_set, None) for frame_set in frames)
        return
    waiting: deque[tuple[FrameSet, PendingMatch | None]] = deque()
    for frame_set in frames:
        waiting.append((frame_set, matcher.submit(frame_set, pool)))
        if len(waiting) > at_a_time:
            yield waiting.popleft()
    while waiting:
        yield waiting.popleft()


@dataclass(frozen=True, slots=True, eq=False)
class MatcherFactory:
    """Makes matchers of one rig with the same settings, whose type is the method's."""

    rig: Rig
    depth_range_mm: tuple[float, float]
    settings: MultiviewSettings | PairwiseSettings

    def __call__(self, auxiliaries: tuple[str, ...]) -> FrameMatcher:
        """Return the matcher of a set of auxiliaries."""
        if isinstance(self.settings, PairwiseSettings):
            return PairwiseReconstructor(
                self.rig, self.depth_range_mm, self.settings, auxiliaries=auxiliaries
            )
        return MultiviewReconstructor(self.rig, self.depth_range_mm, self.settings, auxiliaries=auxiliaries)


_AHEAD_OF_WORKER = 2
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

    parameters: SharedObject[MatchParameters]
    """Those of its reconstruction."""
    auxiliaries: tuple[str, ...]
    """The matcher's auxiliaries."""
    frame_set: FrameSet
    """The frame; without images where the worker is to read them."""
    files: Mapping[str, tuple[Path, int]]
    """Camera → file and the checksum of its decoded image."""
    request: MeasurementRequest | None = None
    """What to measure beside the depth; None: nothing."""


_matchers: dict[tuple[str, tuple[str, ...]], FrameMatcher] = {}
"""The matchers of this worker by reconstruction and auxiliaries."""
_measurers: dict[str, FrameMeasurer] = {}
"""What this worker measures with, by reconstruction: one at most."""


def match_frame(shared: None, task: MatchTask) -> MeasuredDepth | None:
    """Return the depth of a frame; None if this worker does not see the driver's images in the files."""
    del shared
    frame_set = task.frame_set
    if task.files:
        images = _read_images(task.files)
        if images is None:
            return None
        frame_set = replace(frame_set, images=images)
    parameters = task.parameters.value
    depth = _get_matcher(parameters, task.auxiliaries).reconstruct(frame_set, Silent())
    measured = None
    if task.request is not None:
        measured = _get_measurer(parameters).measure(frame_set, depth, task.request)
    return MeasuredDepth(depth, measured, gpu_failures.text)


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


def _get_measurer(parameters: MatchParameters) -> FrameMeasurer:
    if parameters.token not in _measurers:
        _measurers.clear()
        _measurers[parameters.token] = FrameMeasurer(parameters.make_matcher.rig)
    return _measurers[parameters.token]


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
    pending: PendingTask[MeasuredDepth | None]

    def done(self) -> bool:
        """Return whether the match has ended."""
        return self.pending.done()

    def result(self) -> MeasuredDepth | None:
        """Return the depth; None if no worker could match the frame, of which this process then finds the reason."""
        end = self.pending.result()
        if end.value is None and not end.failure:
            end = self.workers.send_images(self.task, self.images).result()
        if end.failure and not end.worker:
            self.workers.report_death(self.task.frame_set.frame, end.failure)
        if end.value is not None:
            gpu_failures.note(end.value.gpu_failure)
        return end.value


class MatchWorkers:
    """Matches frames on workers; the images are sent from the first frame on whose files a worker did not see."""

    def __init__(
        self,
        pool: TaskPool[MatchTask, MeasuredDepth | None],
        make_matcher: MatcherFactory,
        files: Callable[[str], Mapping[str, Path]],
        reporter: Reporter,
        *,
        sends_images: bool,
    ) -> None:
        """``files`` returns the files of a frame's images by camera, which workers read unless they are sent."""
        self._pool, self._files, self._reporter = pool, files, reporter
        self._parameters = SharedObject(MatchParameters(uuid4().hex, make_matcher))
        self._sends_images = sends_images

    def count_frames_ahead(self, size_px: tuple[int, int], cameras: int) -> int:
        """Return how many frames to hand out at a time: enough for every worker, within `_MOST_BYTES`."""
        frame_bytes = size_px[0] * size_px[1] * (cameras + _DEPTH_BYTES)
        return max(2, min(_AHEAD_OF_WORKER * self._pool.workers, _MOST_BYTES // frame_bytes))

    def submit(
        self,
        frame_set: FrameSet,
        auxiliaries: tuple[str, ...],
        make_matcher: Callable[[], FrameMatcher],
        request: MeasurementRequest | None = None,
    ) -> _PendingFrame:
        """Begin to match a frame; see `MatchPool`."""
        del make_matcher
        files = {} if self._sends_images else self._describe_files(frame_set)
        task = MatchTask(self._parameters, auxiliaries, replace(frame_set, images={}), files, request)
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

    def send_images(self, task: MatchTask, images: Mapping[str, Image]) -> PendingTask[MeasuredDepth | None]:
        """Hand out a frame with its images, as all frames after it."""
        self._sends_images = True
        frame_set = replace(task.frame_set, images=images)
        return self._pool.submit(replace(task, frame_set=frame_set, files={}), frame_set.frame)

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
    with open_pool(match_frame, None, options) as pool:
        # workers of this machine share its memory
        yield MatchWorkers(pool, make_matcher, files, reporter, sends_images=options.address is None)


_MOST_ON_GPU = 4
"""Workers that match on one GPU. Each opens it, with a context and graphs of its own, some GB for five images of
2448 × 2048 px. A worker's own part of a frame takes about as long as the GPU's (benchmarks/GPU.md): two hide it, two
more the transfers and the rest of the measurement."""
_WORKERS_OF_HELPER = 6
"""Workers for each helper: calls take 0.04 CPU s of a set of 612×512, matching at least 0.24, both four times as much
with twice the width."""
Submit = Callable[[FrameSet, MeasurementRequest], PendingFrame]
"""Checks the images of a frame set, begins to match it and to measure in it what is requested."""


def count_workers(setting: int | Literal["auto"]) -> int:
    """Return the number of worker processes for the setting.

    ``auto`` is one for each core, at most `_MOST_ON_GPU` where they match on a GPU, and none where there is one core.
    """
    if setting != "auto":
        return setting
    cores = count_usable_cores()
    workers = min(cores, _MOST_ON_GPU) if is_gpu_expected() else cores
    return workers if cores > 1 else 0


@dataclass(frozen=True, slots=True, eq=False)
class LiveWorkers:
    """The processes, which live as long as the run; contexts of measurement that follow each other share them."""

    pool: ProcessPool
    """Those that match."""
    helpers: ProcessPool
    """Those that make calls meanwhile: filling does not wait for the end of a match, nor a record for it."""

    @property
    def ahead(self) -> int:
        """Return the number of frame sets to submit at most: one for each process, and one that waits."""
        return self.pool.workers + 1

    @property
    def calls(self) -> CallMaker:
        """Return what has the helpers make calls beside the matches."""
        return CallsOfPool(self.helpers)

    def count_matched_per_s(self) -> float:
        """Return how many frame sets the processes match in a second; inf before the first one."""
        return self.pool.count_tasks_per_s()

    def make_submit(self, matcher: MonitoredMatcher, factory: MatcherFactory, reporter: Reporter) -> Submit:
        """Return what begins to match a frame set for a matcher, which completes it; ``factory`` makes its like."""
        workers = MatchWorkers(self.pool, factory, lambda _: {}, reporter, sends_images=True)
        return lambda frame_set, request: matcher.submit(frame_set, workers, request)

    def close(self) -> None:
        """End the processes."""
        self.pool.close()
        self.helpers.close()


def open_live_workers(setting: int | Literal["auto"]) -> LiveWorkers | None:
    """Return the workers for the setting; None where frame sets are matched in this process."""
    count = count_workers(setting)
    if not count:
        return None
    helpers = ProcessPool(make_call, None, -(-count // _WORKERS_OF_HELPER))
    return LiveWorkers(ProcessPool(match_frame, None, count), helpers)
