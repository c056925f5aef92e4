"""Hypothesis strategies for cameras, poses and rigs."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.rig_limits import LEAST_BASELINE_MM

seeds = st.integers(0, 2**32 - 1)

ANGLES = (0.0, 1e-300, 1e-16, 1e-9, 1e-8, 1.1e-8, 1e-4, 1.0, np.pi - 1e-4, np.pi - 1e-9, np.pi - 1e-14, np.pi)
"""Rotation angles in radians where formulas like to break, and one where they do not."""


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_infinity=False, width=64)


def vectors(size: int, limit: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(floats(-limit, limit), min_size=size, max_size=size).map(np.array)


@st.composite
def rotation_vectors(draw) -> np.ndarray:
    """(3,) radians with an angle in [0, π], often one of ANGLES."""
    axis = draw(vectors(3, 1.0).filter(lambda v: np.linalg.norm(v) > 1e-3))
    angle = draw(st.one_of(st.sampled_from(ANGLES), floats(0.0, np.pi)))
    return axis / np.linalg.norm(axis) * angle


def poses(limit_mm: float = 5000.0) -> st.SearchStrategy[Pose]:
    return st.builds(Pose.of, rotation_vectors(), vectors(3, limit_mm))


@st.composite
def cameras(draw, name: str = "cam0") -> Camera:
    """Cameras with a lens one would measure with: distortion stays invertible over the image."""
    width, height = draw(st.integers(64, 4096)), draw(st.integers(64, 4096))
    focal = draw(floats(0.8, 4.0)) * max(width, height)
    return Camera(
        name=name,
        size_px=(width, height),
        focal_px=np.array([focal, focal * draw(floats(0.98, 1.02))]),
        center_px=np.array([width, height]) * (0.5 + draw(vectors(2, 0.03))),
        distortion=draw(vectors(5, 1.0)) * [0.15, 0.05, 2e-3, 2e-3, 0.03] + [0, 0.05, 0, 0, 0],
    )


@st.composite
def rigs(draw, minimum: int = 2, maximum: int = 5) -> Rig:
    """Rigs of any arrangement that a rig.json may hold; the first camera is the core."""
    names = [f"cam{i}" for i in range(draw(st.integers(minimum, maximum)))]
    placed = poses().filter(lambda pose: np.linalg.norm(pose.center_mm) > LEAST_BASELINE_MM)
    return Rig(
        core=names[0],
        cameras={name: draw(cameras(name)) for name in names},
        cam_from_core={name: Pose.identity() if name == names[0] else draw(placed) for name in names},
    )


@st.composite
def looking_rigs(draw, minimum: int = 2, maximum: int = 6) -> Rig:
    """Rigs whose cameras stand side by side and all see points about z = 1000 mm before the core."""
    names = [f"cam{i}" for i in range(draw(st.integers(minimum, maximum)))]
    rng = np.random.default_rng(draw(seeds))
    rig_cameras, poses = {}, {}
    for i, name in enumerate(names):
        width, height = (int(n) for n in rng.integers(200, 3000, 2))
        focal = rng.uniform(1.0, 4.0) * max(width, height)
        distortion = rng.uniform(-1, 1, 5) * [0.15, 0.05, 2e-3, 2e-3, 0.03] + [0, 0.05, 0, 0, 0]
        center = np.array([width, height]) / 2 + rng.uniform(-20, 20, 2)
        rig_cameras[name] = Camera(name, (width, height), np.full(2, focal), center, distortion)
        side = np.array([150.0 * ((i + 1) // 2) * (-1) ** i, 0.0, 0.0]) + rng.uniform(-40, 40, 3)
        turn = Pose.of(rng.uniform(-0.2, 0.2, 3), np.zeros(3)).rotation
        poses[name] = Pose(turn, -turn @ side) if i else Pose.identity()
    return Rig(names[0], rig_cameras, poses)
