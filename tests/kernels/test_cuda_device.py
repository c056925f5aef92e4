"""The CUDA back end without a GPU: its calls of cuda-core, its choice, and what happens when a GPU fails."""

from __future__ import annotations

import re
import sys
import tomllib
import warnings
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.errors import KernelError
from beltscape.kernels import kernels_on_gpu, load, self_test
from beltscape.kernels.backend import gpu_failures
from beltscape.kernels.cuda.cuda_device import CudaDevice
from beltscape.kernels.cuda.emulated_device import is_emulation_built
from beltscape.kernels.native import levels
from beltscape.kernels.planes import blur
from beltscape.pipeline.installation import check_graphics, check_kernels
from tests.kernels import fake_cuda
from tests.kernels.rounding import ROUNDED, first_alike, fusing_levels


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    monkeypatch.delenv("BELTSCAPE_KERNELS", raising=False)
    load.cache_clear()
    gpu_failures.clear()
    yield
    gpu_failures.clear()
    load.cache_clear()


@pytest.fixture
def gpu(monkeypatch) -> fake_cuda.FakeGpu:
    if not is_emulation_built():
        pytest.skip("the emulated GPU is not built")
    gpu = fake_cuda.FakeGpu()
    fake_cuda.install(monkeypatch, gpu)
    return gpu


def test_every_kernel_of_the_source_is_bound_by_the_emulation(gpu):
    emulated = import_module("beltscape.kernels._emulated")
    assert {name for name in dir(emulated) if not name.startswith("_")} == set(gpu.kernels)


@pytest.mark.skipif(not fusing_levels(), reason="no level on this processor fuses, as a GPU does")
def test_a_gpu_that_agrees_is_chosen_and_gives_the_bytes_of_the_processor(gpu):
    with warnings.catch_warnings(action="error"):
        kernels = load()
    assert kernels.name == "cuda"
    gpu.launches.clear()
    for name, run in self_test.CASES.items():
        if name in ROUNDED:
            continue
        for found, expected in zip(run(kernels), run(load(first_alike("emulated"))), strict=True):
            assert np.asarray(found).tobytes() == np.asarray(expected).tobytes()
    assert {"sweep_planes", "sum_equations", "fit_planes", "network_outputs"} <= set(gpu.launches)
    memory = getattr(kernels.backend, "_device").memory  # noqa: B009
    getattr(kernels.backend, "_device").constants.clear()  # noqa: B009
    memory.trim()
    assert memory.allocated == memory.in_use == 0, "a call returns all of its memory"
    assert not gpu.buffers
    assert gpu.streams <= 4, (
        "one for memory, and for calls one after the other or, of expressions, within another"
    )


def average_twice(plane):
    return blur(blur(plane, (3, 3)), (5, 5))


def test_a_recorded_function_is_captured_and_launched_as_a_graph(gpu):
    planes = [np.random.default_rng(seed).uniform(1, 2, (30, 40)).astype(np.float32) for seed in range(3)]
    kernels = load("cuda")
    found = [
        kernels.run_resident(
            lambda same, plane=plane: np.asarray(same.replay(average_twice, same.keep(plane)))
        )
        for plane in planes
    ]
    launches = ["sum_window_rows", "average_window_columns"] * 2
    assert gpu.launches == launches * 3, "captured launches do not run"
    for plane, each in zip(planes, found, strict=True):
        np.testing.assert_allclose(each, average_twice(plane), rtol=1e-6)
    assert kernels.failure is None


def test_kernels_that_the_gpu_lacks_run_on_the_processor(gpu):
    planes = np.random.default_rng(0).uniform(1, 2, (3, 2, 4, 5)).astype(np.float32)
    given = {"rank": 0.5, "outlier": 3.0, "tolerance": 1.0}
    found, expected = (load(name).fuse_layers(tuple(planes), **given) for name in ("cuda", "native"))
    assert "fuse_layers" not in kernels_on_gpu()
    assert found.height.tobytes() == expected.height.tobytes()
    assert not gpu.launches


def test_an_input_beyond_the_limits_of_the_gpus_kernels_runs_on_the_processor(gpu):
    core = np.random.default_rng(0).uniform(0, 255, (12, 12)).astype(np.float32)
    views = np.repeat(self_test._views()[:1], 9, axis=0)
    found = load("cuda").sweep(core, [core] * 9, views, 0, 1, 4, 9.0, best=9)
    assert not gpu.launches
    assert found.tobytes() == load("native").sweep(core, [core] * 9, views, 0, 1, 4, 9.0, best=9).tobytes()


def test_a_gpu_that_disagrees_is_not_chosen(gpu, monkeypatch):
    right = gpu.launch

    def wrong(stream, config, kernel, *arguments):
        right(stream, config, kernel, *arguments)
        if kernel == "select_planes":
            gpu.array(arguments[4], np.float32)[::50] += 0.5

    monkeypatch.setattr(sys.modules["cuda.core"], "launch", wrong)
    with pytest.warns(RuntimeWarning) as warned:
        assert load().name == levels()[-1]
    assert str(warned[0].message) == (
        "the GPU is not used, the processor is: "
        "sweep_and_aggregate differs from the processor's in 2.00% of the values"
    )


def test_a_gpu_that_is_lost_is_replaced_by_the_processor(gpu):
    kernels = load("cuda")
    gpu.failure = RuntimeError("CUDA_ERROR_DEVICE_LOST")
    cost = np.random.default_rng(0).integers(0, 120, (5, 6, 9)).astype(np.uint8)
    with pytest.warns(RuntimeWarning, match="the processor takes over: CUDA_ERROR_DEVICE_LOST") as warned:
        found = [kernels.aggregate(cost, 8, 80) for _ in range(3)]
    assert len(warned) == 1
    for index, margin in found:
        expected = load("native").aggregate(cost, 8, 80)
        assert (index.tobytes(), margin.tobytes()) == (expected[0].tobytes(), expected[1].tobytes())


def test_without_a_driver_nothing_of_cuda_is_imported_and_the_processor_is_chosen(monkeypatch):
    monkeypatch.setattr("beltscape.kernels.cuda.cuda_device.is_driver_present", lambda: False)
    monkeypatch.setattr("beltscape.kernels.cuda.cuda_device.is_library_present", pytest.fail)
    with warnings.catch_warnings(action="error"):
        assert load().name == levels()[-1]


def test_a_gpu_that_was_asked_for_and_is_not_there_is_an_error(monkeypatch):
    monkeypatch.setattr("beltscape.kernels.cuda.cuda_device.is_library_present", lambda: False)
    with pytest.raises(KernelError) as error:
        load("cuda")
    assert str(error.value) == (
        "the kernels cuda need cuda-core, which is not installed; run: pip install 'beltscape[gpu]'"
    )


def test_a_machine_without_a_usable_gpu_is_named(gpu):
    gpu.failure = RuntimeError('"cuda" is an NVIDIA driver library\nand more')
    with pytest.raises(KernelError) as error:
        CudaDevice()
    assert str(error.value) == (
        'there is no usable GPU: "cuda" is an NVIDIA driver library; install Nvidia\'s driver'
    )


def test_a_machine_without_a_driver_is_named(gpu, monkeypatch):
    def find_driver(number):
        raise RuntimeError('"cuda" is an NVIDIA driver library')

    monkeypatch.setattr(sys.modules["cuda.core"], "Device", find_driver)
    with pytest.raises(KernelError, match=r"^there is no usable GPU: .* install Nvidia's driver$"):
        CudaDevice()


def test_a_program_that_was_asked_for_the_gpu_says_in_one_line_that_there_is_no_driver(monkeypatch, capsys):
    monkeypatch.setenv("BELTSCAPE_KERNELS", "cuda")
    monkeypatch.setattr("beltscape.kernels.cuda.cuda_device.is_library_present", lambda: True)
    monkeypatch.setattr("beltscape.kernels.cuda.cuda_device.is_driver_present", lambda: False)
    assert main(["doctor"]) == 2
    assert capsys.readouterr().err == (
        "beltscape: there is no usable GPU: this machine has no driver of Nvidia's; "
        "install it, or unset BELTSCAPE_KERNELS\n"
    )


def test_the_lock_of_the_extra_has_every_package_that_it_names():
    root = Path(__file__).parents[2]
    extra = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]["gpu"]
    locked = (root / "requirements" / "gpu.lock").read_text()
    for requirement in extra:
        assert re.search(rf"^{re.split('[>=<]', requirement)[0]}==", locked, re.MULTILINE)


def test_doctor_says_which_kernels_run_on_the_gpu(gpu):
    found = check_kernels()
    assert found.state == "ok"
    assert found.found.startswith(
        "cuda for sweep, aggregate, sweep_and_aggregate, spline_coefficients, warp, "
    )
    assert f"; {levels()[-1]} (" in found.found


@pytest.mark.parametrize(
    ("library", "fix"), [(True, ""), (False, "to compute on it: pip install 'beltscape[gpu]'")]
)
def test_doctor_names_the_extra_only_where_there_is_a_gpu(monkeypatch, library, fix):
    found = "beltscape.pipeline.installation"
    monkeypatch.setattr(f"{found}.find_spec", lambda _: object() if library else None)
    monkeypatch.setattr(f"{found}._run_program", lambda *_: "NVIDIA H100, 81559 MiB, 580.1")
    assert (check_graphics().found, check_graphics().fix) == ("NVIDIA H100, 81559 MiB, 580.1", fix)
    monkeypatch.setattr(f"{found}._run_program", lambda *_: None)
    assert check_graphics().fix == ""
