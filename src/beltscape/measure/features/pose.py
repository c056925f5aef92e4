"""The pose of a module: recognised without a prior pose, then refined to a tenth of a millimetre.

The planes of a depth map are candidates for the upper face of the base. Heights over each plane are correlated over
rotations and shifts; the points are then registered to the nominal surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.measure.belt.initial_frame import BlockPlanes, fit_block_planes
from beltscape.measure.features.solids import ConvexBody, build_solids
from beltscape.target.module import Module

_NEAR_MM, _TILT_RAD = 1.0, np.deg2rad(2.0)
"""Largest distance and inclination of a block that belongs to a plane."""
_FINE_PX = 16
"""Edge of a block at an image width of ``_FINE_OF_PX``, narrower than the gaps between features."""
_FINE_OF_PX = 1224
"""Image width for which ``_FINE_PX`` is given: that of the rendered captures."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidatePlane:
    """A plane of points p in the core's frame with normal · p = offset."""

    normal: NDArray[np.float64]
    """(3,) unit, towards the camera."""
    offset_mm: float
    area_mm2: float
    """Area of its blocks, as projected into the camera."""


def find_candidate_planes(depth: DepthMap, camera: Camera, most: int) -> list[CandidatePlane]:
    """Find up to ``most`` planes one after another, each from the blocks that earlier planes left."""
    side = max(8, round(_FINE_PX * camera.size_px[0] / _FINE_OF_PX))
    blocks = fit_block_planes(depth, camera, side)
    blocks = blocks.select(
        blocks.rms_mm
        <= max(4 * _median_or_zero(blocks.rms_mm), 1e-5 * _median_or_zero(blocks.centers_mm[:, 2]))
    )
    found: list[CandidatePlane] = []
    while len(found) < most and len(blocks.normals) >= 6:
        normal, offset, members = _find_largest_plane(blocks)
        if members.sum() < 6:
            break
        area = float(np.sum((side * blocks.centers_mm[members, 2]) ** 2) / np.prod(camera.focal_px))
        found.append(CandidatePlane(normal, offset, area))
        blocks = blocks.select(~members)
    return found


def _find_largest_plane(blocks: BlockPlanes) -> tuple[NDArray[np.float64], float, NDArray[np.bool_]]:
    """Return the plane with most blocks: normal, offset mm, and which blocks lie on it."""
    normals, centers = blocks.normals, blocks.centers_mm
    tries = np.unique(np.linspace(0, len(normals) - 1, 400).astype(int))
    counts = [int(_member_mask(blocks, normals[i], float(normals[i] @ centers[i])).sum()) for i in tries]
    best = tries[int(np.argmax(counts))]
    normal, offset = normals[best], float(normals[best] @ centers[best])
    members = _member_mask(blocks, normal, offset)
    for _ in range(4):
        if members.sum() < 6:
            break
        middle = centers[members].mean(axis=0)
        local = centers[members] - middle
        normal = np.linalg.eigh(local.T @ local)[1][:, 0]
        normal *= -np.sign(normal @ middle)
        offset = float(normal @ middle)
        members = _member_mask(blocks, normal, offset)
    return normal, offset, members


def _member_mask(blocks: BlockPlanes, normal: NDArray[np.float64], offset_mm: float) -> NDArray[np.bool_]:
    return (np.abs(blocks.centers_mm @ normal - offset_mm) < _NEAR_MM) & (
        blocks.normals @ normal > np.cos(_TILT_RAD)
    )


def _median_or_zero(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else 0.0


_PLANES = 8
"""Largest planes of the depth map that are tried as the base."""
_COARSE = 40
"""Cells along the base's diagonal, and rotations per half turn, in the search over all planes."""
_FINE = 80
"""Cells along the base's diagonal in the search around the best rotation."""
_LEVEL_MM = 6.0
"""Height of a level; heights of one level count as equal."""
_SAMPLES = 150_000
"""Largest number of pixels used for the height maps."""
_MISMATCH_PENALTY = 0.6
"""Penalty for a cell with a wrong height, relative to one with the right height."""
_CLEAR_AGREEMENT = 0.6
"""Above this agreement no other plane is tried."""
_MIN_AGREEMENT = 0.5
"""Below this agreement the module counts as not found."""


@dataclass(frozen=True, slots=True, eq=False)
class ModuleMatch:
    """A candidate pose of a module."""

    core_from_module: Pose
    turn_rad: float
    """Rotation about the plane's normal."""
    agreement: float
    """Share of the module's cells with the right height, less the penalty for wrong heights; at most 1."""


def find_module(depth: DepthMap, camera: Camera, module: Module) -> ModuleMatch:
    """Return the best match over the depth map's planes, within a few mm and a few degrees.

    The height map over a candidate plane of the base's upper face is quantised into levels. The levels of the
    nominal module, rotated in steps, are correlated with them by FFT, for all shifts at once. The features on a
    symmetric base resolve its symmetry.

    Raises
    ------
    MeasureError
        if the module is not found on any plane.
    """
    planes = find_candidate_planes(depth, camera, _PLANES)
    if not planes:
        raise MeasureError(
            f"{module.name}: the frame shows no plane at all; give a frame that shows the module"
        )
    step = max(int(np.sqrt(depth.measured.sum() / _SAMPLES)), 1)
    points = depth.points_mm(camera)[::step, ::step]
    points = points[np.isfinite(points[..., 2])]
    turns = np.arange(2 * _COARSE, dtype=np.float64) * (np.pi / _COARSE)
    best, on = ModuleMatch(Pose.identity(), 0.0, -1.0), planes[0]
    for plane in _sort_by_area(planes, module):
        match = _match_on_plane(points, module, plane, turns, _COARSE)
        if match.agreement > best.agreement:
            best, on = match, plane
        if best.agreement > _CLEAR_AGREEMENT:
            break
    near = best.turn_rad + np.arange(-3, 4, dtype=np.float64) * (np.pi / _COARSE / 4)
    best = _match_on_plane(points, module, on, near, _FINE)
    if best.agreement < _MIN_AGREEMENT:
        raise MeasureError(
            f"{module.name}: not found in the frame (best agreement {max(best.agreement, 0):.0%} of its surface, "
            f"{_MIN_AGREEMENT:.0%} needed); is this its module.toml, and is it within view?"
        )
    return best


def _sort_by_area(planes: list[CandidatePlane], module: Module) -> list[CandidatePlane]:
    """Sort the planes by the similarity of their area to that of the base's upper face, the most similar first."""
    area = module.base.size_mm[0] * module.base.size_mm[1]
    return sorted(planes, key=lambda plane: abs(np.log(plane.area_mm2 / area)))


def _match_on_plane(
    points: NDArray[np.float64],
    module: Module,
    plane: CandidatePlane,
    turns: NDArray[np.float64],
    cells: int,
) -> ModuleMatch:
    """Return the best match on one plane; points (N, 3) in the core's frame, turns (T,) rad."""
    cell = float(np.hypot(*module.base.size_mm[:2])) / cells
    core_from_plane = _make_plane_frame(plane)
    local = core_from_plane.inverse().apply(points)
    top = max(float(solid.corners()[:, 2].max()) for solid in build_solids(module))
    count = int(top / _LEVEL_MM) + 2
    local = local[(local[:, 2] > -0.5 * _LEVEL_MM) & (local[:, 2] < (count - 0.5) * _LEVEL_MM)]
    if len(local) < 100:
        return ModuleMatch(core_from_plane, 0.0, -1.0)
    low = local[:, :2].min(axis=0)
    size = tuple(
        int(fft.next_fast_len(int(n) + cells + 4, real=True)) for n in np.ptp(local[:, :2], axis=0) // cell
    )
    scene = _quantise_scene(local, low, cell, (count, *size))
    measured_spectrum, scene = _compute_spectrum(scene.max(axis=0), size), _compute_spectrum(scene, size)
    best = ModuleMatch(core_from_plane, 0.0, -1.0)
    for turn in turns:
        levels, middle = _quantise_module(module, float(turn), cell, count)
        footprint = cast("NDArray[np.bool_]", levels.any(axis=0))
        pattern = np.conj(_compute_spectrum(levels, size))
        product = cast("NDArray[np.complexfloating]", np.einsum("kij,kij->ij", scene, pattern))
        correlation = fft.irfft2(product, size)
        covered = np.asarray(
            fft.irfft2(measured_spectrum * np.conj(_compute_spectrum(footprint, size)), size)
        )
        score = ((1 + _MISMATCH_PENALTY) * correlation - _MISMATCH_PENALTY * covered) / footprint.sum()
        at = np.unravel_index(int(np.argmax(score)), size)
        if score[at] > best.agreement:
            shift = np.array([n - s if n > s - len(footprint) else n for n, s in zip(at, size, strict=True)])
            plane_from_module = Pose.of([0.0, 0.0, turn], np.array([*(low + shift * cell + middle), 0.0]))
            best = ModuleMatch(core_from_plane @ plane_from_module, float(turn), float(score[at]))
    return best


def _make_plane_frame(plane: CandidatePlane) -> Pose:
    """Return core_from_plane: z out of the plane towards the camera, origin below the camera."""
    z = plane.normal
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, cast("NDArray[np.float64]", np.cross(z, x)), z], axis=1), z * plane.offset_mm)


def _compute_spectrum(maps: NDArray[np.generic], size: tuple[int, ...]) -> NDArray[np.complexfloating]:
    """Return the spectrum over the last two axes, padded with zeros."""
    return np.asarray(fft.rfft2(maps.astype(np.float32), size))


def _quantise_scene(
    points: NDArray[np.float64], low: NDArray[np.float64], cell: float, shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """Return levels (K, n, m): 1 where the scene has a height of the level, or close to it in the next."""
    level = points[:, 2] / _LEVEL_MM
    cells = ((points[:, :2] - low) / cell).astype(np.intp)
    there = np.zeros(shape, np.float32)
    for off in (-0.25, 0.25):
        k = np.rint(level + off).astype(np.intp)
        fits = (k >= 0) & (k < shape[0])
        there[k[fits], cells[fits, 0], cells[fits, 1]] = 1
    return there


def _quantise_module(
    module: Module, turn: float, cell: float, count: int
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return the levels (K, n, n) of the nominal module, rotated, and its origin (2,) mm in them."""
    half = 0.5 * float(np.hypot(*module.base.size_mm[:2])) + cell
    n = int(np.ceil(2 * half / cell))
    axis = (np.arange(n) + 0.5) * cell - half
    x, y = np.meshgrid(axis, axis, indexing="ij")
    mx, my = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    height = np.full((n, n), np.nan)
    for solid in build_solids(module):
        height = np.fmax(height, solid.height(mx, my))
    level = np.rint(np.nan_to_num(height, nan=-10.0 * _LEVEL_MM) / _LEVEL_MM).astype(np.intp)
    return level[None] == np.arange(count)[:, None, None], np.array([half, half])


_SCALES_MM = (8.0, 8.0, 4.0, 4.0, 2.0, 2.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5)
"""Scale of the robust weights in each iteration."""
_POINTS = 15_000
"""Approximate number of points in the fit; it bounds the time."""
_STEP = 1e-4
"""Step of the numerical derivatives: mm, and radians over the module's size in mm."""


def refine_pose(depth: DepthMap, camera: Camera, module: Module, start: Pose) -> Pose:
    """Return core_from_module that minimises the points' distances to the union of the module's solids.

    Gauss–Newton on signed distances with Geman–McClure weights of shrinking scale (graduated non-convexity,
    doi:10.1109/LRA.2020.2965893). Only the points around the module count, and none below the middle of the
    base's sides, where the belt begins.
    """
    solids = build_solids(module)
    points = _sample_points(depth, camera, module, start)
    pose = start
    reach = 0.5 * float(np.hypot(*module.base.size_mm[:2]))
    steps = np.diag(np.array([1 / reach] * 3 + [1.0] * 3) * _STEP)
    for scale in _SCALES_MM:
        local = pose.inverse().apply(points)
        local = local[local[:, 2] > -0.5 * module.base.size_mm[2]]
        off = _compute_distance(solids, local)
        weight = (1 + (off / scale) ** 2) ** -2
        slopes = np.column_stack(
            [(_compute_distance(solids, _make_motion(step).apply(local)) - off) / _STEP for step in steps]
        )
        weighted = slopes * weight[:, None]
        damping = 1e-9 * np.trace(weighted.T @ slopes) * np.eye(6)
        answer = cast(
            "NDArray[np.float64]", np.linalg.solve(weighted.T @ slopes + damping, -weighted.T @ off)
        )
        pose = pose @ _make_motion(answer * np.array([1 / reach] * 3 + [1.0] * 3)).inverse()
    return pose


def _sample_points(depth: DepthMap, camera: Camera, module: Module, start: Pose) -> NDArray[np.float64]:
    """Return an even sample (N, 3) of the measured points in the module's box, in the core's frame."""
    points = depth.points_mm(camera)[depth.measured]
    local = start.inverse().apply(points)
    half = np.array(module.base.size_mm[:2]) / 2 + 5.0
    top = max(float(solid.corners()[:, 2].max()) for solid in build_solids(module)) + 5.0
    inside = (np.abs(local[:, :2]) < half).all(axis=1) & (local[:, 2] < top)
    inside &= local[:, 2] > -module.base.size_mm[2]
    points = points[inside]
    return points[:: max(len(points) // _POINTS, 1)]


def _compute_distance(solids: tuple[ConvexBody, ...], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the signed distances (N,) mm to the surface of the union."""
    points = np.asfortranarray(points)  # sums over x, y and z are eight times as fast by columns
    nearest = solids[0].distance(points)
    for solid in solids[1:]:
        nearest = np.minimum(nearest, solid.distance(points))
    return nearest


def _make_motion(step: NDArray[np.float64]) -> Pose:
    """Return the pose of a small motion (6,): rotation vector in rad, translation in mm."""
    return Pose.of(step[:3], step[3:])
