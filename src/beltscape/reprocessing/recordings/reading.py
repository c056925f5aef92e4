"""Reading of a recording's frame sets on a worker, ahead of the measuring and in bounded memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from time import perf_counter, thread_time

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.progress import Reporter
from beltscape.files.rasters.images import decode_image
from beltscape.reprocessing.recordings.place import Place
from beltscape.reprocessing.recordings.recording import RecordedFrame
from beltscape.reprocessing.recordings.storage import UnreachableError
from beltscape.sources.folder import describe_lost_image, require_size

_AHEAD = 3
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
            for frame in islice(coming, _AHEAD):
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
