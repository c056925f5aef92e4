"""Multi-camera association: from pairs to one rig about the core camera (the paper's Section 2.2.3)."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beltscape.calibrate.corners import Sightings
from beltscape.calibrate.pairs import Pair
from beltscape.core.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class PathError:
    """How far a measured pair and the way through the core camera disagree (ε_path, Eq. 16)."""

    pair: tuple[str, str]
    rotation_deg: float
    translation_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Every camera's pose about the core, and the way it was found on."""

    core: str
    cam_from_core: Mapping[str, Pose]
    paths: Mapping[str, tuple[str, ...]]
    """camera → the cameras from the core to it, both ends included."""
    pairs: tuple[Pair, ...]
    path_errors: tuple[PathError, ...]
    """For every pair that is not itself a step of a path."""


def groups(cameras: Iterable[str], pairs: Sequence[Pair]) -> list[tuple[str, ...]]:
    """Cameras that hang together through shared views, largest group first."""
    remaining = list(cameras)
    found: list[tuple[str, ...]] = []
    while remaining:
        reached = set(_costs(remaining[0], pairs)[0])
        found.append(tuple(name for name in remaining if name in reached))
        remaining = [name for name in remaining if name not in reached]
    return sorted(found, key=len, reverse=True)


def associate(core: str, pairs: Sequence[Pair]) -> Network:
    """Bring every camera that hangs together with the core into its frame, by the best path.

    The best path has the least summed variance of its pairs; where the core sees what a camera sees that is
    the direct one, otherwise one through other cameras (Eqs. 9-13).
    """
    _, previous = _costs(core, pairs)
    poses, paths = {core: Pose.identity()}, {core: (core,)}
    for name, before in previous.items():  # in the order they were reached: `before` is known
        poses[name] = _pose(pairs, before, name) @ poses[before]
        paths[name] = (*paths[before], name)
    steps = {frozenset(step) for step in previous.items()}
    errors = tuple(
        _path_error(pair, poses) for pair in pairs
        if frozenset((pair.first, pair.second)) not in steps and {pair.first, pair.second} <= poses.keys()
    )  # fmt: skip
    return Network(core, poses, paths, tuple(pairs), errors)


def choose_core(sightings: Sightings, pairs: Sequence[Pair]) -> str:
    """The most central camera among those that share the most views: the paper's best field of view.

    A camera counts when it shares at least 80 % of the corners that the best one shares with the others.
    """
    group = groups(sightings.cameras, pairs)[0]
    shared = {name: sum(p.corners for p in pairs if name in (p.first, p.second)) for name in group}
    eligible = [name for name in group if shared[name] >= 0.8 * max(shared.values())]
    centers = {name: pose.center_mm for name, pose in associate(group[0], pairs).cam_from_core.items()}
    spread = {
        name: round(sum(float(np.linalg.norm(centers[name] - other)) for other in centers.values()), 3)
        for name in eligible
    }
    return min(eligible, key=lambda name: spread[name])


def _costs(core: str, pairs: Sequence[Pair]) -> tuple[dict[str, float], dict[str, str]]:
    """Dijkstra from the core: cost to each camera, and the camera before it, in the order reached."""
    costs: dict[str, float] = {}
    previous: dict[str, str] = {}
    queue = [(0.0, core, core)]
    while queue:
        cost, name, before = heapq.heappop(queue)
        if name in costs:
            continue
        costs[name] = cost
        if name != core:
            previous[name] = before
        for pair in pairs:
            if name in (pair.first, pair.second):
                other = pair.second if name == pair.first else pair.first
                heapq.heappush(queue, (cost + pair.variance, other, name))
    return costs, previous


def _pose(pairs: Sequence[Pair], origin: str, to: str) -> Pose:
    """``to_from_origin`` of the pair between two cameras."""
    for pair in pairs:
        if (pair.first, pair.second) == (origin, to):
            return pair.second_from_first
        if (pair.first, pair.second) == (to, origin):
            return pair.second_from_first.inverse()
    raise KeyError((origin, to))


def _path_error(pair: Pair, poses: Mapping[str, Pose]) -> PathError:
    through_core = poses[pair.second] @ poses[pair.first].inverse()
    difference = through_core.inverse() @ pair.second_from_first
    centers = through_core.center_mm - pair.second_from_first.center_mm
    return PathError((pair.first, pair.second), difference.angle_deg, float(np.linalg.norm(centers)))
