"""Graphs: what is recorded of one frame gives the bytes of a fresh run for every other."""

from __future__ import annotations

import gc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import local

import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.kernels import Kernels, load
from beltscape.kernels.backend import FrameNumbers
from beltscape.kernels.cuda.backend import CudaBackend
from beltscape.kernels.cuda.emulated_device import EmulatedDevice
from beltscape.kernels.cuda.memory import DeviceError
from beltscape.kernels.cuda.storage import place_in_turn
from beltscape.kernels.planes import blur, dilate
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from tests.kernels.emulated import ON_EMULATION, backend_on
from tests.kernels.rounding import first_alike
from tests.kernels.test_resident import same_bytes
from tests.stereo.scenes import make_ring, patch, plane, quantise, render_images
from tests.thorough import list_rows

pytestmark = ON_EMULATION


class Counting(EmulatedDevice):
    """Counts the launches outside of graphs, and fails when it is told to."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.outside = 0
        self.is_lost = False
        self._running = local()  # other threads launch meanwhile

    def launch(self, stream, kernel, grid, block, arguments, shared_bytes):
        self.outside += not getattr(self._running, "is_graph", False)
        super().launch(stream, kernel, grid, block, arguments, shared_bytes)

    def launch_graph(self, stream, graph):
        if self.is_lost:
            raise DeviceError("CUDA_ERROR_DEVICE_LOST")
        self._running.is_graph = True
        super().launch_graph(stream, graph)
        self._running.is_graph = False


@dataclass(frozen=True, slots=True)
class Levels(FrameNumbers):
    floor: float
    window: int = 3


def smooth(image, levels: Levels, kernels: Kernels):
    """A stretch: three launches, of which one reads a number."""
    mean = blur(image, (levels.window, levels.window))
    return {"mean": mean, "excess": (image - mean) / levels.floor, "given": image}, levels, kernels


def image(seed: int, shape: tuple[int, int] = (40, 50)) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, shape).astype(np.float32)


def replay(backend: CudaBackend, given: np.ndarray, levels: Levels):
    kernels = Kernels(backend.resident)
    return kernels.replay(smooth, kernels.keep(given), levels, kernels)


def assert_smoothed(found, given: np.ndarray, levels: Levels) -> None:
    (planes, same, kernels) = found
    mean = np.asarray(Kernels(backend_on(EmulatedDevice()).resident).average_windows(given, (3, 3)))
    assert np.asarray(planes["mean"]).tobytes() == mean.tobytes()
    assert np.asarray(planes["excess"]).tobytes() == ((given - mean) / np.float32(levels.floor)).tobytes()
    assert np.asarray(planes["given"]).tobytes() == given.tobytes()
    assert same == levels
    assert isinstance(kernels, Kernels)


def test_another_image_and_another_number_go_through_the_recorded_launches():
    device = Counting()
    backend, counts = backend_on(device), []
    for seed in range(4):
        device.outside = 0
        assert_smoothed(replay(backend, image(seed), Levels(2.5 + seed)), image(seed), Levels(2.5 + seed))
        counts.append(device.outside)
    assert counts == [3, 0, 0, 0]
    graphs = backend.graphs.counts
    assert (graphs.recorded, graphs.made, graphs.replayed, graphs.refused) == (1, 1, 3, {})


def test_another_size_or_another_fixed_number_is_recorded_anew():
    backend = backend_on(EmulatedDevice())
    for shape in ((40, 50), (41, 50), (40, 50)):
        assert_smoothed(replay(backend, image(1, shape), Levels(2.0)), image(1, shape), Levels(2.0))
    assert (backend.graphs.counts.recorded, backend.graphs.counts.replayed) == (2, 1)
    replay(backend, image(1), Levels(2.0, 5))
    assert backend.graphs.counts.recorded == 3


def test_results_that_are_still_in_use_are_not_overwritten():
    backend = backend_on(EmulatedDevice())
    kept = [replay(backend, image(seed), Levels(2.0)) for seed in range(4)]
    assert backend.graphs.counts.made == 3, "one for each result that is in use"
    for seed, each in enumerate(kept):
        assert_smoothed(each, image(seed), Levels(2.0))
    del kept, each
    gc.collect()
    replay(backend, image(5), Levels(2.0))
    assert backend.graphs.counts.made == 3


def test_a_result_is_read_where_it_lies_and_an_argument_given_twice_is_not_two():
    def twice(one, other):
        return dilate(one, (3, 3)) - other

    backend = backend_on(EmulatedDevice())
    kernels = Kernels(backend.resident)
    for seed in range(3):
        same, other = kernels.keep(image(seed)), kernels.keep(image(9 + seed))
        for second in (same, other):
            found = kernels.replay(
                twice, kernels.replay(smooth, same, Levels(2.0), kernels)[0]["mean"], second
            )
            mean = np.asarray(kernels.average_windows(image(seed), (3, 3)))
            expected = np.asarray(kernels.find_extremes(mean, (3, 3), largest=True)) - np.asarray(second)
            assert np.asarray(found).tobytes() == expected.tobytes()
        assert np.asarray(kernels.replay(twice, same, same)).min() >= 0
    assert backend.graphs.counts.refused == {}


def test_what_reads_on_the_processor_runs_as_ever():
    def reads(plane):
        return blur(plane, (3, 3)) * float(np.asarray(plane).max())

    backend = backend_on(EmulatedDevice())
    kernels = Kernels(backend.resident)
    for seed in range(2):
        found = kernels.replay(reads, kernels.keep(image(seed)))
        expected = np.asarray(kernels.average_windows(image(seed), (3, 3))) * image(seed).max()
        np.testing.assert_array_equal(found, expected)
    assert list(backend.graphs.counts.refused.values()) == [
        "an array of the GPU (40, 50) is read on the processor"
    ]


def test_intermediate_results_share_memory_unless_they_live_at_the_same_time():
    sizes = {1: 1000, 2: 500, 3: 1000, 4: 100}
    places, size = place_in_turn({1: (0, 2), 2: (1, 3), 3: (3, 5), 4: (6, 6)}, sizes)
    assert (places[1], places[3], size) == (0, 0, 1536)
    assert places[2] == 1024
    assert places[4] == 0


@pytest.fixture(scope="module")
def frames():
    rig, solids = make_ring((0, 180), size_px=(48, 36)), (plane(760), patch(680, (-120, 120), (-100, 100)))
    rendered = [render_images(rig, solids, noise=1 + seed, seed=seed) for seed in range(2)]
    return rig, [
        FrameSet(str(i), {name: quantise(each * (1 - 0.1 * i)) for name, each in images.items()})
        for i, images in enumerate(rendered)
    ]


def reconstruct(frames, kernels: Kernels, number: int, preset: str = "fast"):
    rig, sets = frames
    matcher = MultiviewReconstructor(rig, (620, 820), MultiviewSettings.preset(preset), kernels=kernels)
    return matcher.reconstruct(sets[number], Silent())


@pytest.mark.parametrize(
    ("preset", "graphs", "most_outside"),
    list_rows([("fast", 10, 0.003), ("standard", 13, 0.003)], {("standard", 13, 0.003)}),
)
def test_a_second_frame_goes_through_the_graphs_of_the_first(
    frames, preset, graphs, most_outside, monkeypatch
):
    monkeypatch.setattr("beltscape.stereo.settings._LEAST_WIDTH_PX", 12 if preset == "fast" else 24)
    device = Counting(2)
    backend = backend_on(device)
    kernels = Kernels(backend)
    first = reconstruct(frames, kernels, 0, preset)
    recorded = device.outside
    reconstruct(frames, kernels, 1, preset)  # whose lists of pixels may be of another length
    device.outside = 0
    second = reconstruct(frames, kernels, 1, preset)
    fresh = reconstruct(frames, Kernels(backend_on(EmulatedDevice())), 1, preset)
    assert same_bytes(second, fresh)
    assert not same_bytes(first, second)
    counts = backend.graphs.counts
    assert counts.refused == {}
    assert graphs <= counts.recorded <= graphs + 3
    assert counts.replayed > graphs
    assert device.outside < most_outside * recorded


def test_frames_in_flight_have_graphs_of_their_own(frames):
    device = EmulatedDevice(3)
    backend = backend_on(device)
    kernels = Kernels(backend)
    expected = [reconstruct(frames, kernels, number) for number in (0, 1)]
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(lambda i: reconstruct(frames, kernels, i % 2), range(3)))
    for i, each in enumerate(found):
        assert same_bytes(each, expected[i % 2])
    assert kernels.failure is None
    backend.graphs.clear()
    gc.collect()
    device.constants.clear()
    device.memory.trim()
    assert device.memory.in_use == 0


class Card:
    """The memory of a GPU that several processes open."""

    def __init__(self, size: int) -> None:
        self.free = size

    def open(self) -> CudaBackend:
        """Return the back end of one more process; its bound is not that of the others."""
        device = EmulatedDevice()
        own_allocate = device.memory.allocate

        def allocate(size: int):
            if size > self.free:
                raise DeviceError("CUDA_ERROR_OUT_OF_MEMORY: out of memory")
            self.free -= size
            return own_allocate(size)

        def free(raw, events) -> None:
            del events
            self.free += raw.values.size

        device.memory.allocate, device.memory.free = allocate, free
        return backend_on(device)


def test_two_processes_share_a_gpu_and_one_that_finds_no_memory_leaves_it_to_the_other(frames):
    card = Card(4 << 20)
    first, second = Kernels(card.open()), Kernels(card.open())
    expected = [reconstruct(frames, Kernels(backend_on(EmulatedDevice())), number) for number in (0, 1)]
    with ThreadPoolExecutor(2) as pool:
        jobs = [(first, 0), (second, 1)]
        found = list(pool.map(lambda job: reconstruct(frames, *job), jobs))
    for (_, number), each in zip(jobs, found, strict=True):
        assert same_bytes(each, expected[number])
    third = Kernels(card.open())
    card.free = 40_000
    with pytest.warns(
        RuntimeWarning, match="OUT_OF_MEMORY.* 0 MB of the GPU's are held here, the rest by others"
    ):
        by_processor = reconstruct(frames, third, 0)
    assert same_bytes(by_processor, reconstruct(frames, load(first_alike("emulated")), 0))
    assert same_bytes(reconstruct(frames, second, 0), expected[0])
    assert first.failure is second.failure is None


def test_a_gpu_that_is_lost_in_a_graph_loses_no_frame_and_no_memory(frames):
    device = Counting()
    kernels = Kernels(backend_on(device))
    reconstruct(frames, kernels, 0)
    device.is_lost = True
    with pytest.warns(RuntimeWarning, match="the processor takes over: CUDA_ERROR_DEVICE_LOST"):
        found = reconstruct(frames, kernels, 1)
    assert same_bytes(found, reconstruct(frames, kernels, 1))
    gc.collect()
    device.constants.clear()
    device.memory.trim()
    assert device.memory.in_use == 0


def test_graphs_give_their_memory_up_where_it_is_needed():
    device = EmulatedDevice(most_bytes=160_000)
    backend = backend_on(device)
    for seed in range(3):
        assert_smoothed(replay(backend, image(seed), Levels(2.0)), image(seed), Levels(2.0))
    kernels = Kernels(backend.resident)
    large = kernels.spline_coefficients(image(1, (100, 110)))
    assert large.shape == (100, 110)
    assert backend.failure is None
