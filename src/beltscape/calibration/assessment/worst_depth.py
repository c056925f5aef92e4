"""Cause of the largest standard deviation of depth: few cameras at the place, directions alike, or no board there.

σ of a depth is the product of two factors: the depth that one pixel of error in every image makes, which is the
cameras' geometry, and the error in pixels, which is how well lenses and poses are known there. The factor that
exceeds its median over the view more is the cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltscape.calibration.assessment.covariance import (
    DepthSigma,
    compute_depth_jacobian,
    compute_unit_depths,
    list_parameter_columns,
)
from beltscape.calibration.assessment.coverage import REACH, describe_place, project_beyond
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.core.arrays import Array, Mask
from beltscape.core.geometry.rig import Rig

MIN_RATIO = 2.0
"""Largest σ over the median from which it has a cause; over the view of a sound rig it rises to 1.5 at the edges."""


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """The point of the largest σ, and what is known of it."""

    point_mm: Array
    """(3,) in the core frame."""
    words: str
    """The place in the core's view."""
    sigma_mm: float
    ratio: float
    """Of its σ to the median."""
    geometry: float
    """Share of this ratio, as a logarithm, that the depth of one pixel of error has."""
    seeing: Sequence[str]
    """Cameras that see it."""
    usual: int
    """Median number of cameras that see a point."""
    largest: str
    """Camera whose parameters contribute most to the variance."""


def explain_worst_depth(
    rig: Rig, adjustment: BundleAdjustmentResult, covariance: Array, depth: DepthSigma
) -> str | None:
    """Return where σ of depth is largest, why, and the fix, in one line; None if it is even over the view.

    ``covariance`` (G, G) is that which ``depth`` was computed from.
    """
    x, y = np.meshgrid(depth.x_mm, depth.y_mm)
    points = np.stack([x, y, np.full_like(x, depth.depth_mm)], axis=-1).reshape(-1, 3)
    sigma = depth.sigma_mm.ravel()
    known = np.isfinite(sigma)
    if not known.any():
        return None
    worst, median_mm = int(np.nanargmax(sigma)), float(np.nanmedian(sigma))
    if sigma[worst] < MIN_RATIO * median_mm:
        return None
    unit_mm, sees = compute_unit_depths(rig, points)
    ratio = float(sigma[worst] / median_mm)
    unit_ratio = float(unit_mm[worst] / np.median(unit_mm[known]))
    place = _Place(
        points[worst],
        _describe_position(depth, points[worst]),
        float(sigma[worst]),
        ratio,
        float(np.log(max(unit_ratio, 1e-9)) / np.log(ratio)),
        [name for name, row in zip(rig.cameras, sees, strict=True) if row[worst]],
        int(np.median(sees.sum(axis=0)[known])),
        _find_largest(rig, covariance, points[worst], sees[:, worst]),
    )
    is_geometry = place.geometry >= 0.5
    cause = _describe_geometry(rig, place) if is_geometry else _describe_corners(rig, adjustment, place)
    return (
        f"σ of depth at {depth.depth_mm:.0f} mm is {median_mm:.2g} mm in the median and {place.sigma_mm:.3g} mm at "
        f"the worst place, {place.words}: {cause}"
    )


def _find_largest(rig: Rig, covariance: Array, point: Array, sees: Mask) -> str:
    """Return the camera, of those that see a point, whose parameters contribute most to the variance of its depth."""
    row = compute_depth_jacobian(rig, point[None])[0]
    parts = row * (covariance @ row)
    shares = [float(parts[list_parameter_columns(rig, i)].sum()) for i in range(len(rig.cameras))]
    return list(rig.cameras)[int(np.argmax(np.where(sees, shares, -np.inf)))]


def _describe_position(depth: DepthSigma, point: Array) -> str:
    span = np.array([np.ptp(depth.x_mm), np.ptp(depth.y_mm)])
    start = np.array([depth.x_mm[0], depth.y_mm[0]])
    place = _describe_pixel(((point[:2] - start) / span * 1000)[None], (1001, 1001))
    return f"{place} of the view of the core camera (x {point[0]:.0f} mm, y {point[1]:.0f} mm)"


def _describe_geometry(rig: Rig, place: _Place) -> str:
    """Return that few cameras see a place, or all from alike directions, and the fix."""
    limited = [name for name in rig.cameras if _is_beyond_lens(rig, name, place.point_mm)]
    rays = np.array([place.point_mm - rig.cam_from_core[name].center_mm for name in place.seeing])
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    apart_deg = float(np.rad2deg(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))))
    names = " and ".join(place.seeing) if len(place.seeing) < 4 else f"{len(place.seeing)} cameras"
    few = f", {place.usual} elsewhere" if len(place.seeing) < place.usual else ""
    seen = f"only {names} see it{few}, from directions {apart_deg:.1f}° apart"
    if not limited:
        return f"{seen}; aim another camera there, or leave it out of the measured width"
    name, camera = limited[0], rig.cameras[limited[0]]
    pixel, _ = project_beyond(camera, rig.cam_from_core[name], place.point_mm[None])
    return (
        f"{seen}, for {' and '.join(limited)} looks there beyond the radius up to which its lens is known "
        f"({camera.valid_radius_px:.0f} px); photograph the board {_describe_pixel(pixel, camera.size_px)} of "
        f"{name}'s image, about {place.point_mm[2]:.0f} mm away"
    )


def _is_beyond_lens(rig: Rig, name: str, point: Array) -> bool:
    """Return whether a point is in a camera's image, but beyond the radius up to which its lens is known."""
    camera = rig.cameras[name]
    pixels, beyond = project_beyond(camera, rig.cam_from_core[name], point[None])
    inside = ((pixels >= -0.5) & (pixels <= np.array(camera.size_px) - 0.5)).all()
    return bool(camera.valid_radius_px is not None and beyond[0] and inside)


def _describe_pixel(pixel: Array, size_px: tuple[int, int]) -> str:
    """Return where a pixel (1, 2) lies in the image."""
    place = describe_place(pixel, size_px)
    return "in the middle" if place.startswith("at all") else place


def _describe_corners(rig: Rig, adjustment: BundleAdjustmentResult, place: _Place) -> str:
    """Return in which image the board was never or seldom there, and what to photograph."""
    found = {name: _measure_gap(rig, adjustment, name, place.point_mm) for name in place.seeing}
    outside = {name: gap for name, gap in found.items() if gap[0] > gap[1]}
    name = (
        place.largest
        if place.largest in outside or not outside
        else max(outside, key=lambda n: outside[n][0])
    )
    gap_px, reach_px, near = found[name]
    camera = rig.cameras[name]
    pixel = camera.project(rig.cam_from_core[name].apply(place.point_mm[None]))
    where = _describe_pixel(pixel, camera.size_px)
    others = [other for other in outside if other != name]
    also = f" (so too {', '.join(others)})" if others else ""
    why = (
        f"the board never came there in the image of {name}{also}, whose lens is "
        f"extrapolated by {gap_px:.0f} px"
        if name in outside
        else f"only {near} corners lie within {reach_px:.0f} px of it in the image of {name}, whose lens or pose the "
        "views determine least there"
    )
    return f"{why}; photograph the board {where} of {name}'s image, about {place.point_mm[2]:.0f} mm away"


def _measure_gap(
    rig: Rig, adjustment: BundleAdjustmentResult, name: str, point: Array
) -> tuple[float, float, int]:
    """Return a pixel's distance from the nearest corner, the distance up to which corners count, and their number."""
    camera, index = rig.cameras[name], list(rig.cameras).index(name)
    observed = adjustment.bundle.observations
    corners = observed.pixels[adjustment.used & (observed.camera == index)]
    reach_px = REACH * float(np.hypot(*camera.size_px))
    pixel = camera.project(rig.cam_from_core[name].apply(point[None]))[0]
    distance = np.linalg.norm(corners - pixel, axis=1)
    return float(distance.min(initial=np.inf)), reach_px, int((distance <= reach_px).sum())
