"""Where the belt ends across, against the floor or frame behind it, and how far it runs off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt_model import Belt, BeltEdges
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap

_STRIPS = 48
_LEAST_STRIPS = 12
_WING_MM = 40.0
"""The belt goes on beyond the ends that were learned as it runs over the last so many millimetres."""
_BELOW_MM = 12.0
"""What lies further below the belt than this is something else."""


def belt_edges(depth: DepthMap, camera: Camera, belt: Belt) -> BeltEdges:
    """The belt's ends in any frame, loaded or empty, and how far it runs off.

    Each pixel looks at a place of the belt, or where the belt would be if it were wider; it shows the belt (or what
    lies on it) or something well below. Strips along the belt each give the place that best parts the two, and a
    robust line through them the end at y = 0. An end with nothing measured behind it is that of the light, not of
    the belt, and stays NaN.

    Where the belt itself has learned ends, the offset is their shift; else that of the two ends' middle from the
    trough's.
    """
    aim = _aim(depth, camera, belt)
    step = 1.2 * depth_step(depth, camera)
    found = [_end(aim, side, step) for side in (-1, 1)]
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


def depth_step(depth: DepthMap, camera: Camera) -> float:
    """Edge of a pixel (mm) at the median depth."""
    return float(np.nanmedian(depth.depth_mm)) / float(camera.focal_px.mean())


def _aim(
    depth: DepthMap, camera: Camera, belt: Belt
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]]:
    """Per measured pixel x, y where its ray meets the (endless) belt, and 1 belt or load, -1 below, 0 neither."""
    pose = belt.belt_from_core
    use = depth.measured
    rays = np.concatenate([camera.rays()[use], np.ones((int(use.sum()), 1))], axis=1) @ pose.rotation.T
    z = depth.depth_mm[use].astype(np.float64)
    eye = pose.translation_mm
    reach = (0.0 - eye[2]) / rays[:, 2]
    for _ in range(12):  # the ray is steep against the belt: a few rounds settle it
        reach = (_endless(belt, eye[0] + reach * rays[:, 0]) - eye[2]) / rays[:, 2]
    x, y = eye[0] + reach * rays[:, 0], eye[1] + reach * rays[:, 1]
    below = (z - reach) * -rays[:, 2]
    flag = np.where(below > _BELOW_MM, -1, np.where(below < 0.5 * _BELOW_MM, 1, 0)).astype(np.int8)
    return x, y, flag


def _endless(belt: Belt, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the cross-section, its ends prolonged."""
    z = belt.height_mm(x_mm)
    for end, near in ((belt.x_mm[0], belt.x_mm <= belt.x_mm[0] + _WING_MM),
                      (belt.x_mm[-1], belt.x_mm >= belt.x_mm[-1] - _WING_MM)):  # fmt: skip
        slope = float(np.polyfit(belt.x_mm[near], belt.z_mm[near], 1)[0]) if near.sum() >= 2 else 0.0
        beyond = (x_mm < end) if end == belt.x_mm[0] else (x_mm > end)
        z = np.where(beyond, z + slope * (x_mm - end), z)
    return z


def _end(
    aim: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]], side: int, step_mm: float
) -> tuple[float, float]:
    """X of the belt's end at y = 0 and its σ; NaN where it is not seen. ``side`` is -1 left, 1 right."""
    x, y, flag = aim
    own = (side * x > 0) & (flag != 0)
    x, y, flag = side * x[own], y[own], flag[own]
    if not (flag < 0).any():
        return np.nan, np.nan
    strip = np.clip(((y - y.min()) / max(float(np.ptp(y)), 1e-9) * _STRIPS).astype(np.intp), 0, _STRIPS - 1)
    order = np.lexsort((x, strip))
    x, y, flag, strip = x[order], y[order], flag[order], strip[order]
    places = []
    for first, last in zip(
        np.searchsorted(strip, range(_STRIPS)), np.searchsorted(strip, range(_STRIPS), "right"), strict=True
    ):
        part = flag[first:last].astype(np.int64)
        if (part < 0).sum() < 8 or (part > 0).sum() < 8:
            continue
        inside = np.cumsum(part)  # greatest where the belt ends
        at = int(np.argmax(inside))
        if at + 1 >= len(part) or x[first + at + 1] - x[first + at] > 8 * step_mm:
            continue
        places.append((float(y[first:last].mean()), 0.5 * (x[first + at] + x[first + at + 1])))
    if len(places) < _LEAST_STRIPS:
        return np.nan, np.nan
    return _line(np.array(places), side, step_mm)


def _line(places: NDArray[np.float64], side: int, step_mm: float) -> tuple[float, float]:
    """Value at y = 0 of a robust line through (N, 2) places y, x, and its σ."""
    design = np.column_stack([np.ones(len(places)), places[:, 0]])
    weight = np.ones(len(places))
    answer, noise, normal = np.zeros(2), 0.0, np.eye(2)
    for _ in range(8):
        normal = design.T @ (design * weight[:, None])
        answer = np.linalg.solve(normal, design.T @ (weight * places[:, 1]))
        residual = places[:, 1] - design @ answer
        noise = 1.4826 * float(np.median(np.abs(residual))) + 1e-6
        weight = np.clip(1 - (residual / (4.685 * noise)) ** 2, 0, None) ** 2 + 1e-9
    # an edge is known to a part of a pixel, however many strips it crosses
    sigma = float(np.hypot(noise * np.sqrt(np.linalg.inv(normal)[0, 0]), 0.3 * step_mm))
    return side * float(answer[0]), sigma
