"""The initial estimate of the belt's frame: from the normals of small blocks, or from the plane of a flat belt.

The blocks and the plane are robust. The direction of a flat belt is that of its edges: straight steps down to the
floor or up to a frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.core.statistics import MAD_TO_SIGMA, TUKEY, compute_biweights
from beltscape.measure.belt.cross_section import STEP_MM


@dataclass(frozen=True, slots=True)
class EdgeYaw:
    """Direction of a belt's edges in the belt's plane."""

    angle_rad: float
    """Angle of the edges against the plane's second axis; positive towards minus the first."""
    sigma_rad: float
    """One standard deviation of the angle."""


_MIN_EDGE_SHARE = 0.3
"""An edge is as long as this share of the view; two parallel ones are it together."""
_PARALLEL_RAD = float(np.deg2rad(0.5))
"""The two edges of a belt differ by less in direction, besides the σ of both."""


def fit_edge_yaw(
    plane_mm: NDArray[np.float64], off_mm: NDArray[np.float64], tolerance_mm: float
) -> EdgeYaw | None:
    """Fit the direction of the straight steps that bound a plane; None where no long one is visible.

    ``plane_mm`` (H, W, 2) and ``off_mm`` (H, W) are each pixel's position in the plane and its height off it. Only
    borders with another surface measured nearby count, a step off the plane: not the border of the light, where
    depths of the plane itself are off by millimetres.
    """
    points = _border_mask(off_mm, tolerance_mm)
    points = plane_mm[points]
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 40:
        return None
    step_mm = float(np.nanmedian(np.linalg.norm(np.diff(plane_mm, axis=1), axis=-1)))
    bin_mm = 3 * step_mm
    angle, offsets = _find_edge_direction(points, bin_mm)
    length = float(np.nanmax(plane_mm[..., 1]) - np.nanmin(plane_mm[..., 1]))
    lines = [
        line
        for offset in offsets
        if len(line := points[np.abs(_project_across(points, angle) - offset) < 2 * bin_mm]) >= 40
    ]
    fits = [_fit_line(line, angle, step_mm) for line in lines]
    return _join_lines(fits, _MIN_EDGE_SHARE * length)


def _join_lines(lines: list[_Line], least_mm: float) -> EdgeYaw | None:
    """Return the direction of one or two edges; None where neither is long enough.

    A belt turned in the view shows its edges in two corners of the image: each is short, but they are parallel.
    """
    if not lines:
        return None
    angles = np.array([line.angle_rad for line in lines])
    sigmas = np.array([line.sigma_rad for line in lines])
    lengths = np.array([line.length_mm for line in lines])
    is_parallel = np.ptp(angles) <= _PARALLEL_RAD + 3 * float(np.linalg.norm(sigmas))
    use = lengths >= least_mm
    if is_parallel and len(lines) > 1 and lengths.sum() >= least_mm:
        use[:] = True
    if not use.any():
        return None
    weights = 1 / sigmas[use] ** 2
    return EdgeYaw(float(np.average(angles[use], weights=weights)), float(np.sqrt(1 / weights.sum())))


def _border_mask(off_mm: NDArray[np.float64], tolerance_mm: float) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of the plane next to a step."""
    measured = np.isfinite(off_mm)
    on = ndimage.binary_closing(measured & (np.abs(off_mm) < tolerance_mm), iterations=3)
    on = np.asarray(ndimage.binary_opening(on, iterations=3), bool)
    other = measured & (np.abs(off_mm) > max(2 * tolerance_mm, STEP_MM))
    other = np.asarray(ndimage.binary_opening(other, iterations=3), bool)
    if not other.any():
        return np.zeros_like(on)
    near = np.asarray(ndimage.distance_transform_edt(~other)) < 0.05 * off_mm.shape[1]
    border = on & ~np.asarray(ndimage.binary_erosion(on, border_value=1), bool)
    return border & near


def _project_across(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    return points[:, 0] * np.cos(angle) + points[:, 1] * np.sin(angle)


def _find_edge_direction(points: NDArray[np.float64], bin_mm: float) -> tuple[float, list[float]]:
    """Return the direction in which the points lie on the fewest lines, and the offsets of up to two of these."""
    best, best_score, best_counts, best_start = 0.0, -1.0, np.zeros(1), 0.0
    for angle in np.deg2rad(np.arange(-90, 90, 0.25)):
        across = _project_across(points, angle)
        start = float(across.min())
        counts = np.bincount(((across - start) / bin_mm).astype(np.intp)).astype(np.float64)
        score = float(np.sum(counts**2))
        if score > best_score:
            best, best_score, best_counts, best_start = float(angle), score, counts, start
    first = int(np.argmax(best_counts))
    offsets = [best_start + (first + 0.5) * bin_mm]
    apart = np.abs(np.arange(len(best_counts)) - first) * bin_mm > 0.2 * len(best_counts) * bin_mm
    rest = np.where(apart, best_counts, 0)
    if rest.max() > 0.3 * best_counts[first]:
        offsets.append(best_start + (int(np.argmax(rest)) + 0.5) * bin_mm)
    return best, offsets


@dataclass(frozen=True, slots=True)
class _Line:
    """A straight border."""

    angle_rad: float
    sigma_rad: float
    length_mm: float


def _fit_line(points: NDArray[np.float64], angle: float, step_mm: float) -> _Line:
    """Return the line through the points (N, 2), near the direction ``angle``."""
    across = _project_across(points, angle)
    along = -points[:, 0] * np.sin(angle) + points[:, 1] * np.cos(angle)
    design = np.column_stack([np.ones_like(along), along - along.mean()])
    weight: NDArray[np.float64] = np.ones_like(along)
    slope, noise = 0.0, 0.0
    for _ in range(5):
        weighted = design * weight[:, None]
        solved = cast("NDArray[np.float64]", np.linalg.solve(weighted.T @ design, weighted.T @ across))
        offset, slope = solved
        residual: NDArray[np.float64] = across - offset - design[:, 1] * slope
        noise = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-6
        weight = compute_biweights(residual, noise)
    # errors of neighbouring border pixels are correlated: ten of them count as one; an edge along the rows or
    # columns of pixels is located only to a fraction of a pixel over its whole length
    sigma = np.hypot(noise / np.sqrt(np.sum(weight * design[:, 1] ** 2) / 10), 0.3 * step_mm / np.ptp(along))
    return _Line(float(angle - np.arctan(slope)), float(sigma), float(np.ptp(along)))


_MIN_SHARE = 0.5
"""A block with a smaller share of measured pixels gets no plane."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockPlanes:
    """Planes of the blocks that have one, in the camera's frame."""

    normals: NDArray[np.float64]
    """(M, 3) unit normals towards the camera."""
    centers_mm: NDArray[np.float64]
    """(M, 3) points of the planes at the blocks' centres."""
    rms_mm: NDArray[np.float64]
    """(M,) robust scatter of the pixels about their plane, along the ray."""
    row: NDArray[np.intp]
    """(M,) number of the block's row of blocks."""
    column: NDArray[np.intp]
    """(M,) number of the block's column of blocks."""

    def select(self, keep: NDArray[np.bool_]) -> BlockPlanes:
        """Return the blocks where ``keep`` (M,) is set."""
        return BlockPlanes(
            self.normals[keep], self.centers_mm[keep], self.rms_mm[keep], self.row[keep], self.column[keep]
        )


def fit_block_planes(depth: DepthMap, camera: Camera, side_px: int) -> BlockPlanes:
    """Fit a robust plane to every block of ``side_px`` × ``side_px`` pixels.

    The inverse depth of a plane is affine over the image, so each block is a linear fit of three parameters,
    iterated with Tukey weights.
    """
    height, width = (n // side_px * side_px for n in depth.depth_mm.shape)
    inverse = _split_blocks(1.0 / depth.depth_mm[:height, :width].astype(np.float64), side_px)
    rays = camera.rays()[:height, :width]
    design = np.stack(
        [_split_blocks(rays[..., 0], side_px), _split_blocks(rays[..., 1], side_px), np.ones_like(inverse)],
        -1,
    )
    enough = np.isfinite(inverse).mean(axis=1) >= _MIN_SHARE
    inverse, design = inverse[enough], design[enough]
    row, column = np.divmod(np.flatnonzero(enough), width // side_px)
    if not len(inverse):
        return BlockPlanes(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), row, column)
    middle = design.mean(axis=1)
    local = design.copy()
    local[..., :2] -= middle[:, None, :2]
    weight = np.isfinite(inverse).astype(np.float64)
    filled = np.where(weight > 0, inverse, 0.0)
    plane, scale = np.zeros((len(inverse), 3)), np.zeros(len(inverse))
    for _ in range(4):
        weighted = local * weight[..., None]
        normal_matrix = weighted.transpose(0, 2, 1) @ local
        normal_matrix += 1e-12 * np.trace(normal_matrix, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        right = weighted.transpose(0, 2, 1) @ filled[..., None]
        plane = cast("NDArray[np.float64]", np.linalg.solve(normal_matrix, right))[..., 0]
        residual = np.where(np.isfinite(inverse), inverse - (local @ plane[..., None])[..., 0], np.nan)
        scale = MAD_TO_SIGMA * _compute_row_medians(np.abs(residual)) + 1e-12
        ratio = np.nan_to_num(residual / (TUKEY * scale[:, None]), nan=1.0)
        weight = np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)
    # w = a·x/z + b·y/z + c is the plane a·X + b·Y + c·Z = 1
    normal = plane.copy()
    normal[:, 2] -= np.sum(plane[:, :2] * middle[:, :2], axis=1)
    normal *= -1.0 / np.linalg.norm(normal, axis=1, keepdims=True)
    z = 1.0 / plane[:, 2]
    return BlockPlanes(normal, middle * z[:, None], scale * z**2, row, column)


def _compute_row_medians(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the medians (N,) of rows (N, M) without their NaN, of which `nanmedian` makes masked arrays."""
    count = np.isfinite(values).sum(axis=1)
    ascending, row = np.sort(values, axis=1), np.arange(len(values))  # NaN goes last
    return (ascending[row, (count - 1) // 2] + ascending[row, count // 2]) / 2


def _split_blocks(plane: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Return the pixels (H, W) as blocks (blocks, side²)."""
    rows, columns = plane.shape[0] // side, plane.shape[1] // side
    return plane.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows * columns, side * side)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The plane of the points p with normal · p = offset."""

    normal: NDArray[np.float64]
    """(3,) unit, z positive."""
    offset_mm: float
    """Distance of the plane from the origin along the normal."""
    rms_mm: float
    """Robust scatter of the points about it."""
    sigma_rad: float
    """One standard deviation of the normal's direction (the worse axis), for independent points."""


def fit_plane(points_mm: NDArray[np.float64]) -> Plane:
    """Fit the plane z = a + b·x + c·y to points (N, 3), N ≥ 3, with Tukey weights on the robust scatter."""
    middle = np.median(points_mm, axis=0)
    local = points_mm - middle
    design = np.column_stack([np.ones(len(local)), local[:, :2]])
    weight = np.ones(len(local))
    answer, noise, normal_matrix = np.zeros(3), 0.0, np.eye(3)
    for _ in range(8):
        normal_matrix = (design * weight[:, None]).T @ design
        answer = np.linalg.solve(normal_matrix, design.T @ (weight * local[:, 2]))
        residual = local[:, 2] - design @ answer
        noise = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-9
        weight = compute_biweights(residual, noise)
    normal = np.array([-answer[1], -answer[2], 1.0])
    normal /= np.linalg.norm(normal)
    sigma = noise * np.sqrt(np.diag(np.linalg.inv(normal_matrix))[1:].max())
    return Plane(normal, float(normal @ (middle + np.array([0.0, 0.0, answer[0]]))), noise, float(sigma))


_WING_ANGLE_RAD = np.deg2rad(4.0)
"""Normals inclined more than this to the median belong to a wing."""
_MIN_WING_SHARE = 0.04
"""With more of the blocks than this on wings, the belt is troughed."""


@dataclass(frozen=True, slots=True, eq=False)
class InitialFrame:
    """A frame within a few degrees of the belt's."""

    rotation: NDArray[np.float64]
    """(3, 3) start_from_camera; rows are x across, y along, z up."""
    troughed: bool
    """Whether the surface bends across, so that its shape determines its direction."""
    edges: EdgeYaw | None
    """Direction of a flat belt's edges; None for a troughed belt, or where no edge is visible."""


def find_initial_frame(
    depth: DepthMap,
    camera: Camera,
    blocks: BlockPlanes,
    points_mm: NDArray[np.float64],
    travel_deg: float | None = None,
) -> InitialFrame:
    """Estimate the frame from the belt's blocks of the depth map; ``points_mm`` (N, 3) sample these in its frame.

    ``travel_deg`` is the direction of travel that is given, see `GivenBelt`; MeasureError where it contradicts the
    belt's shape or its edges.
    """
    planes = _select_planar_blocks(blocks)
    along = _fit_belt_direction(planes.normals)
    rotation = build_frame(along, np.array([0.0, 0.0, -1.0]))
    angle = np.arctan2(planes.normals @ rotation[0], planes.normals @ rotation[2])
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(planes.normals @ along)))
    on_wing = np.abs(angle - np.median(angle)) > max(_WING_ANGLE_RAD, 4 * scatter)
    if on_wing.mean() > _MIN_WING_SHARE:
        _require_agreement(rotation, travel_deg, "shape")
        return InitialFrame(rotation, True, None)
    frame = _find_flat_frame(depth, camera, points_mm, planes, travel_deg or 0.0)
    if frame.edges is not None:
        _require_agreement(frame.rotation, travel_deg, "edges")
    return frame


_AGREE_DEG = 5.0
"""Difference from which on a given direction of travel contradicts the one that was measured."""


def _require_agreement(rotation: NDArray[np.float64], travel_deg: float | None, source: str) -> None:
    """Raise MeasureError if the direction that is given is not that of a frame whose ``source`` shows it."""
    if travel_deg is None:
        return
    along = rotation[1]
    found = float(np.rad2deg(np.arctan2(-along[0], along[1])))
    if abs((found - travel_deg + 90) % 180 - 90) > _AGREE_DEG:
        raise MeasureError(
            f"empty belt: its direction of travel is given as {travel_deg:g}° from the image's columns, but its "
            f"{source} {'show' if source == 'edges' else 'shows'} {(found + 90) % 180 - 90:.0f}°; leave it out"
        )


def build_frame(along: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows x, y, z (3, 3): y on the line ``along``, z nearest to ``up``, x towards the core image's +u."""
    along = along / np.linalg.norm(along)
    up = up - (up @ along) * along
    up = up / np.linalg.norm(up)
    across = np.cross(along, up)
    # a belt that runs along u does not determine the sign: then x points towards +v
    facing = across[0] if abs(across[0]) > 1e-3 else across[1]
    return np.stack([across, along, up]) * np.where([[True], [True], [False]], np.sign(facing), 1.0)


def _select_planar_blocks(planes: BlockPlanes) -> BlockPlanes:
    """Return the planes of the blocks that hold one surface."""
    if len(planes.rms_mm) < 30:
        raise MeasureError("empty belt: too few measured patches; project speckle or give a better frame")
    # exact data have no scatter: then the resolution of a float32 depth decides
    good = planes.rms_mm <= 3 * np.median(planes.rms_mm) + 1e-5 * np.median(planes.centers_mm[:, 2])
    return planes.select(good)


def _fit_belt_direction(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the direction (3,) that most normals are perpendicular to, by Cauchy weights."""
    weight = np.ones(len(normals))
    along = np.zeros(3)
    for _ in range(20):
        along = np.linalg.eigh((normals * weight[:, None]).T @ normals)[1][:, 0]
        deviation = np.abs(normals @ along)
        weight = 1 / (1 + (deviation / (2 * np.median(deviation) + 1e-6)) ** 2)
    return along


def _find_flat_frame(
    depth: DepthMap,
    camera: Camera,
    points_mm: NDArray[np.float64],
    planes: BlockPlanes,
    travel_deg: float,
) -> InitialFrame:
    """Estimate the frame of a flat belt from its plane and its edges, or the direction where it has none in view."""
    off_axis = np.linalg.norm(planes.centers_mm[:, :2], axis=1) / planes.centers_mm[:, 2]
    nearest = np.argsort(off_axis)[: max(5, len(off_axis) // 50)]
    normal = np.median(planes.normals, axis=0)
    normal /= np.linalg.norm(normal)
    offset = float(np.median(planes.centers_mm[nearest] @ normal))
    noise = 0.01 * abs(offset)  # wide enough for the first normal's error, too narrow for the floor
    for _ in range(12):
        off = points_mm @ normal - offset
        near = points_mm[np.abs(off) < 4 * noise]
        if len(near) < 0.02 * len(points_mm):
            raise MeasureError(
                "empty belt: no even surface under the optical axis; give an empty belt's frame"
            )
        middle = near.mean(axis=0)
        normal = np.linalg.eigh((near - middle).T @ (near - middle))[1][:, 0]
        normal *= -np.sign(normal[2])
        offset = float(middle @ normal)
        noise = max(MAD_TO_SIGMA * float(np.median(np.abs((near - middle) @ normal))), 1e-4)
    turn = np.deg2rad(travel_deg)
    x_axis = np.array([np.cos(turn), np.sin(turn), 0.0])
    rotation = build_frame(np.cross(normal, x_axis), normal)
    pixels = depth.points_mm(camera) @ rotation.T
    edges = fit_edge_yaw(pixels[..., :2], pixels[..., 2] - offset, 6 * noise)
    if edges is not None:
        across = np.cos(edges.angle_rad) * rotation[0] + np.sin(edges.angle_rad) * rotation[1]
        rotation = build_frame(cast("NDArray[np.float64]", np.cross(normal, across)), normal)
    return InitialFrame(rotation, False, edges)
