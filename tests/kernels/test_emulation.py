"""The emulated GPU: its barriers and warp operations are right, and it finds kernels that are wrong."""

from __future__ import annotations

import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.errors import KernelError
from beltscape.kernels import Kernels, load
from beltscape.kernels.cuda.backend import CudaBackend
from beltscape.kernels.cuda.emulated_device import EmulatedDevice, EmulatedMemory, is_emulation_built
from beltscape.kernels.cuda.memory import DeviceError, MemoryPool
from beltscape.kernels.cuda.workspace import Traffic, open_workspace
from beltscape.kernels.native import NativeBackend, levels

ROOT = Path(__file__).parents[2]
SEEDS = range(6)

pytestmark = pytest.mark.skipif(not is_emulation_built(), reason="the emulated GPU is not built")


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    compiler = shutil.which("g++")
    if not compiler:
        pytest.skip("there is no g++")
    path = tmp_path_factory.mktemp("emulation") / "faults"
    source = Path(__file__).with_name("emulated_faults.cpp")
    options = ["-std=gnu++20", "-DBELTSCAPE_SCALAR", "-DBELTSCAPE_EMULATION", f"-I{ROOT / 'native'}"]
    subprocess.run([compiler, *options, str(source), "-o", str(path)], check=True)
    return path


def run(program: Path, kernel: str, seed: int) -> tuple[int, str]:
    done = subprocess.run([program, kernel, str(seed)], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.strip()


def results(program: Path, kernel: str) -> list[list[int]]:
    """What a kernel writes in every order."""
    found = [run(program, kernel, seed) for seed in SEEDS]
    assert all(code == 0 for code, _ in found), found
    return [[int(value) for value in text.split()] for _, text in found]


def test_a_barrier_separates_writing_from_reading_in_every_order(program):
    for found in results(program, "turned"):
        assert found == [*range(63, -1, -1)] * 4


def test_a_missing_barrier_gives_another_result_in_another_order(program):
    found = results(program, "turned_without_barrier")
    assert len({tuple(values) for values in found}) == len(SEEDS)


def test_blocks_that_write_the_same_place_are_found_by_permuting_them(program):
    assert len({tuple(found) for found in results(program, "last_block_wins")}) > 1


def test_the_same_seed_gives_the_same_order(program):
    assert run(program, "turned_without_barrier", 3) == run(program, "turned_without_barrier", 3)


def test_warp_operations_give_what_cuda_documents(program):
    expected = []
    for own in range(64):
        lane, first = own % 32, own // 32 * 32
        code = 0
        for value in (
            own - 1 if lane else own,
            own + 2 if lane < 30 else own,
            own ^ 16,
            first + 3,
            0x55555555,  # the odd lanes, moved by one
            int(first == 32),
            int(first == 32),
            first,
            first + 16 if lane >= 16 else 0,
        ):
            code = (code * 31 + value) % 1000003
        expected.append(code)
    for found in results(program, "warp_operations"):
        assert found == expected * 4


def test_a_barrier_does_not_wait_for_threads_that_have_ended(program):
    for found in results(program, "half_ends"):
        assert found == ([2] * 32 + [1] * 32) * 4


def test_shared_memory_holds_nothing_of_the_block_before(program):
    for found in results(program, "unwritten_shared_memory"):
        assert set(found) == {-1}


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("kernel", "message"),
    [
        ("different_barriers", "threads of a block wait at different barriers, at emulated_faults.cpp:"),
        ("shuffle_with_ended", "threads of a block wait for others that have ended or wait elsewhere, at "),
        ("lane_outside_mask", "a lane outside the mask is read, at emulated_faults.cpp:"),
        ("past_shared_memory", "a kernel writes past its shared memory"),
        ("past_dynamic_memory", "a kernel writes past its shared memory"),
        ("too_many_threads", "a block has 1 to 1024 threads"),
        ("too_much_memory", "a block has at most 48 KB of shared memory"),
    ],
)
def test_a_kernel_that_is_wrong_is_refused(program, kernel, message, seed):
    code, text = run(program, kernel, seed)
    assert code == 1
    assert text.startswith(message)


def costs() -> np.ndarray:
    return np.random.default_rng(zlib.crc32(b"costs")).integers(0, 120, (5, 6, 9)).astype(np.uint8)


def test_what_is_written_past_an_array_is_found():
    class Short(EmulatedMemory):
        def __init__(self, size):
            super().__init__(size - 4 if size == 5 * 6 * 4 else size)
            self.values = self._all[64 : 64 + size]

    device = EmulatedDevice()
    device.memory = MemoryPool(Short, lambda *_: None, grain=1)
    backend = CudaBackend(device, NativeBackend(levels()[-1]))
    with pytest.warns(RuntimeWarning, match="select_planes: a kernel writes past the ends of an array"):
        Kernels(backend).aggregate(costs(), 8, 80)


def test_an_argument_of_another_type_is_refused_by_the_kernels_own_signature():
    with open_workspace(EmulatedDevice(), Traffic()) as work:
        level = work.allocate((1,), np.float32)
        with pytest.raises(TypeError) as error:
            work.launch("mean_level", (1, 1, 1), (256, 1, 1), work.upload(np.zeros(3)), 3, level)
        assert str(error.value).startswith(
            "mean_level: arguments[0] must be a contiguous array of the kernel's type"
        )
        with pytest.raises(TypeError, match="must be 3 arguments"):
            work.launch("mean_level", (1, 1, 1), (256, 1, 1), 3)


def test_an_array_of_the_processor_is_none_of_the_device():
    """A transfer that is missing fails: the device's memory is apart from the processor's."""
    with open_workspace(EmulatedDevice(), Traffic()) as work:
        level = work.allocate((1,), np.float32)
        with pytest.raises(TypeError, match="mean_level: an array of the processor is given to the device"):
            work.launch("mean_level", (1, 1, 1), (256, 1, 1), np.zeros(3, np.float32), 3, level)
        with pytest.raises(TypeError):
            np.sqrt(np.asarray(level))  # an object, no numbers


def test_a_device_that_fails_is_replaced_by_the_processor_with_a_warning():
    class Lost(EmulatedDevice):
        def open_stream(self):
            raise DeviceError("CUDA_ERROR_DEVICE_LOST")

    native = load("native")
    backend = CudaBackend(Lost(), NativeBackend(levels()[-1]))
    kernels = Kernels(backend)
    with pytest.warns(RuntimeWarning) as warned:
        found = [kernels.aggregate(costs(), 8, 80) for _ in range(2)]
    assert [str(each.message) for each in warned] == [
        "the GPU is no longer used, the processor takes over: CUDA_ERROR_DEVICE_LOST"
    ]
    assert backend.failure == "CUDA_ERROR_DEVICE_LOST"
    for index, margin in found:
        expected = native.aggregate(costs(), 8, 80)
        assert index.tobytes() == expected[0].tobytes()
        assert margin.tobytes() == expected[1].tobytes()


def test_an_emulated_gpu_that_is_not_built_says_how_to_build_it(monkeypatch):
    monkeypatch.setattr("beltscape.kernels.cuda.emulated_device.find_spec", lambda _: None)
    with pytest.raises(KernelError) as error:
        load("emulated-99")
    assert str(error.value) == "the emulated GPU is not built; run: make dev"
