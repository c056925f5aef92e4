"""Benchmark of the live system: frame sets per second from image files to stored records."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.files.rig_json import write_rig
from timing import memory_mb

NOTES = """`beltscape replay --speed full` of the rendered moving belt, five cameras: image files read, depth, flow, a
record with its cross-section on disk (synchronous) for each frame set. Steady: without the program's start and the
first frame set, from the difference of two runs, of one and of all rounds. Beside: the time in which four
cv2.StereoSGBM pairs of the same size (HH, 128 disparities) are done on the same machine."""
_PRESETS = ("fast", "standard")
_ROUNDS = 3
_POLL_S = 0.1
"""Interval between readings of a program's memory."""


@dataclass(frozen=True)
class Cost:
    """Cost of one replay."""

    seconds: float
    cpu_s: float
    peak_gib: float
    """Of the process that measures."""
    records: int
    own_cpu_s: float
    """CPU time of the process that orders and measures, without its workers'."""
    latency: Mapping[str, Mapping[str, float | None]]
    """By key of the program's result: see `beltscape.service.view_models.LatencyMeter`."""


def live(rendered: Path, rig: Rig) -> list[str]:
    """Return a Markdown table; the reason if the capture is missing."""
    capture = rendered / "belt_moving"
    if not capture.is_dir():
        return ["Not run: the rendered moving belt is not available."]
    lines = [
        NOTES,
        "",
        "| size | preset | sets/s | CPU s a set | × 4 SGBM | peak GiB |",
        "|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        plant = Path(folder)
        for width in (612, 1224):
            images, empty = make_plant(rendered, rig, plant, width)
            pairs = _four_pairs_s(images)
            lines += [_row(images, empty, width, preset, pairs) for preset in _PRESETS]
    return lines


def make_plant(rendered: Path, rig: Rig, plant: Path, width: int) -> tuple[Path, Path]:
    """Write the moving belt at an image width and reconstruct the empty one; return both folders."""
    images = _scale_capture(rendered / "belt_moving", plant / f"capture{width}", width)
    return images, _reconstruct_empty(rendered / "belt_empty", plant / f"empty{width}", width, rig)


def _row(capture: Path, empty: Path, width: int, preset: str, pairs_s: float) -> str:
    once, often = (replay(capture, empty, preset, rounds) for rounds in (1, _ROUNDS))
    sets = often.records - once.records
    seconds, cpu = (often.seconds - once.seconds) / sets, (often.cpu_s - once.cpu_s) / sets
    figures = f"{1 / seconds:.2f} | {cpu:.3f} | {seconds / pairs_s:.2f} | {often.peak_gib:.2f}"
    return f"| {width} px | {preset} | {figures} |"


def replay(
    capture: Path,
    empty: Path,
    preset: str,
    rounds: int,
    workers: int | str = "auto",
    sets_per_s: float | None = None,
    cores: int | None = None,
) -> Cost:
    """Run the program over ``rounds`` repetitions of the capture and return its cost.

    ``sets_per_s`` is the rate at which frame sets come; None: each as soon as there is room for it. All processes
    together get ``cores`` of this process's cores; None: all of them.
    """
    plant = empty.parent
    listed = _rounds(capture, plant / f"{capture.name}x{rounds}", rounds)
    if sets_per_s is not None:
        listed = pace_capture(listed, plant / f"{listed.name}-{sets_per_s:.3g}", sets_per_s)
    project = plant / f"{listed.name}-{preset}-{workers}.toml"
    project.write_text(
        f'rig = "{empty / "rig.json"}"\nempty = "{empty}"\n[capture]\nfolder = "{listed}"\n'
        f'[encoder]\nkind = "capture"\n[matching]\npreset = "{preset}"\nworkers = {json.dumps(workers)}\n'
        "[watch]\nlumps_every_s = 0\nedges_every_s = 0\n",
        encoding="utf-8",
    )
    began = perf_counter()
    out = plant / f"{project.stem}.out"
    speed = "full" if sets_per_s is None else "real"
    words = [sys.executable, "-m", "beltscape", "replay", str(project), "--out", str(out), "--json"]
    words += ["--speed", speed]
    before, peak_mb, own_s = os.times(), 0.0, 0.0  # os.wait4 would return at least our own peak
    with _begin(words, cores) as program:
        output = None
        while output is None:
            peak_mb = max(peak_mb, memory_mb("VmHWM", program.pid))
            own_s = max(own_s, _read_cpu_s(program.pid))
            with suppress(subprocess.TimeoutExpired):
                output, _ = program.communicate(timeout=_POLL_S)
    if program.returncode:
        raise RuntimeError(f"{' '.join(words)}: ended with {program.returncode}")
    seconds, after = perf_counter() - began, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    result = json.loads(output)
    latency = {name: result[name] for name in ("latency_of_frames", "latency_after_view", "latency")}
    return Cost(seconds, cpu, peak_mb * 1000 / 2**20, result["records"], own_s, latency)


def _begin(words: Sequence[str], cores: int | None) -> subprocess.Popen[str]:
    """Begin a program on some or all of this process's cores, which its own processes inherit."""
    usable = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(usable)[:cores])
    try:
        return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    finally:
        os.sched_setaffinity(0, usable)


def _read_cpu_s(process: int) -> float:
    """Return the CPU time that a process has taken so far; 0 after its end."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _rounds(capture: Path, folder: Path, rounds: int) -> Path:
    """Write and return a capture that repeats another; the belt position continues."""
    frames = read_capture(capture)
    if folder.is_dir():
        return folder
    rows = [line.split(",") for line in (capture / "encoder.csv").read_text().splitlines()[1:]]
    last, steps = [float(rows[-1][k]) - float(rows[0][k]) for k in (1, 2)], len(rows) - 1
    table = ["frame,timestamp_s,belt_position_mm"]
    for around in range(rounds):
        for name, time_s, position_mm in rows:
            shift = [around * part * (steps + 1) / steps for part in last]
            frame = f"{around}{Path(name).stem}"
            table.append(f"{frame},{float(time_s) + shift[0]},{float(position_mm) + shift[1]}")
            for camera, files in frames.files.items():
                target = folder / camera / f"{frame}{files[Path(name).stem].suffix}"
                target.parent.mkdir(parents=True, exist_ok=True)
                os.link(files[Path(name).stem], target)
    (folder / "encoder.csv").write_text("\n".join(table) + "\n", encoding="utf-8")
    return folder


def pace_capture(capture: Path, folder: Path, sets_per_s: float) -> Path:
    """Write and return the capture with other times: frame sets at an even rate, at the same places of the belt."""
    if not folder.is_dir():
        shutil.copytree(capture, folder, copy_function=os.link)
    table = (capture / "encoder.csv").read_text().splitlines()
    rows = [line.split(",") for line in table[1:]]
    lines = [f"{name},{k / sets_per_s},{place}" for k, (name, _, place) in enumerate(rows)]
    (folder / "encoder.csv").unlink()  # a link to the capture's own
    (folder / "encoder.csv").write_text("\n".join([table[0], *lines]) + "\n", encoding="utf-8")
    return folder


def _scale_capture(capture: Path, folder: Path, width: int) -> Path:
    """Write and return the capture with images of the given width."""
    for camera, files in read_capture(capture).files.items():
        (folder / camera).mkdir(parents=True)
        for frame, file in files.items():
            image = read_image(file)
            height = round(image.shape[0] * width / image.shape[1])
            small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
            cv2.imwrite(str(folder / camera / f"{frame}.png"), small if small.ndim == 2 else small[..., ::-1])
    for table in capture.glob("encoder.csv"):
        shutil.copy(table, folder)
    return folder


def _reconstruct_empty(capture: Path, folder: Path, width: int, rig: Rig) -> Path:
    """Reconstruct the empty belt at the given size and return its folder."""
    images = _scale_capture(capture, folder / "images", width)
    write_rig(folder / "rig.json", scale_rig(rig, width / rig.core_camera.size_px[0]))
    words = [sys.executable, "-m", "beltscape", "reconstruct", str(images), "--rig", str(folder / "rig.json")]
    subprocess.run([*words, "--out", str(folder / "out"), "--json"], check=True, capture_output=True)
    return folder / "out"


def _four_pairs_s(capture: Path) -> float:
    """Return the seconds for four pairs of OpenCV's matcher, the best of three runs."""
    cameras = read_capture(capture)
    images = [read_image(next(iter(files.values()))) for files in cameras.files.values()]
    grey = [
        (image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)).astype(np.uint8, copy=False)
        for image in images
    ]
    matcher = cv2.StereoSGBM.create(0, 128, 5, 8 * 25, 32 * 25, mode=cv2.StereoSGBM_MODE_HH)
    times = []
    for _ in range(3):
        began = perf_counter()
        for other in grey[1:]:
            matcher.compute(grey[0], other)
        times.append(perf_counter() - began)
    return min(times)
