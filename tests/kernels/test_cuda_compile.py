"""The headers shared with CUDA and the kernels of the CUDA back end compile as device code, without a GPU.

NVRTC comes as a wheel: `pip install .[cuda-check]`, or `nvidia-cuda-nvrtc` alone.
"""

from __future__ import annotations

import ctypes
import re
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import pytest

from beltscape.core.errors import KernelError
from beltscape.kernels.cuda.cuda_device import _SOURCE, ARCHITECTURES, compile_kernels
from beltscape.kernels.native import source_folder
from tests.kernels.fake_cuda import declared_kernels
from tests.thorough import list_cases

NATIVE = Path(__file__).parents[2] / "native"
OPTIONS = ("--std=c++20", "--fmad=false")


@pytest.fixture(scope="module")
def nvrtc() -> ctypes.CDLL:
    try:
        installed = files("nvidia-cuda-nvrtc") or []
    except PackageNotFoundError:
        pytest.skip("the wheel nvidia-cuda-nvrtc is not installed")
    library = next(file for file in installed if file.name.startswith("libnvrtc.so"))
    return ctypes.CDLL(str(library.locate()))


def compiled(
    nvrtc: ctypes.CDLL, source: str, architecture: str = "sm_90", folder: Path = NATIVE
) -> tuple[bytes, str]:
    """The machine code (empty when refused) and the compiler's log."""
    program = ctypes.c_void_p()
    assert nvrtc.nvrtcCreateProgram(ctypes.byref(program), source.encode(), b"check.cu", 0, None, None) == 0
    all_options = (*OPTIONS, f"--gpu-architecture={architecture}", f"--include-path={folder}")
    options = (ctypes.c_char_p * len(all_options))(*(option.encode() for option in all_options))
    refused = nvrtc.nvrtcCompileProgram(program, len(all_options), options)
    log = fetched(nvrtc, "ProgramLog", program).rstrip(b"\0").decode()
    code = b"" if refused else fetched(nvrtc, "CUBIN", program)
    assert nvrtc.nvrtcDestroyProgram(ctypes.byref(program)) == 0
    return code, log


def fetched(nvrtc: ctypes.CDLL, what: str, program: ctypes.c_void_p) -> bytes:
    size = ctypes.c_size_t()
    assert getattr(nvrtc, f"nvrtcGet{what}Size")(program, ctypes.byref(size)) == 0
    buffer = ctypes.create_string_buffer(size.value)
    assert getattr(nvrtc, f"nvrtcGet{what}")(program, buffer) == 0
    return buffer.raw


def test_the_shared_headers_are_device_code(nvrtc):
    code, log = compiled(nvrtc, (NATIVE / "cuda_check.cu").read_text())
    assert not log, log
    assert code.startswith(b"\x7fELF")
    assert b"check_triangulate" in code


@pytest.mark.parametrize("architecture", list_cases(ARCHITECTURES, ("sm_75",)))
def test_every_kernel_compiles_for_every_gpu_from_the_installed_headers(nvrtc, architecture):
    code, log = compiled(nvrtc, _SOURCE, architecture, source_folder())
    assert not log, log
    assert code.startswith(b"\x7fELF")
    for kernel in declared_kernels():
        assert kernel.encode() in code


def test_cuda_core_compiles_the_kernels_without_a_gpu(nvrtc):
    pytest.importorskip("cuda.core")
    assert b"sweep_planes" in compile_kernels("sm_89").code


def test_kernels_that_do_not_compile_are_refused_with_the_log(nvrtc, tmp_path):
    pytest.importorskip("cuda.core")
    with pytest.raises(KernelError, match=r"^the kernels do not compile for sm_89: kernels.cu\(1\): .*\"$"):
        compile_kernels("sm_89", tmp_path)


def test_the_installed_headers_are_those_that_the_kernels_include():
    installed = {path.relative_to(source_folder()) for path in source_folder().rglob("*.*")}
    needed, found = [Path("cuda/kernels.cuh")], set()
    while needed:
        path = needed.pop()
        found.add(path)
        for include in re.findall(r'#include "([^"]+)"', (NATIVE / path).read_text()):
            if Path(include) not in found and not include.startswith("emulation/"):
                needed.append(Path(include))
    on_processors = {
        Path("vectors.hpp"),
        Path("transpose.hpp"),
    }  # of the processor's lanes, which NVRTC skips
    assert found - on_processors == installed


def test_what_is_no_device_code_is_refused_with_a_log(nvrtc):
    code, log = compiled(nvrtc, '#include "pool.hpp"\n')
    assert not code
    assert "memory" in log
