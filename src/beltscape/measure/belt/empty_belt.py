"""The empty belt from its depth maps: belt frame, cross-section, deviation and edges.

Several depth maps of the static surface are joined by a robust mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_depth_of
from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt, End
from beltscape.core.errors import InputError, MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.measure.belt.cross_section import (
    STEP_MM,
    BeltCrossSection,
    estimate_correlation,
    estimate_node_sigma,
    fit_cross_section,
    fit_deviation,
    refine_section,
)
from beltscape.measure.belt.edges import Middle, find_belt_edges, find_continuous_nodes, find_middle
from beltscape.measure.belt.extent import (
    BeltExtent,
    find_component,
    find_extent,
    keep_pixels,
    mask_region,
    on_belt_mask,
    prolong,
    select_pixels,
)
from beltscape.measure.belt.given import apply_given
from beltscape.measure.belt.initial_frame import (
    InitialFrame,
    Plane,
    build_frame,
    find_initial_frame,
    fit_block_planes,
    fit_plane,
)
from beltscape.measure.belt.settings import NOTHING_GIVEN, GivenBelt

_BAND_ROWS = 64
"""Rows processed at a time, so that any number of frames fits into memory."""
_MIN_SHARE = 0.3
"""A pixel measured in fewer of the frames stays unmeasured."""


def average_depth_maps(frames: Sequence[DepthMap]) -> DepthMap:
    """Return the robust mean of depth maps of one size, pixel by pixel.

    Values further from their pixel's median than four robust standard deviations are rejected. σ becomes the
    root mean square σ over the root of the number of values: the errors count as independent between frames.
    """
    if len(frames) == 1:
        return frames[0]
    shape = frames[0].depth_mm.shape
    depth, sigma = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    views, confidence = np.zeros(shape, np.uint8), np.zeros(shape, np.float32)
    for top in range(0, shape[0], _BAND_ROWS):
        rows = slice(top, top + _BAND_ROWS)
        z = np.stack([frame.depth_mm[rows] for frame in frames]).astype(np.float64)
        use = _inlier_mask(z)
        number = use.sum(axis=0)
        enough = number >= max(1.0, _MIN_SHARE * len(frames))
        count = np.maximum(number, 1)

        def mean(values: NDArray[np.float64], use: NDArray[np.bool_] = use) -> NDArray[np.float64]:
            return np.where(use, values, 0.0).sum(axis=0) / np.maximum(use.sum(axis=0), 1)

        square = mean(np.stack([frame.sigma_mm[rows] for frame in frames]).astype(np.float64) ** 2)
        depth[rows] = np.where(enough, mean(z), np.nan)
        sigma[rows] = np.where(enough, np.sqrt(square / count), np.nan)
        confidence[rows] = enough * mean(np.stack([f.confidence[rows] for f in frames]).astype(np.float64))
        views[rows] = np.where(enough, np.max(np.where(use, [f.views[rows] for f in frames], 0), axis=0), 0)
    return DepthMap(depth, sigma, views, confidence)


def _inlier_mask(z: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which values (N, H, W) lie near their pixel's median."""
    measured = np.isfinite(z)
    ranked = np.sort(np.where(measured, z, np.inf), axis=0)
    median = _median_of_ranked(ranked, measured.sum(axis=0))
    off = np.abs(np.where(measured, z, np.inf) - np.where(np.isfinite(median), median, 0.0))
    spread = MAD_TO_SIGMA * _median_of_ranked(np.sort(off, axis=0), measured.sum(axis=0))
    # the scatter of few values is uncertain: it counts as at least the band's typical scatter
    usual = float(np.median(spread[np.isfinite(spread)])) if np.isfinite(spread).any() else 0.0
    return measured & (off <= 4 * np.maximum(np.where(np.isfinite(spread), spread, 0.0), usual) + 1e-9)


def _median_of_ranked(ranked: NDArray[np.float64], count: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the median (H, W) of the first ``count`` of the ranked values (N, H, W); inf where there is none."""
    last = len(ranked) - 1
    low = np.clip((count - 1) // 2, 0, last)[None]
    high = np.clip(count // 2, 0, last)[None]
    both = np.take_along_axis(ranked, low, 0)[0] + np.take_along_axis(ranked, high, 0)[0]
    return np.where(count > 0, 0.5 * both, np.inf)


_SAMPLE_COUNT = 60_000
"""Approximate number of pixels to which the depth map is thinned; it bounds the time."""
_MIN_COVERAGE = 0.05
"""Least measured share of the image."""
_MAX_ROUGHNESS = 0.004
"""Largest scatter of a belt about an even surface, as a share of its distance; heaped material has more."""
_LEAST_NODES = 12
"""Measured nodes of the cross-section, of at least 40, without which it shows no belt; chosen."""
_MIN_EVEN_SHARE = 0.6
"""Least share of a belt's points that lie on it: a beam across the view and 2 % of gross errors leave 0.8; a heap of
balls has 0.2."""
_MIN_CLEAR_SHARE = 0.25
"""A strip narrower than this share of the view, with something higher on both sides, lies between lumps; chosen."""


def learn_belt(frames: Sequence[DepthMap], camera: Camera, given: GivenBelt = NOTHING_GIVEN) -> Belt:
    """Return the empty belt from any number of its depth maps.

    The depth maps are averaged robustly, pixel by pixel. The result holds all that `find_belt` finds, and the
    belt's edges. Errors that all frames share, such as those of the rig or of a static pattern, do not average
    out; the scatter about the belt, from which every σ is derived, contains them. ``given`` is what is known of its
    width, its ends or its place in the image.

    Raises
    ------
    InputError
        if there is no frame, or one is not the camera's size.
    MeasureError
        if there is no belt-like surface under the optical axis, or what is given contradicts it.
    """
    if not frames:
        raise InputError("empty belt: no frame given; give at least one frame of the empty belt")
    for depth in frames:
        require_depth_of(camera, depth, "empty belt")
    mean = average_depth_maps(frames)
    belt = replace(find_belt(mean, camera, given.region_px, given.travel_deg), frames=len(frames))
    belt = replace(belt, edges=find_belt_edges(mean, camera, belt), camera=camera)
    return apply_given(belt, given)


def find_belt(
    depth: DepthMap,
    camera: Camera,
    region_px: Sequence[tuple[float, float]] | None = None,
    travel_deg: float | None = None,
) -> Belt:
    """Return the belt found in an empty belt's depth map.

    The belt is modelled as a surface that is constant along its direction of travel. The blocks of pixels that form
    one surface under the optical axis (or the largest one in the polygon ``region_px``) give a first direction;
    direction and cross-section are then fitted together to the points, robustly. Its ends are found along the core
    camera's rays; what lies below, above or beyond them is no belt, and is not used. The z
    axis is the normal of the cross-section's flat middle, or the line of symmetry of a trough without one. A flat
    belt gives no direction: it is taken from the belt's edges where they are visible, else from ``travel_deg``, the
    given direction of travel (`GivenBelt`); without it x is the core image's u axis.

    Raises
    ------
    InputError
        if the depth map is not the camera's size.
    MeasureError
        if there is no belt-like surface under the optical axis.
    """
    require_depth_of(camera, depth, "empty belt")
    if depth.coverage < _MIN_COVERAGE:
        raise MeasureError(
            f"empty belt: only {depth.coverage:.1%} of the pixels are measured; "
            "project speckle or give a better frame"
        )
    depth = depth if region_px is None else mask_region(depth, region_px)
    start, part, extent = _find_section(depth, camera, travel_deg, largest=region_px is not None)
    points = _sample_points(depth, camera)
    points = points[on_belt_mask(points, part, extent.across_mm)]
    section = fit_cross_section(points, part.rotation, turn_yaw=start.troughed)
    middle = _find_checked_middle(section, float(np.median(points[:, 2])), camera)
    plane = _fit_flat_plane(points @ section.rotation.T, middle)
    up = (
        np.array([-np.sin(middle.slope_rad), 0.0, np.cos(middle.slope_rad)])
        if plane is None
        else plane.normal
    )
    rotation = build_frame(section.rotation[1], up @ section.rotation)
    upright = fit_cross_section(points, rotation, rounds=0)
    pose = Pose(rotation, -_intersect_optical_axis(upright))
    flat = None
    if middle.flat_mm is not None:
        ends = np.array([[x, 0.0, section.height_mm(np.array([x]))[0]] for x in middle.flat_mm])
        flat = pose.apply(ends @ section.rotation)[:, 0]
    belt = _assemble_belt(depth, camera, upright, pose, start, plane, flat)
    if belt.yaw_from == "camera" and travel_deg is not None:
        belt = replace(belt, yaw_from="told")
    ends = extent.ends if region_px is None else _tell_ends(extent.ends)
    return replace(belt, ends=ends, clear_mm=_convert_clear(extent, part, belt.belt_from_core))


def _convert_clear(extent: BeltExtent, section: BeltCrossSection, pose: Pose) -> tuple[float, float]:
    """Return the range that is clear of things beside the belt, in the belt frame."""
    x = np.array(extent.clear_mm)
    known = np.where(np.isfinite(x), x, 0.0)
    points = np.column_stack([known, np.zeros(2), prolong(section, known)]) @ section.rotation
    low, high = np.where(np.isfinite(x), pose.apply(points)[:, 0], x)
    return float(low), float(high)


def _find_section(
    depth: DepthMap, camera: Camera, travel_deg: float | None, *, largest: bool
) -> tuple[InitialFrame, BeltCrossSection, BeltExtent]:
    """Return the frame and the section of the surface's blocks, and the extent of the belt that continues it."""
    side = max(8, camera.size_px[0] // 38)
    blocks = fit_block_planes(depth, camera, side)
    own = find_component(blocks, camera, side, largest=largest)
    surface = depth
    if not own.all():
        surface = keep_pixels(depth, select_pixels(depth, camera, blocks.select(own), side))
    points = _sample_points(surface, camera)
    start = find_initial_frame(depth, camera, blocks.select(own), points, travel_deg)
    section = fit_cross_section(points, start.rotation, turn_yaw=start.troughed)
    if np.isfinite(section.z_mm).sum() < _LEAST_NODES:
        raise MeasureError(
            "empty belt: too few measured points across; project speckle or give a better frame"
        )
    stride = max(1, round(np.sqrt(depth.depth_mm.size / _SAMPLE_COUNT)))
    extent = find_extent(depth, camera, section, stride)
    if extent.even_share < _MIN_EVEN_SHARE:
        raise MeasureError(
            f"empty belt: only {extent.even_share:.0%} of what was measured between its ends lies on one even "
            "surface; give the frame of an empty belt"
        )
    width_mm, view_mm = (
        np.ptp(extent.across_mm),
        np.nanmedian(depth.depth_mm) * np.ptp(camera.rays()[0, :, 0]),
    )
    if extent.ends == ("covered", "covered") and width_mm < _MIN_CLEAR_SHARE * view_mm:
        raise MeasureError(
            f"empty belt: something higher stands on both sides of a strip {width_mm:.0f} mm wide; "
            "give the frame of an empty belt, or draw the belt's region (measure belt --region)"
        )
    return start, section, extent


def _tell_ends(ends: tuple[End, End]) -> tuple[End, End]:
    """Return the ends of a belt in a region that was given: its border is an end that was given."""

    def tell(end: End) -> End:
        return "told" if end in ("out of view", "unmeasured") else end

    return tell(ends[0]), tell(ends[1])


def _sample_points(depth: DepthMap, camera: Camera) -> NDArray[np.float64]:
    """Return points (N, 3) of an even grid of pixels, in the camera's frame."""
    stride = max(1, round(np.sqrt(depth.measured.sum() / _SAMPLE_COUNT)))
    z = depth.depth_mm[::stride, ::stride].astype(np.float64)
    points = np.concatenate([camera.rays(slice(None, None, stride)) * z[..., None], z[..., None]], axis=-1)
    return points[np.isfinite(z)]


def _find_checked_middle(section: BeltCrossSection, depth_mm: float, camera: Camera) -> Middle:
    """Return the section's flat or symmetry; refuse a section that scatters more than a belt's."""
    if section.noise_mm > _MAX_ROUGHNESS * depth_mm:
        raise MeasureError(
            f"empty belt: the surface scatters by {section.noise_mm:.1f} mm about any even belt; "
            "give the frame of an empty belt"
        )
    own = _find_belt_nodes(section)
    node_mm = section.noise_mm / np.sqrt(len(section.residual_mm) / len(section.x_mm))
    pixel_mm = depth_mm / float(camera.focal_px[0])
    return find_middle(section.x_mm[own], section.z_mm[own], 4 * node_mm + 0.1 * pixel_mm)


def _find_belt_nodes(section: BeltCrossSection) -> slice:
    """Return the nodes of the continuous surface that the optical axis meets."""
    own = find_continuous_nodes(
        section.x_mm, section.z_mm, section.noise_mm, float(_intersect_optical_axis(section)[0])
    )
    if own is None:
        raise MeasureError(
            "empty belt: no belt was measured where the core camera's optical axis meets it; "
            "give the frame of an empty belt, and aim the core camera at the belt"
        )
    return own


def _intersect_optical_axis(section: BeltCrossSection) -> NDArray[np.float64]:
    """Return the point (3,) where the optical axis meets the section, in the section's frame."""
    axis = section.rotation[:, 2]
    distance = float(np.nanmedian(section.z_mm)) / axis[2]
    for _ in range(30):  # the axis is nearly vertical: a few iterations converge
        distance = float(section.height_mm(np.array([distance * axis[0]]))[0]) / axis[2]
    return distance * axis


def _fit_flat_plane(points: NDArray[np.float64], middle: Middle) -> Plane | None:
    """Fit a plane to the flat without its ends, from points in the section's frame."""
    if middle.flat_mm is None:
        return None
    left, right = middle.flat_mm
    inset = 0.04 * (right - left)
    return fit_plane(points[(points[:, 0] > left + inset) & (points[:, 0] < right - inset)])


def _assemble_belt(
    depth: DepthMap,
    camera: Camera,
    section: BeltCrossSection,
    pose: Pose,
    start: InitialFrame,
    plane: Plane | None,
    flat: NDArray[np.float64] | None,
) -> Belt:
    """Return the belt with the errors of the depth map, estimated from the scatter about it."""
    own = _find_belt_nodes(section)
    x, z = section.x_mm[own] + pose.translation_mm[0], section.z_mm[own] + pose.translation_mm[2]
    measured = np.isfinite(z)
    x, z = x[measured], z[measured]
    points = pose.apply(depth.points_mm(camera))
    x, z = refine_section(
        x, z, points, pixel_mm=abs(float(pose.translation_mm[2])) / float(camera.focal_px[0])
    )
    # the refined section may meet the optical axis at another height: move the origin to it
    lift = np.array([0.0, 0.0, float(np.interp(0.0, x, z))])
    pose, points, z = Pose(pose.rotation, pose.translation_mm - lift), points - lift, z - lift[2]
    expected_z = cast("NDArray[np.float64]", np.interp(points[..., 0], x, z, left=np.nan, right=np.nan))
    residual = points[..., 2] - expected_z
    noise = section.noise_mm
    correlation = estimate_correlation(residual, noise)
    deviation = fit_deviation(points, residual, noise, correlation.area_px)
    if deviation is not None:
        residual = residual - deviation.interpolate(points[..., 0], points[..., 1])
        noise = MAD_TO_SIGMA * float(np.nanmedian(np.abs(residual)))
        correlation = estimate_correlation(residual, noise)
    # correlated errors of neighbouring pixels reduce the number of independent samples
    factor = float(np.sqrt(max(1.0, correlation.area_px * len(section.residual_mm) / depth.measured.sum())))
    yaw_sigma = section.sigma_rad[1] * factor if start.troughed else None
    yaw_sigma = start.edges.sigma_rad if start.edges is not None else yaw_sigma
    inside = np.abs(residual) <= max(6 * noise, STEP_MM)  # NaN is not
    low, high = np.quantile(points[..., 1][inside], [0.001, 0.999])
    return Belt(
        belt_from_core=pose,
        x_mm=x,
        z_mm=z,
        across_mm=(float(x[0]), float(x[-1])),
        flat_mm=None if flat is None else (float(flat[0]), float(flat[1])),
        flat_rms_mm=section.noise_mm if plane is None else plane.rms_mm,
        noise_mm=noise,
        correlation_px=float(np.sqrt(correlation.area_px)),
        drift_mm=correlation.drift_mm,
        tilt_sigma_rad=factor * (section.sigma_rad[0] if plane is None else plane.sigma_rad),
        yaw_sigma_rad=yaw_sigma,
        yaw_from="shape" if start.troughed else "camera" if start.edges is None else "edges",
        z_sigma_mm=estimate_node_sigma(x, points[..., 0][inside], noise, correlation.area_px),
        along_mm=(float(low), float(high)),
        deviation=deviation,
        edges=None,
        claimed_sigma_mm=float(np.median(depth.sigma_mm[depth.measured])),
        frames=1,
    )
