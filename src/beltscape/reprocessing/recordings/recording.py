"""A recording that was found: its place, its frames with their times, a digest of its files; and its frame sets.

The place is a folder, a part of an archive, or a bucket. A worker reads the frame sets ahead of the measuring and in
bounded memory.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from time import perf_counter, thread_time

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.progress import Reporter
from beltscape.files.images import decode_image
from beltscape.reprocessing.recordings.archives import read_member, split_member
from beltscape.reprocessing.recordings.storage import (
    UnreachableError,
    join_address,
    named_faults,
    open_storage,
    read_bytes,
)
from beltscape.sources.folder import describe_lost_image, require_size

_ARCHIVE = re.compile(r"(zip|tar)://(.*?)::(.+)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Place:
    """A folder, an archive or a bucket that is read through fsspec; cheap to send to another process.

    Its file system, and what an archive needs, are kept per process.
    """

    url: str
    """Absolute path, address, or fsspec's chained address of a folder in an archive: ``zip://folder::/data/day.zip``."""

    @property
    def archive(self) -> tuple[str, str, str] | None:
        """Kind of archive (``zip`` or ``tar``), folder in it, address of the archive; None for a folder or bucket."""
        match = _ARCHIVE.fullmatch(self.url)
        return None if match is None else (match[1], match[2], match[3])

    @property
    def address(self) -> str:
        """The place for messages: an archive is shown as a folder."""
        archive = self.archive
        return self.url if archive is None else join_address(archive[2], archive[1])

    def describe(self, path: str) -> str:
        """Return the address of a file for messages."""
        return join_address(self.address, path if self.archive is None else split_member(path)[0])

    def describe_folder(self, path: str) -> str:
        """Return the address of a folder or listed file for messages, by its path without a range."""
        return join_address(self.address, path)

    def read(self, path: str) -> bytes:
        """Return the bytes of a file; may be called from several threads at once.

        Raises
        ------
        InputError
            When this file is missing, damaged, locked or too large.
        UnreachableError
            When the place as a whole does not answer or is not there on this machine.
        """
        archive = self.archive
        try:
            if archive is not None:
                return read_member(archive[0], archive[2], path, self.describe(path))
            return read_bytes(join_address(self.url, path))
        except InputError as error:
            if isinstance(error.__cause__, OSError):
                self._require_presence()
            raise

    def _require_presence(self) -> None:
        """Raise UnreachableError where the whole place is missing: then its images are not lost, but elsewhere."""
        archive = self.archive
        url = self.url if archive is None else archive[2]
        with named_faults(url):
            file_system, path = open_storage(url)
            if not file_system.exists(path):
                raise UnreachableError(
                    f"{url}: is not there on this machine; let every worker see it under the same path"
                )


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One trigger instant of a recording."""

    frame: str
    """Name of the instant: the image files' stem."""
    time_ns: int
    position_mm: float | None
    """The encoder's position; None without one."""
    files: Mapping[str, str]
    """Camera → path in the recording's place; empty for an instant without images."""
    exposures_us: Mapping[str, float]
    """Camera → exposure time, µs; NaN while it changes; empty where the recording does not state it."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A capture that can be measured; its images are not read yet. It can be pickled."""

    name: str
    """Path below the source with "/"; an archive counts as a folder."""
    place: Place
    frames: tuple[RecordedFrame, ...]
    """In the order of time."""
    start_wall_ns: int | None
    """Wall clock of the recorder when it began, ns since 1970 UTC, by the folder's name; None where it has none."""
    digest: str
    """SHA-256 of names, sizes and change marks of its files; it differs after any of them was changed."""


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A recording that was found and could not be read."""

    name: str
    """Path below the source with "/"."""
    reason: str
    """One line with the fix."""


_READ_AHEAD = 3
"""Frame sets that are read ahead: at 5 cameras of 3 MP in colour 135 MB; more wait no shorter for a disk or store."""
_THREADS = 4
"""Files that are read at once; decoding takes one core at most where measuring needs the others."""


@dataclass(frozen=True, slots=True)
class _ReadImage:
    """Result of reading one file."""

    image: Image | None
    problem: str
    """Warning; empty where the image can be used."""
    read_bytes: int
    read_s: float
    decode_s: float


class FrameReader:
    """Yields the frame sets of a recording's frames as a replay of its folder gives them."""

    def __init__(self, place: Place, sizes_px: Mapping[str, tuple[int, int]], reporter: Reporter) -> None:
        """``sizes_px``: (width, height) that each camera's images must have; other cameras are not read."""
        self._place, self._sizes_px, self._reporter = place, sizes_px, reporter
        self.read_bytes = 0
        """Bytes of files read so far."""
        self.read_s = 0.0
        """Seconds spent on reading, summed over threads that read at the same time."""
        self.decode_s = 0.0
        """Seconds of processor time spent on decoding."""

    def read(self, frames: Sequence[RecordedFrame]) -> Iterator[FrameSet]:
        """Yield the frame sets in order; an image that cannot be used is named and left out.

        Raises
        ------
        UnreachableError
            When the place does not answer or is not there on this machine: its images are not lost.
        """
        waiting: deque[tuple[RecordedFrame, dict[str, Future[_ReadImage]]]] = deque()
        pool = ThreadPoolExecutor(_THREADS, "reader")
        try:
            coming = iter(frames)
            for frame in islice(coming, _READ_AHEAD):
                waiting.append((frame, self._request(pool, frame)))
            while waiting:
                frame, images = waiting.popleft()
                frame_set = self._collect(frame, images)
                for following in islice(coming, 1):
                    waiting.append((following, self._request(pool, following)))
                yield frame_set
        finally:
            pool.shutdown(cancel_futures=True)

    def _request(self, pool: ThreadPoolExecutor, frame: RecordedFrame) -> dict[str, Future[_ReadImage]]:
        return {
            camera: pool.submit(self._read_image, camera, frame.files[camera])
            for camera in self._sizes_px
            if camera in frame.files
        }

    def _collect(self, frame: RecordedFrame, requested: Mapping[str, Future[_ReadImage]]) -> FrameSet:
        images: dict[str, Image] = {}
        for camera, future in requested.items():
            result = future.result()
            self.read_bytes += result.read_bytes
            self.read_s += result.read_s
            self.decode_s += result.decode_s
            if result.image is not None:
                images[camera] = result.image
            else:
                self._reporter.warn(result.problem)
        return FrameSet(frame.frame, images, frame.time_ns, frame.position_mm, frame.exposures_us)

    def _read_image(self, camera: str, path: str) -> _ReadImage:
        name, start = self._place.describe(path), perf_counter()
        data, image, problem = b"", None, ""
        try:
            data = self._place.read(path)
        except UnreachableError:
            raise
        except InputError as error:
            problem = describe_lost_image(error)
        read_s, decode_start = perf_counter() - start, thread_time()
        if not problem:
            try:
                image = decode_image(data, name)
                require_size(image, name, camera, self._sizes_px[camera])
            except InputError as error:
                image, problem = None, describe_lost_image(error)
        return _ReadImage(image, problem, len(data), read_s, thread_time() - decode_start)
