"""Roofline of the matcher's kernels: python benchmarks/roofline.py CAPTURE --rig rig.json [--preset standard].

Every kernel call of one frame is timed on one thread (processor time, the least of three frames). Beside it stand the
bytes that must be moved at least, its arrays in and out, and its operations (`matching.operations`). The machine's
bandwidth is that of a copy much larger than its caches, its arithmetic peak that of BLAS's float32 matrix product.
The roofline is the longer of bytes / bandwidth and operations / peak (Williams, Waterman & Patterson, CACM 52(4),
2009, doi:10.1145/1498765.1498785); "share" is the roofline over the measured time. Kernels about given pixels read
a plane's values at those only.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.rig_json import read_rig
from beltscape.kernels import Kernels
from beltscape.kernels.backend import Backend
from beltscape.kernels.native import NativeBackend, levels
from beltscape.sources.folder import FolderSource
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import PRESETS, MultiviewSettings
from matching.operations import OPERATIONS

_COPY_BYTES = 256 << 20
"""Bytes of a copied array: eight times the third-level cache of the largest machine this was run on."""
_PRODUCT = 1536
"""Side of the multiplied matrices; larger ones are not faster."""
_RUNS = 3


@dataclass
class Work:
    """The work of one kernel in one frame."""

    calls: int = 0
    seconds: float = 0.0
    bytes: int = 0
    operations: float = 0.0


class RecordingBackend:
    """A back end that measures each call."""

    def __init__(self, backend: Backend) -> None:
        self.name, self._backend = backend.name, backend
        self.work: dict[str, Work] = {}

    def run(self, kernel: str, given: Any, out: Sequence[Any], threads: int) -> Sequence[Any]:
        """Run a kernel and add up its time, its bytes and its operations."""
        start = time.thread_time()
        results = self._backend.run(kernel, given, out, threads)
        spent = time.thread_time() - start
        work = self.work.setdefault(kernel, Work())
        work.calls, work.seconds = work.calls + 1, work.seconds + spent
        work.bytes += count_bytes(given, len(given.u) if hasattr(given, "u") else None) + count_bytes(out)
        work.operations += OPERATIONS[kernel](given, out)
        return results


def count_bytes(value: object, pixels: int | None = None) -> int:
    """Return the bytes of all arrays in a record, each array once; of planes at most a number for each pixel."""
    arrays: dict[int, int] = {}

    def visit(part: object) -> None:
        if isinstance(part, np.ndarray):
            is_plane = pixels is not None and part.ndim == 2 and part.shape[1] != pixels
            most = pixels * part.itemsize if is_plane and pixels is not None else part.nbytes
            arrays[part.ctypes.data] = min(part.nbytes, most)
        elif isinstance(part, list | tuple):
            for item in part:
                visit(item)

    visit(value)
    return sum(arrays.values())


def measure_bandwidth() -> float:
    """Return the bytes per second that one thread moves, read and written, in a large copy."""
    source, target = np.ones(_COPY_BYTES // 4, np.float32), np.zeros(_COPY_BYTES // 4, np.float32)
    return 2 * _COPY_BYTES / measure_least(lambda: np.copyto(target, source))


def measure_peak() -> float:
    """Return the operations per second of one thread in a matrix product of float32."""
    a = np.random.default_rng(1).normal(size=(_PRODUCT, _PRODUCT)).astype(np.float32)
    with threadpool_limits(1):
        return 2 * _PRODUCT**3 / measure_least(lambda: a @ a)


def measure_least(work: Callable[[], object], runs: int = 7) -> float:
    """Return the least processor time of some runs after a warm-up, s."""
    work()
    times = []
    for _ in range(runs):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return min(times)


def measure_frame(capture: Path, rig_file: Path, preset: str) -> tuple[dict[str, Work], float]:
    """Return the work of each kernel in the capture's first frame, and the frame's processor time, s."""
    rig = read_rig(rig_file)
    source = FolderSource(read_capture(capture), {n: c.size_px for n, c in rig.cameras.items()}, Silent())
    frame_set = next(iter(source))
    recording = RecordingBackend(NativeBackend(levels()[-1]))
    settings = MultiviewSettings.preset(preset).model_copy(update={"threads": 1})
    near_far = find_depth_range(rig, frame_set, Silent(), 1)
    matcher = MultiviewReconstructor(rig, near_far, settings, kernels=Kernels(recording))
    matcher.reconstruct(frame_set, Silent())
    frames: list[tuple[float, dict[str, Work]]] = []
    for _ in range(_RUNS):
        recording.work = {}
        start = time.process_time()
        matcher.reconstruct(frame_set, Silent())
        frames.append((time.process_time() - start, recording.work))
    least = {
        name: min((work[name] for _, work in frames), key=lambda one: one.seconds) for name in frames[0][1]
    }
    return least, min(seconds for seconds, _ in frames)


def format_table(work: dict[str, Work], frame_s: float, bandwidth: float, peak: float) -> list[str]:
    """Return a row per kernel, the slowest first, and one for what is outside the kernels."""
    lines = [
        "| kernel | calls | ms | MB | Mop | GB/s | Gop/s | roofline ms | share | bound by |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, one in sorted(work.items(), key=lambda item: -item[1].seconds):
        memory_s, arithmetic_s = one.bytes / bandwidth, one.operations / peak
        roof_s = max(memory_s, arithmetic_s)
        lines.append(
            f"| `{name}` | {one.calls} | {one.seconds * 1e3:.0f} | {one.bytes / 1e6:.0f} | "
            f"{one.operations / 1e6:.0f} | {one.bytes / one.seconds / 1e9:.1f} | "
            f"{one.operations / one.seconds / 1e9:.1f} | {roof_s * 1e3:.1f} | {roof_s / one.seconds:.0%} | "
            f"{'memory' if memory_s > arithmetic_s else 'arithmetic'} |"
        )
    kernels_s = sum(one.seconds for one in work.values())
    lines.append(f"| outside kernels | | {(frame_s - kernels_s) * 1e3:.0f} | | | | | | | |")
    lines.append(f"| frame | | {frame_s * 1e3:.0f} | | | | | | | |")
    return lines


def main() -> None:
    """Print the machine's figures and the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png")
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="standard")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    bandwidth, peak = measure_bandwidth(), measure_peak()
    work, frame_s = measure_frame(arguments.capture, arguments.rig, arguments.preset)
    print(
        f"one thread, kernels {levels()[-1]}: copy {bandwidth / 1e9:.1f} GB/s, sgemm {peak / 1e9:.0f} Gop/s"
    )
    print("\n".join(["", *format_table(work, frame_s, bandwidth, peak)]))


if __name__ == "__main__":
    main()
