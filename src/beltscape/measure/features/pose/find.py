"""Where a module lies, without a hint: its heights over each plane of the frame, over all turns and shifts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.core.pose import Pose
from beltscape.measure.features.pose.planes import CandidatePlane, candidate_planes
from beltscape.measure.features.pose.solids import solids_of
from beltscape.target.module import Module

_PLANES = 8
_COARSE = 40
"""Cells along the base's diagonal when all planes and turns are tried, and steps of half a turn."""
_FINE = 80
"""The same for the turns about the best one."""
_LEVEL_MM = 6.0
"""Heights in one such step go for the same."""
_SAMPLES = 150_000
"""Pixels that the height maps are made of, at most."""
_DOUBT = 0.6
"""What a cell that shows another height counts against one that shows the right one."""
_CERTAIN = 0.6
"""Above this no other plane is tried."""
_LEAST_AGREEMENT = 0.5
"""Below this share of its visible cells, net of those that disagree, nothing was found."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Where a module may lie."""

    core_from_module: Pose
    turn_rad: float
    """About the plane's normal."""
    agreement: float
    """Share of the module's cells that show the height they should, less what disagrees; at most 1."""


def find_module(depth: DepthMap, camera: Camera, module: Module) -> Match:
    """The best match over the depth map's planes, within a few mm and a few degrees.

    The height map over a candidate for the base's upper face is cut into levels; the levels of the perfect
    module, turned in steps, are correlated with them by FFT, all shifts at once. Symmetric bases are told
    apart by what stands on them.

    Raises
    ------
    MeasureError
        When no plane carries anything like this module.
    """
    planes = candidate_planes(depth, camera, _PLANES)
    if not planes:
        raise MeasureError(
            f"{module.name}: the frame shows no plane at all; give a frame that shows the module"
        )
    step = max(int(np.sqrt(depth.measured.sum() / _SAMPLES)), 1)
    points = depth.points_mm(camera)[::step, ::step]
    points = points[np.isfinite(points[..., 2])]
    turns = np.arange(2 * _COARSE) * (np.pi / _COARSE)
    best, on = Match(Pose.identity(), 0.0, -1.0), planes[0]
    for plane in _likely_first(planes, module):
        match = _match(points, module, plane, turns, _COARSE)
        if match.agreement > best.agreement:
            best, on = match, plane
        if best.agreement > _CERTAIN:
            break
    near = best.turn_rad + np.arange(-3, 4) * (np.pi / _COARSE / 4)
    best = _match(points, module, on, near, _FINE)
    if best.agreement < _LEAST_AGREEMENT:
        raise MeasureError(
            f"{module.name}: not found in the frame (best agreement {max(best.agreement, 0):.0%} of its surface, "
            f"{_LEAST_AGREEMENT:.0%} needed); is this its module.toml, and is it within view?"
        )
    return best


def _likely_first(planes: list[CandidatePlane], module: Module) -> list[CandidatePlane]:
    """The planes whose size is most like that of the base's upper face first: it saves trying the others."""
    area = module.base.size_mm[0] * module.base.size_mm[1]
    return sorted(planes, key=lambda plane: abs(np.log(plane.area_mm2 / area)))


def _match(
    points: NDArray[np.float64],
    module: Module,
    plane: CandidatePlane,
    turns: NDArray[np.float64],
    cells: int,
) -> Match:
    """The best match on one plane: points (N, 3) in the core's frame, turns (T,) rad, cells along the diagonal."""
    cell = float(np.hypot(*module.base.size_mm[:2])) / cells
    core_from_plane = _plane_frame(plane)
    local = core_from_plane.inverse().apply(points)
    top = max(float(solid.corners()[:, 2].max()) for solid in solids_of(module))
    count = int(top / _LEVEL_MM) + 2
    local = local[(local[:, 2] > -0.5 * _LEVEL_MM) & (local[:, 2] < (count - 0.5) * _LEVEL_MM)]
    if len(local) < 100:
        return Match(core_from_plane, 0.0, -1.0)
    low = local[:, :2].min(axis=0)
    size = tuple(
        int(fft.next_fast_len(int(n) + cells + 4, real=True)) for n in np.ptp(local[:, :2], axis=0) // cell
    )
    scene = _scene_levels(local, low, cell, (count, *size))
    seen, scene = _spectrum(scene.max(axis=0), size), _spectrum(scene, size)
    best = Match(core_from_plane, 0.0, -1.0)
    for turn in turns:
        levels, middle = _module_levels(module, float(turn), cell, count)
        footprint = levels.any(axis=0)
        pattern = np.conj(_spectrum(levels, size))
        matched = np.asarray(fft.irfft2(np.einsum("kij,kij->ij", scene, pattern), size))
        covered = np.asarray(fft.irfft2(seen * np.conj(_spectrum(footprint, size)), size))
        score = ((1 + _DOUBT) * matched - _DOUBT * covered) / footprint.sum()
        at = np.unravel_index(int(np.argmax(score)), size)
        if score[at] > best.agreement:
            shift = np.array([n - s if n > s - len(footprint) else n for n, s in zip(at, size, strict=True)])
            plane_from_module = Pose.of([0.0, 0.0, turn], np.array([*(low + shift * cell + middle), 0.0]))
            best = Match(core_from_plane @ plane_from_module, float(turn), float(score[at]))
    return best


def _plane_frame(plane: CandidatePlane) -> Pose:
    """core_from_plane: z out of the plane towards the camera, origin under the camera's axis."""
    z = plane.normal
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), z * plane.offset_mm)


def _spectrum(maps: NDArray[np.generic], size: tuple[int, ...]) -> NDArray[np.complexfloating]:
    """Of the last two axes, padded with zeros."""
    return np.asarray(fft.rfft2(maps.astype(np.float32), size))


def _scene_levels(
    points: NDArray[np.float64], low: NDArray[np.float64], cell: float, shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """(K, n, m) 1 where the scene shows a height of the level, or of another's part next to it."""
    level = points[:, 2] / _LEVEL_MM
    cells = ((points[:, :2] - low) / cell).astype(np.intp)
    there = np.zeros(shape, np.float32)
    for off in (-0.25, 0.25):
        k = np.rint(level + off).astype(np.intp)
        fits = (k >= 0) & (k < shape[0])
        there[k[fits], cells[fits, 0], cells[fits, 1]] = 1
    return there


def _module_levels(
    module: Module, turn: float, cell: float, count: int
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """(K, n, n) which cells of the perfect module, turned, have which height; its origin (2,) mm in them."""
    half = 0.5 * float(np.hypot(*module.base.size_mm[:2])) + cell
    n = int(np.ceil(2 * half / cell))
    axis = (np.arange(n) + 0.5) * cell - half
    x, y = np.meshgrid(axis, axis, indexing="ij")
    mx, my = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    height = np.full((n, n), np.nan)
    for solid in solids_of(module):
        height = np.fmax(height, solid.height(mx, my))
    level = np.rint(np.nan_to_num(height, nan=-10.0 * _LEVEL_MM) / _LEVEL_MM).astype(np.intp)
    return level[None] == np.arange(count)[:, None, None], np.array([half, half])
