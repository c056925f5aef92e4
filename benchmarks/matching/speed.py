"""Speed of the matcher beside OpenCV: python benchmarks/matching/speed.py CAPTURE --rig rig.json.

Prints the ratios that the project holds itself to, each of two times taken in turn in this run:

1. a frame of ``standard`` over one bare SGBM call with 8 directions for each pair, two threads each (asked: 0.5)
2. a frame of ``fast`` over the same (asked: 0.12)
3. from outside, files included: ``beltscape reconstruct`` of a sequence, per frame, over reading the same images,
   rectifying and matching each pair by SGBM and writing its disparities; two cores each
4. the frames per second of ``beltscape reconstruct`` on two cores over those on one (asked: 1.9)

Wall time, so run it on a quiet machine; beside it stands the processor time, which load does not change much. The
sequence repeats the capture's frames under new names.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.sources.folder import FolderSource
from beltscape.stereo.multiview.depth_range import find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.pairwise.rectification import RectifiedPair, rectify_pair
from beltscape.stereo.settings import PRESETS, MultiviewSettings

ASKED = {"standard": 0.5, "fast": 0.12, "two cores": 1.9}
_THREADS = 2
_BLOCK, _SMALL, _LARGE = 5, 200, 800
"""SGBM's block and penalties: 8 and 32 times the block's area, as OpenCV's documentation proposes."""


class Spent(NamedTuple):
    """Wall and processor time, s."""

    wall_s: float
    cpu_s: float

    @classmethod
    def of(cls, work: Callable[[], object]) -> Spent:
        """Return the time of a call, its child processes' included."""
        start = time.perf_counter(), _read_cpu()
        work()
        return cls(time.perf_counter() - start[0], _read_cpu() - start[1])


def _read_cpu() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def match_pairs(pairs: Sequence[RectifiedPair], images: dict[str, Image], write: Path | None = None) -> None:
    """Rectify and match each pair, with the pairs in parallel threads."""

    def match(pair: RectifiedPair) -> None:
        left, right = rectify(pair, images)
        disparity = make_sgbm(pair).compute(left, right)
        if write is not None:
            cv2.imwrite(str(write / f"{pair.auxiliary}.tiff"), disparity)

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(match, pairs))


def rectify(pair: RectifiedPair, images: dict[str, Image]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return both grey images of a pair, rectified."""
    grey = [
        cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
        for image in (images[pair.core], images[pair.auxiliary])
    ]
    left = cv2.remap(grey[0], pair.core_map, None, cv2.INTER_LINEAR)
    right = cv2.remap(grey[1], pair.aux_map, None, cv2.INTER_LINEAR)
    return np.asarray(left, np.uint8), np.asarray(right, np.uint8)


def make_sgbm(pair: RectifiedPair) -> cv2.StereoSGBM:
    """Return OpenCV's matcher with 8 directions."""
    return cv2.StereoSGBM_create(0, pair.disparities, _BLOCK, _SMALL, _LARGE, mode=cv2.StereoSGBM_MODE_HH)


def alternate(works: dict[str, Callable[[], object]], runs: int) -> dict[str, Spent]:
    """Return the median times of calls that are made in turn, after one call of each."""
    for work in works.values():
        work()
    spent: dict[str, list[Spent]] = {name: [] for name in works}
    for _ in range(runs):
        for name, work in works.items():
            spent[name].append(Spent.of(work))
    return {
        name: Spent(*(statistics.median(part) for part in zip(*times, strict=True)))
        for name, times in spent.items()
    }


def compare_matchers(rig: Rig, source: FolderSource, runs: int) -> dict[str, Spent]:
    """Return the times of a frame by each preset, and of the bare SGBM calls, with two threads each."""
    frame_set = next(iter(source))
    near_far = find_depth_range(rig, frame_set, Silent())
    images = dict(frame_set.images)
    names = tuple(name for name in rig.auxiliaries if name in images)
    jobs = [(pair, *rectify(pair, images)) for pair in (rectify_pair(rig, n, near_far) for n in names)]

    def match_bare() -> None:
        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(lambda job: make_sgbm(job[0]).compute(job[1], job[2]), jobs))

    works: dict[str, Callable[[], object]] = {"bare SGBM": match_bare}
    for preset in PRESETS:
        settings = MultiviewSettings.preset(preset).model_copy(update={"threads": _THREADS})
        matcher = MultiviewReconstructor(rig, near_far, settings)
        works[preset] = lambda matcher=matcher: matcher.reconstruct(frame_set, Silent())
    return alternate(works, runs)


def compare_from_outside(rig: Rig, rig_file: Path, source: FolderSource, frames: int) -> dict[str, Spent]:
    """Return the times per frame of a sequence, files included: SGBM, and the program on two cores and on one."""
    near_far = find_depth_range(rig, next(iter(source)), Silent())
    pairs = [rectify_pair(rig, name, near_far) for name in rig.auxiliaries if name in source.cameras]
    with tempfile.TemporaryDirectory() as folder:
        capture, out = Path(folder) / "capture", Path(folder) / "out"
        repeat_frames(source.folder, source.cameras, capture, frames)

        def match_files() -> None:
            for frame in range(frames):
                target = Path(folder) / "sgbm" / f"{frame:03d}"
                target.mkdir(parents=True, exist_ok=True)
                files = {name: capture / name / f"{frame:03d}.png" for name in source.cameras}
                with ThreadPoolExecutor(_THREADS) as pool:
                    images = dict(zip(files, pool.map(read_image, files.values()), strict=True))
                match_pairs(pairs, images, target)

        spent = {"SGBM with files": Spent.of(match_files)}
        for cores in (2, 1):
            shutil.rmtree(out, ignore_errors=True)
            spent[f"reconstruct, {cores} cores"] = Spent.of(
                lambda cores=cores: reconstruct(capture, rig_file, out, cores)
            )
    return {name: Spent(one.wall_s / frames, one.cpu_s / frames) for name, one in spent.items()}


def repeat_frames(folder: Path, cameras: Sequence[str], capture: Path, frames: int) -> None:
    """Copy a capture's frames, from the first one again after the last, until there are enough."""
    files = read_capture(folder).files
    for name in cameras:
        (capture / name).mkdir(parents=True)
        images = list(files[name].values())
        for frame in range(frames):
            shutil.copyfile(images[frame % len(images)], capture / name / f"{frame:03d}.png")


def reconstruct(capture: Path, rig_file: Path, out: Path, cores: int) -> None:
    """Run the program on some of the cores."""
    program = [sys.executable, "-m", "beltscape", "reconstruct", str(capture), "--rig", str(rig_file)]
    allowed = sorted(os.sched_getaffinity(0))[:cores]
    subprocess.run(
        [*program, "--out", str(out)],
        check=True,
        capture_output=True,
        preexec_fn=lambda: os.sched_setaffinity(0, allowed),
    )


def main() -> None:
    """Print times and ratios."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png")
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--runs", type=int, default=5, help="frames of each matcher; the median counts")
    parser.add_argument("--frames", type=int, default=12, help="length of the sequence")
    arguments = parser.parse_args()
    cv2.setNumThreads(_THREADS)
    rig = read_rig(arguments.rig)
    sizes = {name: camera.size_px for name, camera in rig.cameras.items()}
    source = FolderSource(read_capture(arguments.capture), sizes, Silent())
    inside = compare_matchers(rig, source, arguments.runs)
    outside = compare_from_outside(rig, arguments.rig, source, arguments.frames)
    for name, spent in (inside | outside).items():
        print(f"{name:24s} {spent.wall_s:6.2f} s  {spent.cpu_s:6.2f} CPU s a frame")
    bare, files = inside["bare SGBM"], outside["SGBM with files"]
    two, one = outside["reconstruct, 2 cores"], outside["reconstruct, 1 cores"]
    for preset in PRESETS:
        spent = inside[preset]
        print(
            f"{preset} / bare SGBM: {spent.wall_s / bare.wall_s:.3f} (processor time {spent.cpu_s / bare.cpu_s:.3f}; "
            f"asked {ASKED[preset]})"
        )
    print(
        f"reconstruct / SGBM with files: {two.wall_s / files.wall_s:.3f} "
        f"(processor time {two.cpu_s / files.cpu_s:.3f})"
    )
    print(f"two cores / one core: {one.wall_s / two.wall_s:.2f} (asked {ASKED['two cores']})")


if __name__ == "__main__":
    main()
