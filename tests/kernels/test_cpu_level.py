"""The instruction-set level that the native module finds is the processor's."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest

from beltscape.kernels.native import levels

CPUINFO = Path("/proc/cpuinfo")
V3 = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
V4 = V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
"""Linux's names of the extensions of x86-64-v3 and v4 (x86-64 psABI, table 3.1); abm is lzcnt."""


@pytest.mark.skipif(
    platform.machine() != "x86_64" or not CPUINFO.is_file() or levels()[-1] in ("scalar", "base"),
    reason="needs levels of x86-64, and Linux's list of extensions",
)
def test_the_best_level_is_that_of_the_processors_extensions():
    (flags,) = {
        line.partition(":")[2] for line in CPUINFO.read_text().splitlines() if line.startswith("flags")
    }
    own = set(flags.split())
    assert levels()[-1] == ("v4" if own >= V4 else "v3" if own >= V3 else "v2")
