"""A random point cloud, with normals that are not known for a third of its points."""

from __future__ import annotations

import numpy as np

from beltscape.core.cloud import PointCloud


def make_cloud(count: int, frame: str = "core") -> PointCloud:
    """Return a cloud of ``count`` points within 2.5 m of the origin."""
    rng = np.random.default_rng(count)
    normals = rng.normal(size=(count, 3)).astype(np.float32)
    normals[: count // 3] = np.nan
    return PointCloud(
        points_mm=rng.uniform(-2500, 2500, (count, 3)).astype(np.float32),
        normals=normals,
        colors=rng.integers(0, 256, (count, 3), dtype=np.uint8),
        sigma_mm=rng.uniform(0, 1, count).astype(np.float32),
        frame=frame,
        confidence=rng.uniform(0, 1, count).astype(np.float32),
    )
