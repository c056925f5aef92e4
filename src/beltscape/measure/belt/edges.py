"""The belt's lateral edges against the floor or frame below, and its lateral offset (misalignment)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.empty_belt import Belt, BeltEdges
from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.statistics import MAD_TO_SIGMA, compute_biweights

_STRIPS = 48
"""Strips along the belt in which its edges are located one by one."""
_MIN_STRIPS = 12
"""With fewer strips that show it, an edge is not measured."""
_WING_MM = 40.0
"""The cross-section is extrapolated by the slope of its outermost stretch of this length."""
_GAP_STEPS = 3.0
"""A gap between belt and background of more pixels than this was not measured; flying pixels leave narrower ones."""
_BELOW_MM = 12.0
"""A point further below the belt than this belongs to the floor or the frame."""


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
    return BeltEdges(left, right, left_sigma, right_sigma, float(offset), float(sigma), against)  # pyright: ignore[reportArgumentType]


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
    for _ in range(12):  # the ray is steep against the belt: a few iterations converge
        reach = (_extrapolate_section(belt, eye[0] + reach * rays[:, 0]) - eye[2]) / rays[:, 2]
    x, y = eye[0] + reach * rays[:, 0], eye[1] + reach * rays[:, 1]
    below = (z - reach) * -rays[:, 2]
    flag = np.where(below > _BELOW_MM, -1, np.where(below < 0.5 * _BELOW_MM, 1, 0)).astype(np.int8)
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
    weight = np.ones(len(transitions))
    answer, noise, normal = np.zeros(2), 0.0, np.eye(2)
    for _ in range(8):
        normal = design.T @ (design * weight[:, None])
        answer = np.linalg.solve(normal, design.T @ (weight * transitions[:, 1]))
        residual = transitions[:, 1] - design @ answer
        noise = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-6
        weight = compute_biweights(residual, noise) + 1e-9
    # an edge is located to a fraction of a pixel at best, however many strips it crosses
    sigma = float(np.hypot(noise * np.sqrt(np.linalg.inv(normal)[0, 0]), 0.3 * step_mm))
    # in a gap between belt and background that was not measured, the edge may lie anywhere
    gap = float(np.median(transitions[:, 2]))
    unseen = gap / np.sqrt(12) if gap > _GAP_STEPS * step_mm else 0.0
    return side * float(answer[0]), float(np.hypot(sigma, unseen))
