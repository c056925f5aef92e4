"""Arrays that stay on the GPU: copied once, read-only, in a pool with a bound; a GPU that fails loses no frame."""

from __future__ import annotations

import gc
from dataclasses import fields

import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.kernels import Kernels, load
from beltscape.kernels.backend import gpu_failures
from beltscape.kernels.cuda.constants import ConstantCache
from beltscape.kernels.cuda.emulated_device import EmulatedDevice
from beltscape.kernels.cuda.memory import DeviceArray, DeviceError, MemoryPool
from beltscape.kernels.cuda.workspace import Traffic, open_workspace
from beltscape.kernels.resident import ResidentArray
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from tests.kernels.emulated import ON_EMULATION, backend_on
from tests.kernels.rounding import first_alike
from tests.stereo.scenes import make_ring, patch, plane, quantise, render_images

pytestmark = ON_EMULATION


def image(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (12, 15)).astype(np.float32)


class Failing(EmulatedDevice):
    """A GPU that is lost at its n-th launch or copy."""

    def __init__(self, last: int) -> None:
        super().__init__()
        self.left = last

    def _count(self) -> None:
        self.left -= 1
        if self.left < 0:
            raise DeviceError("CUDA_ERROR_DEVICE_LOST")

    def launch(self, stream, kernel, grid, block, arguments, shared_bytes):
        self._count()
        super().launch(stream, kernel, grid, block, arguments, shared_bytes)

    def copy_in(self, stream, host, array):
        self._count()
        super().copy_in(stream, host, array)

    def copy_out(self, stream, array, host):
        self._count()
        super().copy_out(stream, array, host)


def test_results_pass_from_kernel_to_kernel_and_are_copied_once_where_numpy_reads_them():
    backend = backend_on(EmulatedDevice())
    kernels, traffic = Kernels(backend.resident), backend.traffic
    kept = kernels.keep(image())
    coefficients = kernels.spline_coefficients(kept)
    again = kernels.spline_coefficients(kept)
    assert isinstance(coefficients, ResidentArray)
    assert (traffic.uploads, traffic.uploaded_bytes, traffic.downloads) == (1, image().nbytes, 0)
    value, _ = kernels.warp(np.zeros_like(image()), np.zeros(39, np.float32), again)
    assert traffic.uploads == 3
    expected = load(first_alike("emulated")).spline_coefficients(image())
    for _ in range(2):
        np.testing.assert_array_equal(coefficients, expected)
    assert (traffic.downloads, traffic.downloaded_bytes) == (1, image().nbytes)
    assert value.shape == image().shape


def test_a_resident_array_is_read_only_and_else_like_numpys():
    kernels = Kernels(backend_on(EmulatedDevice()).resident)
    given = image()
    kept = kernels.keep(given)
    assert kernels.keep(kept) is kept
    for array in (given, np.asarray(kept), np.asarray(kernels.spline_coefficients(kept))):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1
    with pytest.raises(TypeError):
        np.add(given, 1, out=kept)
    assert (kept + 1).tobytes() == (given + 1).tobytes()
    assert (given * kept).tobytes() == (given * given).tobytes()
    assert kept[2:4].tolist() == given[2:4].tolist()
    assert kept.max() == given.max()
    assert np.where(given > 9, kept, 0).tobytes() == np.where(given > 9, given, 0).tobytes()
    assert len(kept) == 12
    assert kept.reshape(-1, 5).shape == (36, 5)


def test_parts_and_shapes_of_a_result_stay_on_the_device():
    backend = backend_on(EmulatedDevice())
    kernels = Kernels(backend.resident)
    values = kernels.gather(
        [image(), image(1)], np.array([3, 4]), np.array([0, 11]), np.array([[0, 0], [1, 1]])
    )
    first, second = values.reshape(2, -1)
    assert isinstance(second, ResidentArray)
    assert not backend.traffic.downloads
    assert second.tolist() == [*image(1)[[0, 11], [3, 4]], *image(1)[[1, 11], [4, 5]]]
    assert first.shape == (4,)


def test_without_a_gpu_nothing_is_kept():
    kernels, array = load("native"), image()
    assert kernels.keep(array) is array
    assert kernels.run_resident(lambda same: same) is kernels
    assert kernels.choose_pixels(7) == 7
    assert kernels.failure is None


class Memory:
    address = 0


def pool_of(bound: int) -> tuple[MemoryPool, list[int]]:
    taken: list[int] = []

    def allocate(size: int) -> Memory:
        taken.append(size)
        return Memory()

    return MemoryPool(allocate, lambda *_: taken.append(-1), bound, grain=100), taken


def test_a_pool_gives_a_block_again_once_nothing_refers_to_it():
    pool, taken = pool_of(1000)
    first = pool.take(150)
    raw = first.raw
    pool.take(150)
    del first
    gc.collect()
    assert pool.take(199).raw is raw
    assert taken == [200, 200]
    assert (pool.allocated, pool.peak) == (400, 400)


def test_a_pool_frees_what_is_free_before_it_exceeds_its_bound_and_then_fails():
    pool, taken = pool_of(1000)
    blocks = [pool.take(300), pool.take(300)]
    del blocks[0]
    gc.collect()
    large = pool.take(600)
    assert taken == [300, 300, -1, 600]
    with pytest.raises(
        DeviceError, match=r"^the arrays of a frame exceed the bound of 0 MB of the GPU's memory$"
    ):
        pool.take(200)
    assert pool.in_use == 900
    assert large.size == 600


def test_a_block_is_used_by_another_stream_after_its_last_use():
    waits = []

    class Ordered(EmulatedDevice):
        def record(self, stream):
            return stream

        def wait(self, stream, event):
            waits.append(event)

    device, traffic = Ordered(), Traffic()
    with open_workspace(device, traffic) as first:
        array = ResidentArray.from_device(first.upload(image()), backend_on(device).resident)
        own = first._stream
    assert not waits
    with open_workspace(device, traffic) as second:
        second.upload(array)
    assert waits == [own]


def test_an_array_that_is_given_again_is_not_uploaded_again():
    backend = backend_on(EmulatedDevice())
    kernels = Kernels(backend.resident)
    first, again = (np.asarray(kernels.spline_coefficients(image(seed))) for seed in (1, 1))
    assert (backend.traffic.uploads, first.tobytes()) == (1, again.tobytes())
    other = np.asarray(kernels.spline_coefficients(image(2)))
    assert backend.traffic.uploads == 2
    np.testing.assert_array_equal(other, load(first_alike("emulated")).spline_coefficients(image(2)))


def test_memory_of_a_constant_that_is_dropped_waits_for_all_streams():
    pool, _ = pool_of(1000)
    cache = ConstantCache(most=2)

    def upload() -> DeviceArray:
        return DeviceArray(pool.take(100), (100,), np.dtype(np.uint8))

    arrays = [cache.find(("u", (1,), bytes([i])), upload) for i in range(2)]
    assert cache.find(("u", (1,), b"\0"), lambda: pytest.fail("it is there")) is arrays[0]
    cache.note_use(7, "an event")
    cache.find(("u", (1,), b"\2"), upload)  # drops the one that was not used again
    assert (arrays[0].block.events, arrays[1].block.events) == ({}, {7: "an event"})
    del arrays
    gc.collect()
    assert pool.take(100).events == {7: "an event"}
    cache.clear()
    gc.collect()
    assert pool.take(100).events == {7: "an event"}


@pytest.fixture(scope="module")
def tiny():
    rig, solids = make_ring((0, 180), size_px=(48, 36)), (plane(760), patch(680, (-120, 120), (-100, 100)))
    images = {name: quantise(each) for name, each in render_images(rig, solids, noise=1.0).items()}
    return rig, FrameSet("000", images)


def reconstruct(tiny, kernels: Kernels, preset: str = "fast"):
    rig, frames = tiny
    matcher = MultiviewReconstructor(rig, (620, 820), MultiviewSettings.preset(preset), kernels=kernels)
    return matcher.reconstruct(frames, Silent())


def same_bytes(one, other) -> bool:
    return all(
        np.asarray(getattr(one, each.name)).tobytes() == np.asarray(getattr(other, each.name)).tobytes()
        for each in fields(one)
    )


def assert_agrees(found, expected) -> None:
    """Demand depth within 0.001 mm at the same pixels; logarithms and sums may differ in their last digit."""
    np.testing.assert_array_equal(found.measured, expected.measured)
    np.testing.assert_allclose(found.depth_mm, expected.depth_mm, rtol=0, atol=0.001)
    np.testing.assert_allclose(found.sigma_mm, expected.sigma_mm, rtol=1e-4)
    np.testing.assert_array_equal(found.views, expected.views)


@pytest.mark.parametrize("preset", ["fast", "standard"])
def test_a_frame_is_that_of_the_processor_and_can_be_changed(tiny, preset):
    backend = backend_on(EmulatedDevice(2))
    found = reconstruct(tiny, Kernels(backend), preset)
    assert_agrees(found, reconstruct(tiny, load(first_alike("emulated")), preset))
    for each in (found.depth_mm, found.sigma_mm, found.confidence, found.views):
        assert type(each) is np.ndarray
        assert each.flags.writeable
    assert all(image.flags.writeable for image in tiny[1].images.values())


def test_a_frame_copies_less_than_its_kernels_arrays(tiny):
    device = EmulatedDevice()
    backend = backend_on(device)
    reconstruct(tiny, Kernels(backend), "standard")
    resident = backend.traffic.total_bytes
    assert device.memory.peak < 900 * 48 * 36, "bytes a pixel: two frames of 5 MP stay within the bound"
    backend.traffic.__init__()
    rig, frames = tiny
    matcher = MultiviewReconstructor(
        rig, (620, 820), MultiviewSettings.preset("standard"), kernels=Kernels(backend)
    )
    matcher._estimate_depth_map(frames, Silent())  # every call with its own copies
    assert resident < 0.3 * backend.traffic.total_bytes


@pytest.mark.parametrize("last", [0, 1, 50, 150])
def test_a_gpu_that_is_lost_within_a_frame_loses_no_frame(tiny, last):
    kernels = Kernels(backend_on(Failing(last)))
    with pytest.warns(RuntimeWarning, match="the processor takes over: CUDA_ERROR_DEVICE_LOST") as warned:
        found = reconstruct(tiny, kernels)
    assert len([each for each in warned if each.category is RuntimeWarning]) == 1
    expected = reconstruct(tiny, load(first_alike("emulated")))
    assert same_bytes(found, expected)
    assert kernels.failure == gpu_failures.text == "CUDA_ERROR_DEVICE_LOST"
    assert same_bytes(reconstruct(tiny, kernels), expected), "and the next one has no GPU"


def test_a_frame_that_exceeds_the_memory_is_computed_by_the_processor(tiny):
    kernels = Kernels(backend_on(EmulatedDevice(most_bytes=100_000)))
    with pytest.warns(RuntimeWarning, match="exceed the bound of 0 MB"):
        found = reconstruct(tiny, kernels)
    assert same_bytes(found, reconstruct(tiny, load(first_alike("emulated"))))
