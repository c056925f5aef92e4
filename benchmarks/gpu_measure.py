"""Measurements of one frame on a GPU: times, energy, frames in flight, and other matchers beside it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.core.progress import Silent
from beltscape.evaluate.truth import read_truth
from beltscape.files.capture import read_capture
from beltscape.files.rig_json import read_rig
from beltscape.kernels import Kernels, load
from beltscape.kernels.cuda.backend import CudaBackend, ResidentBackend
from beltscape.kernels.cuda.device import GpuDevice, Size
from beltscape.kernels.native import NativeBackend, levels
from beltscape.sources.folder import FolderSource
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.surface import compute_inverse_depth_scale
from beltscape.stereo.settings import MultiviewSettings
from gpu_peers import MatcherRow, compute_error, explain_missing, measure_others, rectify_pairs
from gpu_traffic import CountingBackend
from roofline import Work

FAR_MM = 0.001
"""Depths that differ by more are counted."""
RUNS = 5
IN_FLIGHT = (1, 2, 4)
"""Frames that are matched at the same time."""


@dataclass(frozen=True)
class Problem:
    """A frame to match."""

    rig: Rig
    frame_set: FrameSet
    near_far_mm: tuple[float, float]
    settings: MultiviewSettings
    true_mm: NDArray[np.floating] | None = None
    """(H, W) true depth, NaN where there is none; None where the capture has none of this size."""

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
    true_mm = read_true_depth(capture, rig, frame_set.frame) if scale == 1 else None
    return Problem(rig, frame_set, near_far_mm, MultiviewSettings.preset(preset), true_mm)


def read_true_depth(capture: Path, rig: Rig, frame: str) -> NDArray[np.floating] | None:
    """Return the true depth (H, W) of a simulated frame on the rig's grid; None for a capture without a truth."""
    if not (capture / "truth").is_dir():
        return None
    truth = read_truth(capture / "truth").for_frame(frame)
    return truth.resample_to(rig).depth_mm if truth.is_placed else truth.depth_mm


@dataclass(frozen=True)
class FrameTraffic:
    """Work of a frame's kernels, and the bytes that it copies between processor and GPU, both ways."""

    work: dict[str, Work]

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
    return FrameTraffic(
        backend.work, backend.each_call_bytes, traffic.uploaded_bytes, traffic.downloaded_bytes
    )


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
    rows: list[MatcherRow] = field(default_factory=list[MatcherRow])
    """This matcher and others on the same set."""
    work: dict[str, Work] = field(default_factory=dict[str, Work])
    """Kernel → its bytes and operations."""
    missing: str = ""
    """Why OpenCV's CUDA SGM is not among the rows; empty where it is, or nothing else was measured."""
    graphs: float = 0.0
    """Graphs that a frame runs."""


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
    backend, frame_set = CudaBackend(device, native), problem.frame_set
    kernels, graphs = Kernels(backend), backend.graphs
    matcher = problem.make_matcher(kernels)
    depth = matcher.reconstruct(frame_set, Silent())
    depths, seconds = [depth], list[float]()
    before, replayed = read_joules(), graphs.counts.replayed
    for _ in range(runs):
        start = time.perf_counter()
        depths.append(matcher.reconstruct(frame_set, Silent()))
        seconds.append(time.perf_counter() - start)
    after, replayed = read_joules(), graphs.counts.replayed - replayed
    if kernels.failure:  # the processor's times are none of the GPU
        raise SystemExit(f"the GPU failed: {kernels.failure}")
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
        work=count_traffic(problem).work,
        graphs=replayed / runs,
    )
    if runs > 1:
        try:
            measured.rows, measured.missing = measure_rows(problem, depth, measured)
        except Exception as error:  # of another matcher: this one's figures stand all the same
            measured.missing = f"{type(error).__name__}: {error}"
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


def measure_rows(problem: Problem, depth: DepthMap, measured: Measured) -> tuple[list[MatcherRow], str]:
    """Return the rows of this matcher on the device and of others that are there, and why the CUDA SGM is not."""
    size_px, rig = problem.rig.core_camera.size_px, problem.rig
    unit = compute_inverse_depth_scale(rig, rig.auxiliaries)
    near, far = problem.near_far_mm
    range_px = int(np.ceil((1 / near - 1 / far) / unit))
    seconds = min([measured.frame_s, *(1 / rate for rate in measured.sets_per_s.values())])
    error = compute_error(depth.depth_mm, problem.true_mm)
    share = float(depth.measured.mean())
    own = MatcherRow(
        f"Beltscape, {measured.name}", size_px, len(rig.auxiliaries), range_px, seconds, error, share
    )
    pairs = rectify_pairs(rig, problem.frame_set, problem.near_far_mm)
    return [own, *measure_others(pairs, size_px, problem.true_mm)], explain_missing(pairs)
