"""The processor instructions of a training: those that all x86-64 processors with AVX2 have, of any maker.

NumPy, PyTorch and their libraries of linear algebra choose the widest instructions of the processor, and a sum over
vectors of another width is rounded otherwise. In a fit of thousands of steps that grows to other weights. With one
choice for all processors the samples of a capture and the fits are the same bytes. The renderer of the captures has
no such choice: between kinds of processors the last bits of its light may differ.
"""

from __future__ import annotations

import os
import sys

PINNED = {
    # samples: float32 exp and log have other last bits with AVX-512
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "OPENBLAS_CORETYPE": "Haswell",
    # fits: without MKL's branch matrix products differ between makers, and without the others with AVX-512
    "MKL_CBWR": "COMPATIBLE",
    "ATEN_CPU_CAPABILITY": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
}
"""Environment variables of NumPy, OpenBLAS, MKL, PyTorch and oneDNN, which read them when they are loaded."""


def restart_pinned() -> None:
    """Start this program again with these variables, unless it has them; programs that it starts get them, too."""
    if any(os.environ.get(name) != value for name, value in PINNED.items()):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | PINNED)
