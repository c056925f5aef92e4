"""The CUDA back end on a frame: python benchmarks/gpu.py CAPTURE --rig rig.json [--preset standard] [--device cuda].

Writes benchmarks/GPU.md. Of every kernel of the frame stand the bytes of its arrays in and out, its operations
(`matching.operations`), and the roofline of three graphics processors: the longer of bytes / bandwidth and operations
/ peak, as `roofline` has it for the processor. Where a GPU is there, the times of whole calls (arrays up, launches,
results down) and of the launches alone stand beside them, and the share of pixels in which the depth map differs from
the processor's by more than 0.001 mm. ``--device emulated`` does the same on the emulated GPU, whose times mean
nothing.
"""

from __future__ import annotations

import argparse
import subprocess
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.rig_json import read_rig
from beltscape.kernels import Kernels, kernels_on_gpu, load
from beltscape.kernels.cuda.backend import CudaBackend
from beltscape.kernels.cuda.cuda_device import CudaDevice
from beltscape.kernels.cuda.device import GpuDevice
from beltscape.kernels.cuda.emulated_device import EmulatedDevice
from beltscape.kernels.native import NativeBackend, levels
from beltscape.sources.folder import FolderSource
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import PRESETS, MultiviewSettings
from roofline import Work, measure_frame

_PAGE = Path(__file__).with_name("GPU.md")
_FAR_MM = 0.001
"""Depths that differ by more are counted."""
_RUNS = 5


@dataclass(frozen=True)
class Gpu:
    """A graphics processor by its maker's data sheet."""

    name: str
    bytes_per_s: float
    """Of its memory."""
    operations_per_s: float
    """In single precision; a fused multiply-add is two."""
    transfer_bytes_per_s: float
    """To and from the processor's memory, each way."""


GPUS = (
    Gpu("H100 SXM", 3.35e12, 66.9e12, 63e9),
    Gpu("RTX 4070", 504e9, 29.1e12, 31.5e9),
    Gpu("Jetson AGX Orin", 204.8e9, 5.3e12, 204.8e9),
)


@dataclass
class Measured:
    """What one device needed for the kernels of a frame, and how its depth map differs."""

    name: str
    frame_s: float
    call_s: dict[str, float]
    """Kernel → time of its calls, with copies."""
    launch_s: dict[str, float]
    """Kernel of native/cuda → time of its launches."""
    far_share: float
    """Of the pixels that both measure: further than 0.001 mm from the processor's."""
    only_one_share: float
    """Of all pixels: those that only one of both measures."""


class TimedDevice:
    """A device that measures each launch, until it has ended."""

    def __init__(self, device: GpuDevice) -> None:
        self.name = device.name
        self.seconds: dict[str, float] = {}
        self._device = device

    @contextmanager
    def workspace(self) -> Generator[Any]:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        with self._device.workspace() as work:
            launch, wait = work.launch, getattr(work, "wait", lambda: None)

            def timed(kernel: str, *arguments: Any, **more: Any) -> None:
                wait()
                start = time.perf_counter()
                launch(kernel, *arguments, **more)
                wait()
                self.seconds[kernel] = self.seconds.get(kernel, 0) + time.perf_counter() - start

            setattr(work, "launch", timed)  # noqa: B010
            yield work


class TimedBackend(CudaBackend):
    """A CUDA back end that measures each call, copies included."""

    seconds: dict[str, float]

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`."""
        start = time.perf_counter()
        results = super().run(kernel, given, out, threads)
        self.seconds[kernel] = self.seconds.get(kernel, 0) + time.perf_counter() - start
        return results


def measure_device(
    device: GpuDevice, capture: Path, rig_file: Path, preset: str, runs: int = _RUNS
) -> Measured:
    """Return the times of a frame on a device, the least of some runs, and its difference from the processor's."""
    rig = read_rig(rig_file)
    source = FolderSource(read_capture(capture), {n: c.size_px for n, c in rig.cameras.items()}, Silent())
    frame_set = next(iter(source))
    near_far = find_depth_range(rig, frame_set, Silent(), 1)
    settings = MultiviewSettings.preset(preset)

    def matcher(kernels: Kernels) -> MultiviewReconstructor:
        return MultiviewReconstructor(rig, near_far, settings, kernels=kernels)

    native = NativeBackend(levels()[-1])
    backend = TimedBackend(device, native)
    on_device = matcher(Kernels(backend))
    backend.seconds = {}
    depth = on_device.reconstruct(frame_set, Silent())
    frames: list[tuple[float, dict[str, float]]] = []
    for _ in range(runs):
        backend.seconds = {}
        start = time.perf_counter()
        on_device.reconstruct(frame_set, Silent())
        frames.append((time.perf_counter() - start, backend.seconds))
    timed = TimedDevice(device)
    matcher(Kernels(CudaBackend(timed, native))).reconstruct(frame_set, Silent())

    expected = matcher(load("native")).reconstruct(frame_set, Silent())
    both = depth.measured & expected.measured
    far = np.abs(depth.depth_mm - expected.depth_mm)[both] > _FAR_MM
    frame_s, call_s = min(frames, key=lambda frame: frame[0])
    return Measured(
        device.name,
        frame_s,
        call_s,
        timed.seconds,
        float(far.mean()) if far.size else 0.0,
        float((depth.measured != expected.measured).mean()),
    )


_INTRODUCTION = """\
# Graphics processors

{state} `benchmarks/gpu.py` writes this page; `benchmarks/gpu.sh` builds, tests and measures on a GPU.

NVRTC compiles every kernel for sm_75, 80, 86, 89, 90 and 100, and the emulation runs the same source on the processor
in the tests, where its results are those of the levels v3 and v4 byte by byte.

## What one frame asks for: {frame}

MB are the arrays in and out of the kernels, each once; a kernel that keeps intermediate results in memory moves more.
Roofline: the longer of MB / bandwidth and operations / peak of the maker's data sheet ({gpus}).
It is what no implementation can beat, not what this one will reach. Transfer: the same MB between the memories of
processor and GPU, as every call does today; images do not stay on the device. Kernels marked *processor* have no CUDA
kernel yet.
"""


def format_page(frame: str, work: dict[str, Work], measured: Measured | None) -> str:
    """Return the page: the state, the counts with their rooflines, and what was measured."""
    not_run = "**Compiled and emulated, not run**: no GPU was at hand when this page was written."
    state = f"Measured on {measured.name}." if measured else not_run
    gpus = ", ".join(_format_gpu(gpu) for gpu in GPUS)
    introduction = _INTRODUCTION.format(state=state, frame=frame, gpus=gpus)
    rows = [*_format_counts(work), *(_format_measured(measured) if measured else [])]
    return "\n".join([introduction, *rows, ""])


def _format_gpu(gpu: Gpu) -> str:
    return f"{gpu.name} {gpu.bytes_per_s / 1e9:.0f} GB/s and {gpu.operations_per_s / 1e12:.1f} Top/s"


def _format_counts(work: dict[str, Work]) -> list[str]:
    names = [gpu.name for gpu in GPUS]
    lines = [
        f"| kernel | runs on | calls | MB | Mop | {' | '.join(f'{name}: roofline ms' for name in names)} |",
        f"|---|---|---|---|---|{'---|' * len(names)}",
    ]
    for name, one in sorted(work.items(), key=lambda item: -item[1].operations):
        where = "GPU" if name in kernels_on_gpu() else "*processor*"
        roofs = " | ".join(f"{_roofline_s(one, gpu) * 1e3:.3f}" for gpu in GPUS)
        lines.append(
            f"| `{name}` | {where} | {one.calls} | {one.bytes / 1e6:.1f} | {one.operations / 1e6:.0f} | {roofs} |"
        )
    for label, chosen in (("kernels on the GPU", kernels_on_gpu()), ("all kernels", tuple(work))):
        parts = [one for name, one in work.items() if name in chosen]
        size, operations = sum(one.bytes for one in parts), sum(one.operations for one in parts)
        roofs = " | ".join(f"{sum(_roofline_s(one, gpu) for one in parts) * 1e3:.3f}" for gpu in GPUS)
        calls = sum(one.calls for one in parts)
        lines.append(f"| {label} | | {calls} | {size / 1e6:.1f} | {operations / 1e6:.0f} | {roofs} |")
    size = sum(one.bytes for name, one in work.items() if name in kernels_on_gpu())
    transfers = " | ".join(f"{size / gpu.transfer_bytes_per_s * 1e3:.2f}" for gpu in GPUS)
    return [*lines, f"| transfer, ms | | | {size / 1e6:.1f} | | {transfers} |"]


def _roofline_s(work: Work, gpu: Gpu) -> float:
    return max(work.bytes / gpu.bytes_per_s, work.operations / gpu.operations_per_s)


def _format_measured(measured: Measured) -> list[str]:
    return [
        "",
        f"## Measured: {measured.name}",
        "",
        f"A frame takes {measured.frame_s * 1e3:.1f} ms, what runs on the processor included. "
        f"Of the pixels that both measure, {measured.far_share:.4%} are further than {_FAR_MM} mm from the "
        "processor's depth; "
        f"{measured.only_one_share:.4%} of all pixels are measured by one of both only.",
        "",
        "| kernel, with copies | ms |",
        "|---|---|",
        *(
            f"| `{name}` | {s * 1e3:.3f} |"
            for name, s in sorted(measured.call_s.items(), key=lambda x: -x[1])
        ),
        "",
        "| launches of | ms |",
        "|---|---|",
        *(
            f"| `{name}` | {s * 1e3:.3f} |"
            for name, s in sorted(measured.launch_s.items(), key=lambda x: -x[1])
        ),
    ]


def find_device(name: str) -> GpuDevice | None:
    """Return the device of this name; None for ``none``."""
    if name == "none":
        return None
    if name == "emulated":
        return EmulatedDevice()
    device = CudaDevice()
    device.name = f"{device.model}, driver {_driver_version()}"
    return device


def _driver_version() -> str:
    words = "nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"
    try:
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()[0]
    except (OSError, subprocess.SubprocessError, IndexError):
        return "of unknown version"


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png")
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="standard")
    parser.add_argument("--device", choices=("cuda", "emulated", "none"), default="none")
    parser.add_argument("--out", type=Path, default=_PAGE, help="the page (default: benchmarks/GPU.md)")
    arguments = parser.parse_args()
    device = find_device(arguments.device)
    work, _ = measure_frame(arguments.capture, arguments.rig, arguments.preset)
    rig = read_rig(arguments.rig)
    width, height = next(iter(rig.cameras.values())).size_px
    frame = f"{len(rig.cameras)} cameras of {width} × {height} px, preset `{arguments.preset}`"
    given = arguments.capture, arguments.rig, arguments.preset
    measured = measure_device(device, *given) if device else None
    arguments.out.write_text(format_page(frame, work, measured), "utf-8")
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    main()
