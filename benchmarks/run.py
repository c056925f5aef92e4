"""Accuracy and speed beside each other, as ratios against OpenCV in the same run; writes RESULTS.md.

    python benchmarks/run.py [RENDERED]

RENDERED is a folder of rendered captures with truth (default: ../shared/data/rendered beside the repository);
without one the capture that ships with the demo is used.
"""

from __future__ import annotations

import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from beltscape.core.progress import Silent
from beltscape.evaluate.depth import score_depth
from beltscape.kernels import load
from beltscape.kernels.native import levels
from beltscape.measure.settings import VolumeSettings
from beltscape.measure.volume import measure_volume
from beltscape.stereo.pairwise import PairwiseReconstructor, horizontal_auxiliary
from beltscape.stereo.rectify import rectify_pair
from beltscape.stereo.search import find_depth_range
from beltscape.stereo.settings import PairwiseSettings
from calibration import calibration
from captures import Scene, demo_scenes, rendered_scenes

HERE = Path(__file__).parent


def seconds(work: Callable[[], object], runs: int = 5) -> float:
    """Median wall time of several runs after a warm-up."""
    work()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def triangulation() -> list[str]:
    """Points per second of every kernel level, against OpenCV's two-view one and the reference."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-300, 300, (200_000, 3)) + np.array([0, 0, 700])
    poses = [np.column_stack([np.eye(3), rng.uniform(-300, 300, 3) * [1, 1, 0]]) for _ in range(5)]
    projections = np.diag([1160.0, 1160.0, 1.0]) @ np.stack(poses)
    pixels = np.einsum("cij,nj->cni", projections, np.column_stack([points, np.ones(len(points))]))
    pixels = np.ascontiguousarray(pixels[..., :2] / pixels[..., 2:])
    two, first, second = pixels[:2], pixels[0].T.copy(), pixels[1].T.copy()
    base = seconds(lambda: cv2.triangulatePoints(projections[0], projections[1], first, second))
    rows = [f"| OpenCV triangulatePoints, 2 views | {len(points) / base / 1e6:.2f} | 1 |"]
    for level in levels():
        kernels = load(level)
        for views, data in ((2, two), (5, pixels)):
            for threads in (1, 2):
                t = seconds(lambda: kernels.triangulate(projections[: len(data)], data, threads=threads))  # noqa: B023
                label = f"native {level}, {views} views, {threads} thread{'s' * (threads > 1)}"
                rows.append(f"| {label} | {len(points) / t / 1e6:.1f} | {base / t:.0f} |")
    few = np.ascontiguousarray(pixels[:, :2000])
    t = seconds(lambda: load("reference").triangulate(projections, few), runs=3) * len(points) / few.shape[1]
    rows.append(f"| NumPy reference, 5 views | {len(points) / t / 1e6:.3f} | {base / t:.3f} |")
    return ["| triangulation | M points/s | × OpenCV |", "|---|---|---|", *rows]


def bare_sgbm(scene: Scene, depth_range_mm: tuple[float, float]) -> float:
    """Seconds of one OpenCV SGBM call per pair on the same rectified images, nothing else: the yardstick."""
    jobs = []
    for name in scene.rig.auxiliaries:
        pair = rectify_pair(scene.rig, name, depth_range_mm)
        left = cv2.remap(scene.frame.images[scene.rig.core], pair.core_map, None, cv2.INTER_LINEAR)
        right = cv2.remap(scene.frame.images[name], pair.aux_map, None, cv2.INTER_LINEAR)
        grey = [cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) if i.ndim == 3 else i for i in (left, right)]
        jobs.append((cv2.StereoSGBM_create(0, pair.disparities, 5, 200, 800), *grey))
    return seconds(lambda: [matcher.compute(left, right) for matcher, left, right in jobs], runs=3)


def whole_frames(scenes: list[Scene]) -> list[str]:
    """Accuracy and time of each method on each scene, and the volume of the loaded ones."""
    rows = [
        "| scene | size | method | < 1 mm | < 0.25 mm | median mm | gross | measured | actual/predicted σ | s "
        "| × SGBM |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    volumes = [
        "| volume | size | measured l | σ l | true l | error | coverage |",
        "|---|---|---|---|---|---|---|",
    ]
    empties = {}
    settings = PairwiseSettings()
    for scene in scenes:
        near_far = find_depth_range(scene.rig, scene.frame, Silent())
        base = bare_sgbm(scene, near_far)
        for method in ("pairwise", "binocular"):
            names = scene.rig.auxiliaries if method == "pairwise" else (horizontal_auxiliary(scene.rig),)
            matcher = PairwiseReconstructor(scene.rig, near_far, settings, auxiliaries=names)
            depth = matcher.reconstruct(scene.frame, Silent())
            took = seconds(lambda: matcher.reconstruct(scene.frame, Silent()), runs=3)  # noqa: B023
            s = score_depth(depth, scene.true_depth_mm, scene.region)
            rows.append(
                f"| {scene.name} | {scene.size} | {method} | {s.within_1mm:.2%} | {s.within_quarter_mm:.2%} | "
                f"{s.interior_median_mm:.4f} | {s.gross:.2%} | {s.coverage:.2%} | {s.sigma_ratio:.2f} | "
                f"{took:.2f} | {took / base:.2f} |"
            )
            if method == "pairwise" and scene.true_volume_mm3 is None:
                empties[scene.size] = depth
            elif method == "pairwise":
                v = measure_volume(
                    depth, empties[scene.size], scene.rig.core_camera, VolumeSettings(),
                    across_mm=None, along_mm=scene.along_mm,
                )  # fmt: skip
                volumes.append(
                    f"| {scene.name} | {scene.size} | {v.volume_mm3 / 1e6:.3f} | {v.sigma_mm3 / 1e6:.3f} | "
                    f"{scene.true_volume_mm3 / 1e6:.3f} | {v.volume_mm3 / scene.true_volume_mm3 - 1:+.2%} | "
                    f"{v.coverage:.1%} |"
                )
    return [*rows, "", *volumes]


def main() -> None:
    """Run everything and write RESULTS.md."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parents[1] / "shared" / "data" / "rendered"
    scenes = rendered_scenes(folder) if folder.is_dir() else demo_scenes()
    lines = [
        "# Results",
        "",
        f"`make bench` on {os.cpu_count()} cores ({platform.machine()}, kernels {levels()[-1]}), "
        f"OpenCV {cv2.__version__}. "
        "Rigs exact. Depth: share of *all* true pixels; median, σ: more than 6 px from a true step; halved images: "
        "without the pixels astride a step, whose true depth is two. "
        "× SGBM: time over that of one bare OpenCV SGBM call per pair on the same images in the same run.",
        "",
        *triangulation(),
        "",
        *calibration(folder),
        "",
        *whole_frames(scenes),
        "",
    ]
    (HERE / "RESULTS.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
