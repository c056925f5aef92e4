"""Benchmark of triangulation: points per second by instruction set, beside OpenCV and the reference."""

from __future__ import annotations

import cv2
import numpy as np

from beltscape.kernels import load
from beltscape.kernels.native import levels
from timing import measure_seconds


def random_points(count: int, views: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Return projections (views, 3, 4) and pixels (views, count, 2) of random points."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform((-300, -300, 400), (300, 300, 1000), (count, 3)), np.ones(count)])
    poses = [np.column_stack([np.eye(3), rng.uniform(-300, 300, 3) * [1, 1, 0]]) for _ in range(views)]
    projections = np.diag([1160.0, 1160.0, 1.0]) @ np.stack(poses)
    pixels = np.einsum("cij,nj->cni", projections, points)
    return projections, np.ascontiguousarray(pixels[..., :2] / pixels[..., 2:])


def triangulation() -> list[str]:
    """Return the triangulated points per second by instruction set, OpenCV's two-view function and the reference."""
    projections, pixels = random_points(200_000)
    count = pixels.shape[1]
    two, first, second = pixels[:2], pixels[0].T.copy(), pixels[1].T.copy()
    base = measure_seconds(lambda: cv2.triangulatePoints(projections[0], projections[1], first, second))
    rows = [f"| OpenCV triangulatePoints, 2 views | {count / base / 1e6:.2f} | 1 |"]
    for level in levels():
        for views, data in ((2, two), (5, pixels)):
            for threads in (1, 2):
                t = measure_seconds(
                    lambda: load(level).triangulate(projections[: len(data)], data, threads=threads)  # noqa: B023
                )
                label = f"native {level}, {views} views, {threads} thread{'s' * (threads > 1)}"
                rows.append(f"| {label} | {count / t / 1e6:.1f} | {base / t:.0f} |")
    few = np.ascontiguousarray(pixels[:, :2000])
    t = (
        measure_seconds(lambda: load("reference").triangulate(projections, few), runs=3)
        * count
        / few.shape[1]
    )
    rows.append(f"| NumPy reference, 5 views | {count / t / 1e6:.3f} | {base / t:.3f} |")
    return ["| triangulation | M points/s | × OpenCV |", "|---|---|---|", *rows]
