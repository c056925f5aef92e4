"""The headers shared with CUDA compile as device code, without a GPU.

NVRTC comes as a wheel: `pip install .[cuda-check]`, or `nvidia-cuda-nvrtc` alone.
"""

from __future__ import annotations

import ctypes
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import pytest

NATIVE = Path(__file__).parents[2] / "native"
OPTIONS = ("--gpu-architecture=sm_90", "--std=c++20", "--fmad=false", f"--include-path={NATIVE}")


@pytest.fixture(scope="module")
def nvrtc() -> ctypes.CDLL:
    try:
        installed = files("nvidia-cuda-nvrtc") or []
    except PackageNotFoundError:
        pytest.skip("the wheel nvidia-cuda-nvrtc is not installed")
    library = next(file for file in installed if file.name.startswith("libnvrtc.so"))
    return ctypes.CDLL(str(library.locate()))


def compiled(nvrtc: ctypes.CDLL, source: str) -> tuple[bytes, str]:
    """The machine code (empty when refused) and the compiler's log."""
    program = ctypes.c_void_p()
    assert nvrtc.nvrtcCreateProgram(ctypes.byref(program), source.encode(), b"check.cu", 0, None, None) == 0
    options = (ctypes.c_char_p * len(OPTIONS))(*(option.encode() for option in OPTIONS))
    refused = nvrtc.nvrtcCompileProgram(program, len(OPTIONS), options)
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


def test_what_is_no_device_code_is_refused_with_a_log(nvrtc):
    code, log = compiled(nvrtc, '#include "pool.hpp"\n')
    assert not code
    assert "memory" in log
