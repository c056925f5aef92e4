"""Measurements of one frame on a GPU: times, energy, frames in flight, and other matchers beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.rig_json import read_rig
from beltscape.kernels import Kernels, load
from beltscape.kernels.cuda.backend import CudaBackend, ResidentBackend
from beltscape.kernels.cuda.device import GpuDevice, Size
from beltscape.kernels.native import NativeBackend, levels
from beltscape.sources.folder import FolderSource
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from gpu_traffic import CountingBackend

FAR_MM = 0.001
"""Depths that differ by more are counted."""
RUNS = 5
IN_FLIGHT = (1, 2, 4)
"""Frames that are matched at the same time."""
DISPARITIES = 128
"""Of the other matchers."""


@dataclass(frozen=True)
class Problem:
    """A frame to match."""

    rig: Rig
    frame_set: FrameSet
    near_far_mm: tuple[float, float]
    settings: MultiviewSettings

    def make_matcher(self, kernels: Kernels) -> MultiviewReconstructor:
        """Return a matcher with these kernels."""
        return MultiviewReconstructor(self.rig, self.near_far_mm, self.settings, kernels=kernels)

    def __str__(self) -> str:
        width, height = self.rig.core_camera.size_px
        return f"{len(self.rig.cameras)} cameras of {width} × {height} px"


def read_problem(capture: Path, rig_file: Path, preset: str, scale: float = 1.0) -> Problem:
    """Return the capture's first frame, its images enlarged ``scale`` times."""
    rig = read_rig(rig_file)
    source = FolderSource(read_capture(capture), {n: c.size_px for n, c in rig.cameras.items()}, Silent())
    frame_set = next(iter(source))
    if scale != 1:
        rig = scale_rig(rig, scale)
        images = {
            name: cv2.resize(image, rig.cameras[name].size_px, interpolation=cv2.INTER_CUBIC)
            for name, image in frame_set.images.items()
        }
        frame_set = FrameSet(frame_set.frame, images)
    near_far_mm = find_depth_range(rig, frame_set, Silent(), 1)
    return Problem(rig, frame_set, near_far_mm, MultiviewSettings.preset(preset))


@dataclass(frozen=True)
class FrameTraffic:
    """Bytes that a frame copies between processor and GPU, both ways."""

    each_call: int
    """Where every call of a kernel copies its arrays."""
    up: int
    down: int
    """Where arrays stay on the GPU."""


def count_traffic(problem: Problem) -> FrameTraffic:
    """Return what a frame copies; needs no GPU."""
    backend = CountingBackend(NativeBackend(levels()[-1]))
    problem.make_matcher(Kernels(backend)).reconstruct(problem.frame_set, Silent())
    traffic = backend.traffic
    return FrameTraffic(backend.each_call_bytes, traffic.uploaded_bytes, traffic.downloaded_bytes)


@dataclass
class Measured:
    """What one device needed for a frame, and how its depth map differs."""

    name: str
    frame: str
    frame_s: float
    call_s: dict[str, float]
    """Kernel → time of its calls, until their launches have ended."""
    launch_s: dict[str, float]
    """Kernel of native/cuda → time of its launches."""
    far_share: float
    """Of the pixels that both measure: further than 0.001 mm from the processor's."""
    only_one_share: float
    """Of all pixels: those that only one of both measures."""
    is_repeatable: bool
    """Whether all runs gave the same bytes."""
    peak_bytes: int
    """Most memory in use."""
    sets_per_s: dict[int, float] = field(default_factory=dict[int, float])
    """Frames in flight → frames a second."""
    joules: float | None = None
    """Of the GPU for a frame; None where the driver does not say."""
    peers_s: dict[str, float] = field(default_factory=dict[str, float])
    """Other matchers → seconds for four pairs of this size."""


class TimedDevice:
    """A device that measures each launch until it has ended."""

    def __init__(self, device: Any) -> None:
        self.seconds: dict[str, float] = {}
        self._device = device

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def launch(
        self, stream: Any, kernel: str, grid: Size, block: Size, arguments: Sequence[Any], shared_bytes: int
    ) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        synchronise = getattr(self._device, "synchronise", lambda _: None)
        synchronise(stream)
        start = time.perf_counter()
        self._device.launch(stream, kernel, grid, block, arguments, shared_bytes)
        synchronise(stream)
        self.seconds[kernel] = self.seconds.get(kernel, 0) + time.perf_counter() - start


class TimedBackend:
    """Kernels whose results stay on the device, with the time of each call."""

    pixels_at_once = ResidentBackend.pixels_at_once

    def __init__(self, backend: ResidentBackend) -> None:
        self.name = backend.name
        self.seconds: dict[str, float] = {}
        self.keep = backend.keep
        self._backend = backend

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`."""
        start = time.perf_counter()
        results = self._backend.run(kernel, given, out, threads)
        self.seconds[kernel] = self.seconds.get(kernel, 0) + time.perf_counter() - start
        return results


def measure_device(device: GpuDevice, problem: Problem, runs: int = RUNS) -> Measured:
    """Return the times of a frame on a device, the least of some runs, and its difference from the processor's."""
    native = NativeBackend(levels()[-1])
    kernels, frame_set = Kernels(CudaBackend(device, native)), problem.frame_set
    matcher = problem.make_matcher(kernels)
    depth = matcher.reconstruct(frame_set, Silent())
    depths, seconds = [depth], list[float]()
    before = read_joules()
    for _ in range(runs):
        start = time.perf_counter()
        depths.append(matcher.reconstruct(frame_set, Silent()))
        seconds.append(time.perf_counter() - start)
    after = read_joules()
    timed = TimedDevice(device)
    calls = TimedBackend(CudaBackend(cast("GpuDevice", timed), native).resident)
    problem.make_matcher(Kernels(calls)).reconstruct(frame_set, Silent())
    expected = problem.make_matcher(load("native")).reconstruct(frame_set, Silent())
    both = depth.measured & expected.measured
    far = np.abs(depth.depth_mm - expected.depth_mm)[both] > FAR_MM
    measured = Measured(
        device.name,
        str(problem),
        min(seconds),
        calls.seconds,
        timed.seconds,
        float(far.mean()) if far.size else 0.0,
        float((depth.measured != expected.measured).mean()),
        len({each.depth_mm.tobytes() for each in depths}) == 1,
        device.memory.peak,
        {count: measure_rate(matcher, frame_set, count, runs) for count in IN_FLIGHT} if runs > 1 else {},
        None if before is None or after is None else (after - before) / runs,
        measure_peers(problem) if runs > 1 else {},
    )
    if kernels.failure:  # the processor's times are none of the GPU
        raise SystemExit(f"the GPU failed: {kernels.failure}")
    return measured


def measure_rate(matcher: MultiviewReconstructor, frame_set: FrameSet, in_flight: int, runs: int) -> float:
    """Return the frames a second with some frames in flight at the same time."""
    count = runs * in_flight
    with ThreadPoolExecutor(in_flight) as pool:
        start = time.perf_counter()
        list(pool.map(lambda _: matcher.reconstruct(frame_set, Silent()), range(count)))
        return count / (time.perf_counter() - start)


def read_joules() -> float | None:
    """Return the energy that the first GPU has taken since the driver was loaded; None where NVML does not say."""
    try:
        nvml: Any = import_module("cuda.bindings.nvml")
        nvml.init_v2()
        return nvml.device_get_total_energy_consumption(nvml.device_get_handle_by_index_v2(0)) / 1e3
    except Exception:  # no library, no driver, or a GPU that does not count: the page then has no figure
        return None


def measure_peers(problem: Problem) -> dict[str, float]:
    """Return the seconds of other matchers for four pairs of the frame's size, the least of three."""
    names = list(problem.rig.cameras)[:2]
    left, right = (to_grey(problem.frame_set.images[name]) for name in names)
    sgbm = cv2.StereoSGBM.create(0, DISPARITIES, 5, 8 * 25, 32 * 25, mode=cv2.StereoSGBM_MODE_HH)
    peers: dict[str, Callable[[], object]] = {
        "OpenCV SGBM on the processor": lambda: [sgbm.compute(left, right) for _ in range(4)]
    }
    opencv: Any = cv2
    if hasattr(opencv.cuda, "createStereoSGM") and opencv.cuda.getCudaEnabledDeviceCount():
        sgm = opencv.cuda.createStereoSGM(0, DISPARITIES)
        pair = opencv.cuda_GpuMat(left), opencv.cuda_GpuMat(right)
        peers["OpenCV CUDA SGM (libSGM's kernels)"] = lambda: [
            sgm.compute(*pair).download() for _ in range(4)
        ]
    return {name: min(_time(peer) for _ in range(3)) for name, peer in peers.items()}


def to_grey(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an image as one channel of 8 bits."""
    grey = image if image.ndim == 2 else image[..., :3].mean(axis=2)
    return np.asarray(grey / (np.iinfo(image.dtype).max / 255), np.uint8)


def _time(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
