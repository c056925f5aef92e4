"""Runs every kernel of a reconstruction in two builds and compares the bytes: ``python tools/compare_kernels.py SO``.

``SO`` is the compiled module of another build, such as that of a wheel, of the level that this installation uses.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import beltscape
from beltscape.cli.main import main as run_program
from beltscape.kernels.native import NativeBackend, levels

DEMO = Path(beltscape.__file__).parent / "data" / "demo"


def load_module(path: Path) -> Any:
    """Return a compiled module that lies anywhere."""
    spec = importlib.util.spec_from_file_location(path.name.partition(".")[0], path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def compare(other: Any) -> tuple[Counter[str], Counter[str]]:
    """Reconstruct the shipped load; return how often each kernel ran, and how often the bytes differed."""
    calls, different = Counter[str](), Counter[str]()
    own = NativeBackend.run

    def run_both(
        self: NativeBackend, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        values = [value.copy() if isinstance(value, np.ndarray) else value for value in given]
        copied = type(given)(*values) if hasattr(given, "_fields") else values
        outputs = [value.copy() for value in out]
        result = own(self, kernel, given, out, threads)
        getattr(other, kernel)(copied, outputs, threads)
        calls[kernel] += 1
        different[kernel] += any(a.tobytes() != b.tobytes() for a, b in zip(out, outputs, strict=True))
        return result

    NativeBackend.run = run_both
    try:
        with tempfile.TemporaryDirectory() as folder:
            scene, rig = str(DEMO / "belt_loaded"), str(DEMO / "truth" / "rig.json")
            run_program(["reconstruct", scene, "--rig", rig, "--out", f"{folder}/depth"])
    finally:
        NativeBackend.run = own
    return calls, different


def main() -> int:
    """Compare, print one line per kernel, and fail if any byte differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("so", type=Path, help="compiled module of another build")
    other = load_module(parser.parse_args().so)
    calls, different = compare(other)
    for kernel, count in sorted(calls.items()):
        print(f"{kernel:<24} {count:4d} calls, {different[kernel]} differ")
    if other.cpu_level() != levels()[-1]:
        print(f"it takes this processor for {other.cpu_level()}, not {levels()[-1]}")
        return 1
    return 1 if different.total() or not calls else 0


if __name__ == "__main__":
    sys.exit(main())
