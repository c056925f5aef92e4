"""The belt's lateral edges and offset (misalignment), and the middle of its cross-section.

The edges stand against the floor or frame below; the middle is the flat part, or the line of symmetry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt, BeltEdges
from beltscape.core.geometry.camera import Camera
from beltscape.core.statistics import MAD_TO_SIGMA, compute_biweights
from beltscape.measure.belt.cross_section import STEP_MM

_STRIPS = 48
"""Strips along the belt in which its edges are located one by one."""
_MIN_STRIPS = 12
"""With fewer strips that show it, an edge is not measured."""
_WING_MM = 40.0
"""The cross-section is extrapolated by the slope of its outermost stretch of this length."""
_GAP_STEPS = 3.0
"""A gap between belt and background of more pixels than this was not measured; flying pixels leave narrower ones."""


def find_belt_edges(depth: DepthMap, camera: Camera, belt: Belt) -> BeltEdges:
    """Find the belt's edges in any frame, loaded or empty, and its lateral offset.

    Each pixel's ray is intersected with the belt, extrapolated beyond its edges. The pixel shows either the belt
    (or its load) or something well below it. In each strip along the belt the position across that separates the
    two best is found; a robust line through these positions gives the edge at y = 0. Where nothing below the belt
    was measured beside it, the surface ends with the light and not with the belt: that edge stays NaN.

    The offset is the shift against the edges stored in ``belt``; without these it is that of the two edges' middle
    against the trough's.
    """
    intersections = _intersect_belt(depth, camera, belt)
    step = 1.2 * pixel_size_mm(depth, camera)
    found = [
        _find_edge(intersections, side, step, side * clear)
        for side, clear in zip((-1, 1), belt.clear_mm, strict=True)
    ]
    (left, left_sigma), (right, right_sigma) = found
    offset, sigma, against = np.nan, np.nan, "trough"
    if belt.edges is None:
        offset = 0.5 * (left + right) - belt.middle_mm
        sigma = 0.5 * float(np.hypot(left_sigma, right_sigma))
    else:
        learned = belt.edges
        against = "learned"
        shift = np.array([left - learned.left_mm, right - learned.right_mm])
        spread = np.hypot([left_sigma, right_sigma], [learned.left_sigma_mm, learned.right_sigma_mm])
        seen = np.isfinite(shift)
        if seen.any():
            weight = 1 / spread[seen] ** 2
            offset, sigma = float(np.average(shift[seen], weights=weight)), float(1 / np.sqrt(weight.sum()))
    return BeltEdges(left, right, left_sigma, right_sigma, float(offset), float(sigma), against)


def pixel_size_mm(depth: DepthMap, camera: Camera) -> float:
    """Return the edge of a pixel (mm) at the median depth."""
    return float(np.nanmedian(depth.depth_mm)) / float(camera.focal_px.mean())


def _intersect_belt(
    depth: DepthMap, camera: Camera, belt: Belt
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]]:
    """Return x, y where the measured pixels' rays meet the extrapolated belt; 1 belt or load, -1 below, 0 neither."""
    pose = belt.belt_from_core
    use = depth.measured
    rays = np.concatenate([camera.rays()[use], np.ones((int(use.sum()), 1))], axis=1) @ pose.rotation.T
    z = depth.depth_mm[use].astype(np.float64)
    eye = pose.translation_mm
    reach = (0.0 - eye[2]) / rays[:, 2]
    across, along, up = np.ascontiguousarray(rays.T)
    for _ in range(12):  # the ray is steep against the belt: a few iterations converge
        before, reach = reach, (_extrapolate_section(belt, eye[0] + reach * across) - eye[2]) / up
        if np.array_equal(before, reach, equal_nan=True):
            break
    x, y = eye[0] + reach * across, eye[1] + reach * along
    below = (z - reach) * -up
    flag = np.where(below > STEP_MM, -1, np.where(below < 0.5 * STEP_MM, 1, 0)).astype(np.int8)
    return x, y, flag


def _extrapolate_section(belt: Belt, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the cross-section at x, extrapolated linearly beyond its ends."""
    z = belt.height_mm(x_mm)
    for end, near in ((belt.x_mm[0], belt.x_mm <= belt.x_mm[0] + _WING_MM),
                      (belt.x_mm[-1], belt.x_mm >= belt.x_mm[-1] - _WING_MM)):  # fmt: skip
        slope = float(np.polyfit(belt.x_mm[near], belt.z_mm[near], 1)[0]) if near.sum() >= 2 else 0.0
        beyond = (x_mm < end) if end == belt.x_mm[0] else (x_mm > end)
        z = np.where(beyond, z + slope * (x_mm - end), z)
    return z


def _find_edge(
    intersections: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]],
    side: int,
    step_mm: float,
    clear_mm: float,
) -> tuple[float, float]:
    """Return x of the belt's edge at y = 0 and its σ, NaN where it is not visible; ``side`` -1 left, 1 right.

    Beyond ``clear_mm``, outwards, something else stands as high as the belt.
    """
    x, y, flag = intersections
    own = (side * x > 0) & (side * x < clear_mm) & (flag != 0)
    x, y, flag = side * x[own], y[own], flag[own]
    if not (flag < 0).any():
        return np.nan, np.nan
    strip = np.clip(((y - y.min()) / max(float(np.ptp(y)), 1e-9) * _STRIPS).astype(np.intp), 0, _STRIPS - 1)
    order = np.lexsort((x, strip))
    x, y, flag, strip = x[order], y[order], flag[order], strip[order]
    transitions: list[tuple[float, float, float]] = []
    for first, last in zip(
        np.searchsorted(strip, range(_STRIPS)), np.searchsorted(strip, range(_STRIPS), "right"), strict=True
    ):
        part = flag[first:last].astype(np.int64)
        if (part < 0).sum() < 8 or (part > 0).sum() < 8:
            continue
        inside = np.cumsum(part)  # largest at the belt's edge
        at = int(np.argmax(inside))
        if at + 1 >= len(part) or x[first + at + 1] - x[first + at] > 8 * step_mm:
            continue
        inner, outer = float(x[first + at]), float(x[first + at + 1])
        transitions.append((float(y[first:last].mean()), 0.5 * (inner + outer), outer - inner))
    if len(transitions) < _MIN_STRIPS:
        return np.nan, np.nan
    return _fit_line(np.array(transitions), side, step_mm)


def _fit_line(transitions: NDArray[np.float64], side: int, step_mm: float) -> tuple[float, float]:
    """Return the value at y = 0 of a robust line through transitions (N, 3) y, x, gap, and its σ."""
    design = np.column_stack([np.ones(len(transitions)), transitions[:, 0]])
    answer, noise, normal = _fit_median_line(transitions), 0.0, np.eye(2)
    for _ in range(8):
        residual = transitions[:, 1] - design @ answer
        noise = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-6
        weight = compute_biweights(residual, noise) + 1e-9
        normal = design.T @ (design * weight[:, None])
        answer = np.linalg.solve(normal, design.T @ (weight * transitions[:, 1]))
    # an edge is located to a fraction of a pixel at best, however many strips it crosses
    sigma = float(np.hypot(noise * np.sqrt(np.linalg.inv(normal)[0, 0]), 0.3 * step_mm))
    # in a gap between belt and background that was not measured, the edge may lie anywhere
    gap = float(np.median(transitions[:, 2]))
    unseen = gap / np.sqrt(12) if gap > _GAP_STEPS * step_mm else 0.0
    return side * float(answer[0]), float(np.hypot(sigma, unseen))


def _fit_median_line(transitions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the value at y = 0 and the slope of the line of median slope and value (Theil and Sen).

    Load beside the edge shifts a tenth to a fifth of the transitions, all to the same side.
    """
    first, second = np.triu_indices(len(transitions), k=1)
    y, x = transitions[:, 0], transitions[:, 1]
    slope = float(np.median((x[second] - x[first]) / (y[second] - y[first])))
    return np.array([float(np.median(x - slope * y)), slope])


_MIN_SHARE = 0.12
"""A straight piece shorter than this share of the belt is no flat centre."""
_MAX_TILT = np.deg2rad(12.0)
"""A straight piece inclined more than this to the camera's image plane is a wing, unless it lies between two."""
_MAX_TILT_BETWEEN_WINGS = np.deg2rad(40.0)
"""Limit of the inclination of a piece from which the belt climbs on both sides: then the camera is inclined."""
_WING_SHARE, _WING_CLIMB = 0.05, 0.03
"""A side climbs when more than this share of the belt lies higher than this share of its width above the piece."""
_MAX_SLOPE = 2.0
"""Largest slope of a belt's surface; a steeper one is a step to the floor or a frame."""
_LOWEST_SHARE = 0.002
"""Nodes within this share of the belt's width above the lowest one are its bottom: 60 mm of a round belt 500 mm wide,
5 mm of two rolls at 20°."""


@dataclass(frozen=True, slots=True)
class Middle:
    """The direction of the vertical relative to the cross-section, and the flat part."""

    slope_rad: float
    """Angle of the flat against the section's x; where there is no flat, of the line of symmetry's normal."""
    flat_mm: tuple[float, float] | None
    """The flat's ends in x, or None."""


def find_continuous_nodes(
    x_mm: NDArray[np.float64], z_mm: NDArray[np.float64], noise_mm: float, at_mm: float
) -> slice | None:
    """Return the nodes of the continuous surface through ``at_mm``; None where nothing was measured there."""
    measured = np.flatnonzero(np.isfinite(z_mm))
    if len(measured) < 3:
        return None
    climb = np.abs(np.diff(z_mm[measured])) > _MAX_SLOPE * np.diff(x_mm[measured]) + 6 * noise_mm
    piece = np.r_[0, np.cumsum(climb)]
    nearest = int(np.argmin(np.abs(x_mm[measured] - at_mm)))
    own = measured[piece == piece[nearest]]
    if len(own) < 3 or abs(x_mm[measured[nearest]] - at_mm) > 0.1 * (x_mm[-1] - x_mm[0]):
        return None
    return slice(int(own[0]), int(own[-1]) + 1)


def find_middle(x_mm: NDArray[np.float64], z_mm: NDArray[np.float64], tolerance_mm: float) -> Middle:
    """Find the flat centre of a belt's cross-section (K,), or its symmetry where it has no flat.

    Candidates are the lines through two nodes that are little inclined, or from which the belt climbs on both
    sides. The flat is the candidate with most nodes on it; wings are steeper and end freely on one side.
    """
    measured = np.isfinite(z_mm)
    x, z = x_mm[measured], z_mm[measured]
    first, second = np.triu_indices(len(x), k=max(3, len(x) // 40))
    angle = np.arctan2(z[second] - z[first], x[second] - x[first])
    keep = np.abs(angle) < _MAX_TILT_BETWEEN_WINGS
    first, second, angle = first[keep], second[keep], angle[keep]
    if len(first):
        off = z[None] - z[first, None] - np.tan(angle)[:, None] * (x[None] - x[first, None])
        score = np.clip(1 - (off / tolerance_mm) ** 2, 0, None).sum(axis=1)
        is_between = _is_between_wings(off > _WING_CLIMB * np.ptp(x), first, second)
        limit = cast("NDArray[np.float64]", np.where(is_between, _MAX_TILT_BETWEEN_WINGS, _MAX_TILT))
        # a shallow wing may be longer than the flat, but it is steeper
        best = int(
            np.argmax(score * np.clip(1 - 0.75 * (angle / limit) ** 2, 0.25, None) * (np.abs(angle) < limit))
        )
        on = _find_longest_run(np.abs(off[best]) < tolerance_mm)
        if on is not None and on.stop - on.start >= _MIN_SHARE * len(x) and abs(angle[best]) < limit[best]:
            slope = np.polyfit(x[on], z[on], 1)[0]
            return Middle(float(np.arctan(slope)), (float(x[on][0]), float(x[on][-1])))
    return Middle(_find_symmetry(x, z), None)


def _is_between_wings(
    above: NDArray[np.bool_], first: NDArray[np.intp], second: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Return (M,) whether the belt is ``above`` (M, K) each line left of its first and right of its second node."""
    node = np.arange(int(above.shape[1]))
    left = (above & (node < first[:, None])).mean(axis=1)
    right = (above & (node > second[:, None])).mean(axis=1)
    return np.minimum(left, right) > _WING_SHARE


def _find_longest_run(flags: NDArray[np.bool_]) -> slice | None:
    """Return the longest run of True, in which gaps of two are bridged."""
    on = np.flatnonzero(flags)
    if not len(on):
        return None
    breaks = np.flatnonzero(np.diff(on) > 3)
    starts, stops = np.r_[0, breaks + 1], np.r_[breaks, len(on) - 1]
    longest = int(np.argmax(on[stops] - on[starts]))
    return slice(int(on[starts[longest]]), int(on[stops[longest]]) + 1)


def _find_symmetry(x: NDArray[np.float64], z: NDArray[np.float64]) -> float:
    """Return the rotation (rad) after which both sides of the lowest point climb equally."""
    turn = 0.0
    for _ in range(20):
        height = np.cos(turn) * z - np.sin(turn) * x
        # the middle of the lowest nodes: a single one is moved by noise on a round bottom
        lowest = np.flatnonzero(height <= height.min() + _LOWEST_SHARE * np.ptp(x))
        low = min(max(round(float(lowest.mean())), 3), len(x) - 3)
        left, right = np.polyfit(x[:low], z[:low], 1)[0], np.polyfit(x[low:], z[low:], 1)[0]
        half = 0.5 * float(np.arctan(left) + np.arctan(right))
        if abs(half - turn) < 1e-9:
            break
        turn = half
    return turn
