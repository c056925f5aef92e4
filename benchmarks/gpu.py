"""The CUDA back end on a frame: python benchmarks/gpu.py CAPTURE --rig rig.json [--preset standard] [--device cuda].

Writes benchmarks/GPU.md. Of every kernel of the frame stand the bytes of its arrays in and out, its operations
(`matching.operations`), and the roofline of three graphics processors: the longer of bytes / bandwidth and operations
/ peak, as `roofline` has it for the processor; and what a frame copies between processor and GPU (`gpu_traffic`).
Where a GPU is there, `gpu_measure` measures the frame, its calls and launches, frames in flight, energy, memory and
other matchers, and the share of pixels in which the depth map differs from the processor's by more than 0.001 mm;
with ``--scales 1 2`` also of images of twice the size. ``--device emulated`` does the same on the emulated GPU, whose
times mean nothing.
"""

from __future__ import annotations

import argparse
import subprocess
from dataclasses import dataclass
from pathlib import Path

from beltscape.kernels import kernels_on_gpu
from beltscape.kernels.cuda.cuda_device import CudaDevice
from beltscape.kernels.cuda.device import GpuDevice
from beltscape.kernels.cuda.emulated_device import EmulatedDevice
from beltscape.stereo.settings import PRESETS
from gpu_measure import (
    FAR_MM,
    FrameTraffic,
    Measured,
    count_traffic,
    measure_device,
    read_problem,
)
from gpu_peers import format_rows
from roofline import Work

_PAGE = Path(__file__).with_name("GPU.md")


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
    Gpu("H200 SXM", 4.8e12, 66.9e12, 63e9),
    Gpu("H100 SXM", 3.35e12, 66.9e12, 63e9),
    Gpu("RTX 4070", 504e9, 29.1e12, 31.5e9),
    Gpu("Jetson AGX Orin", 204.8e9, 5.3e12, 204.8e9),
)


_INTRODUCTION = """\
# Graphics processors

{state} `benchmarks/gpu.py` writes this page; `benchmarks/gpu.sh` builds, tests and measures on a GPU.

NVRTC compiles every kernel for sm_75, 80, 86, 89, 90 and 100, and the emulation runs the same source on the processor
in the tests. Its kernels of matching give the bytes of the levels v3 and v4; where the processor has OpenCV and NumPy
between them, the GPU's own kernels round their last digits otherwise. Emulated, five images of 306 × 256 px
(`standard`, the demo's) are measured at the same pixels, and 0.05 % of the depths are further than 0.001 mm from the
processor's, at most 0.06 mm.

## What one frame asks for: {frame}

MB are the arrays in and out of the kernels, each once; a kernel that keeps intermediate results in memory moves more.
Roofline: the longer of MB / bandwidth and operations / peak of the maker's data sheet ({gpus}).
It is what no implementation can beat, not what this one will reach.
"""
_TRANSFER = """
## Transfer between the memories of processor and GPU

A frame's images go up as the cameras gave them, in 8 or 16 bits, and are not read on the processor; its depth, σ,
confidence and number of views come down. Besides, some bands of rows come down for the estimates of noise, and the
planes in which textureless discs are looked for. Small arrays such as weights stay on the GPU from frame to frame.
"""
_GRAPHS = """
## Graphs

A frame's launches are recorded at the first frame of a size and then run as graphs, nearly all of them. Emulated, the
1029 launches of three images of 48 × 36 px on two grids (`standard`) are 13 graphs and 1 launch, the 556 on one grid
(`fast`) 9 graphs and 1. Numbers that differ from frame to frame, such as the noise, are read from memory.

Launching a graph costs 5 to 10 µs, so 13 of them take 0.07 to 0.13 ms of a frame. Boundaries stay where the
processor decides something in between:

- **Whether the core is out of focus, and whether the images are demosaiced**, by four numbers that come down
  together. Where the core is in focus, which is nearly always so, the graph has placed the images, too.
- **Whether a round of propagation is the last**, by one number, on each grid. A graph runs all its launches; where
  hardly a pixel changes, the rounds after it are spared, some 60 launches each.
- **Where textureless discs are**, from a mask of bytes: connected regions, and a robust fit in double precision for
  each of the few. It runs beside the selection of candidates.
- **How long three lists of uncertain pixels are**, by one number each. They are sizes of arrays. At their bound, all
  pixels of the image, the refinement's list alone would take 560 bytes a pixel, 2.8 GB for 2448 × 2048 px, in every
  frame in flight. The second of them is known before the last iteration of least squares ends, so no frame waits.
- **The excess of correlated noise**, from the sums of some 500 tiles: groups by quantiles in double precision.
- **The planes of a sweep over a wide range**, from coarse matches: their number is a size of arrays. Only where more
  than 96 planes would be swept.

Halving, the sweep and the first round on the coarsest grid are one graph. Two boundaries are left that decide
nothing: on the finest grid the image features run beside the rounds on the processor, so that the enlarged surface,
the features and the first round are three functions. Joining them would save 0.02 ms of launches. Lists are
lengthened by at most an eighth, so that frames with nearly as many uncertain pixels run the same graphs; another
length is recorded once.

Every frame in flight has graphs of its own, whose arrays keep their addresses: a frame of `standard` takes about 1400
bytes a pixel instead of 980 (emulated, 3 × 48 × 36 px), and every further length of a list some 110. Where memory is
short, the graphs that were not used for longest go, and then all.

## What the roofline leaves out

- **The processor's own part of a frame**: it finds the graphs by what they are given, launches them and waits for the
  decisions. In Python this takes 3.6 ms of one core (emulated, launches taken out, five images of 48 × 36 px), partly
  while the GPU computes; with one frame at a time 4 ms need a fast core. Python's lock lets one thread at a time do
  it, so a process matches at most some 250 frames a second however fast its GPU is; worker processes do it side by
  side.
- **Images of colours**: the processor mixes their channels, and they go up as floats. Levels, gains, noise, sharpness
  and the test for demosaicing of grey images are computed on the GPU; on the processor they take 10 ms of one core
  for five images of 1224 × 1024 px (15 ms before they had kernels of their own).
- **Copies from memory that is not pinned**: the rates above are those of the bus.
- **Small launches**: 1030 launches of at least 1 to 2 µs each are 1 to 2 ms where the images are small.

## Several frames, several processes

Frames in flight in one process have streams and graphs of their own and give the bytes of a frame alone; results of
one frame are never overwritten by another (`tests/kernels/test_graphs.py`). A process opens the GPU when it first
matches and takes at most 80 % of what is free then. A second process does the same: each has a context, kernels that
it compiled itself (3 s) and graphs. The live system matches on up to four such workers (`matching.workers = "auto"`);
the process that measures opens none: its kernels run on the processor. The driver runs the processes' launches in
turn. A process that finds no memory gives its free memory back and drops its graphs; if that is not enough, its
processor takes over with the alarm `gpu_lost`, and the other processes go on.
"""
_BESIDE = """
## What is measured beside it

Four SGBM of OpenCV on the processor, and OpenCV's CUDA SGM on the GPU, on the same rectified pairs in the same run.
OpenCV's CUDA SGM has the kernels of libSGM (fixstars). Neither has a wheel: OpenCV's wheels are built without CUDA,
libSGM needs nvcc, and the registry's `libsgm` is another program, CNES's for Pandora, on the processor. So `gpu.sh`
measures it in an environment (`VENV`) whose OpenCV was built with CUDA, and else names the reason below the table.
"""


def format_page(frame: str, traffic: FrameTraffic, measured: list[Measured]) -> str:
    """Return the page: the state, the counts with their rooflines, the copies, and what was measured."""
    not_run = "**Compiled and emulated, not run**: no GPU was at hand when this page was written."
    state = f"Measured on {measured[0].name}." if measured else not_run
    gpus = ", ".join(_format_gpu(gpu) for gpu in GPUS)
    introduction = _INTRODUCTION.format(state=state, frame=frame, gpus=gpus)
    rows = [*_format_counts(traffic.work), _TRANSFER, *_format_traffic(traffic), _GRAPHS, _BESIDE]
    rows += [line for one in measured for line in _format_measured(one)]
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
    return lines


def _format_traffic(traffic: FrameTraffic) -> list[str]:
    lines = [
        f"| a frame copies | MB | {' | '.join(f'{gpu.name}: ms' for gpu in GPUS)} |",
        f"|---|---|{'---|' * len(GPUS)}",
    ]
    rows = {
        "where each call copies its arrays": traffic.each_call,
        "to the GPU": traffic.up,
        "to the processor": traffic.down,
        "both": traffic.up + traffic.down,
    }
    for label, size in rows.items():
        times = " | ".join(f"{size / gpu.transfer_bytes_per_s * 1e3:.2f}" for gpu in GPUS)
        lines.append(f"| {label} | {size / 1e6:.1f} | {times} |")
    return lines


def _roofline_s(work: Work, gpu: Gpu) -> float:
    return max(work.bytes / gpu.bytes_per_s, work.operations / gpu.operations_per_s)


def _format_measured(measured: Measured) -> list[str]:
    repeatable = "the same bytes" if measured.is_repeatable else "**different bytes**"
    energy = "" if measured.joules is None else f"It takes {measured.joules:.2f} J of the GPU. "
    return [
        "",
        f"## Measured on {measured.name}: {measured.frame}",
        "",
        f"A frame takes {measured.frame_s * 1e3:.1f} ms, what runs on the processor included, and at most "
        f"{measured.peak_bytes / 1e6:.0f} MB of memory; it runs {measured.graphs:.0f} graphs. "
        f"{energy}All runs gave {repeatable}. "
        f"Of the pixels that both measure, {measured.far_share:.4%} are further than {FAR_MM} mm from the "
        "processor's depth; "
        f"{measured.only_one_share:.4%} of all pixels are measured by one of both only.",
        "",
        "| frames in flight | frames/s |",
        "|---|---|",
        *(f"| {count} | {rate:.1f} |" for count, rate in measured.sets_per_s.items()),
        "",
        *format_rows(measured.rows),
        *_format_missing(measured),
        *_format_calls(measured),
        *_format_times("launches of", measured.launch_s),
    ]


def _format_missing(measured: Measured) -> list[str]:
    if not measured.missing:
        return []
    return ["", f"OpenCV's CUDA SGM, which has libSGM's kernels, is not beside them: {measured.missing}."]


def _format_calls(measured: Measured) -> list[str]:
    """Return the time of each kernel's calls, and the share of its roofline that they reach."""
    gpu = find_gpu(measured.name)
    lines = ["", "| call of | ms | share of its roofline |", "|---|---|---|"]
    for name, s in sorted(measured.call_s.items(), key=lambda item: -item[1]):
        share = f"{_roofline_s(measured.work[name], gpu) / s:.1%}" if gpu and name in measured.work else "–"
        lines.append(f"| `{name}` | {s * 1e3:.3f} | {share} |")
    return lines


def find_gpu(name: str) -> Gpu | None:
    """Return the data sheet of a device by the name that its driver gives; None where it is not listed."""
    return next(
        (gpu for gpu in GPUS if all(word in name for word in gpu.name.split()[:2] if word != "SXM")), None
    )


def _format_times(what: str, seconds: dict[str, float]) -> list[str]:
    rows = sorted(seconds.items(), key=lambda item: -item[1])
    return ["", f"| {what} | ms |", "|---|---|", *(f"| `{name}` | {s * 1e3:.3f} |" for name, s in rows)]


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
    parser.add_argument(
        "--scales",
        type=float,
        nargs="+",
        default=[1.0],
        help="of the images that are measured; the first is counted (1)",
    )
    parser.add_argument("--out", type=Path, default=_PAGE, help="the page (default: benchmarks/GPU.md)")
    arguments = parser.parse_args()
    device = find_device(arguments.device)
    given = arguments.capture, arguments.rig, arguments.preset
    problem = read_problem(*given, arguments.scales[0])
    frame, traffic = f"{problem}, preset `{arguments.preset}`", count_traffic(problem)
    measured: list[Measured] = []
    for scale in arguments.scales:
        if device:
            measured.append(measure_device(device, read_problem(*given, scale)))
        arguments.out.write_text(format_page(frame, traffic, measured), "utf-8")  # the next one may not end
        print(f"wrote {arguments.out}: {len(measured)} of {len(arguments.scales)} sizes measured")
        if not device:
            return


if __name__ == "__main__":
    main()
