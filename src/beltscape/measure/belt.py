"""The belt's frame, found on the empty belt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError, MeasureError
from beltscape.core.pose import Pose
from beltscape.measure.correlation import correlation
from beltscape.measure.flat import Middle, find_middle, reach
from beltscape.measure.plane import Plane, fit_plane
from beltscape.measure.section import Section, fit_section
from beltscape.measure.start import Start, find_start, frame_along

_SAMPLES = 60_000
_LEAST_MEASURED = 0.05
_ROUGHEST = 0.004
"""A belt's scatter about an even surface, per distance; heaped material has more."""


@dataclass(frozen=True, slots=True, eq=False)
class Belt:
    """Where the empty belt lies and what shape it has; x, z in the belt frame."""

    belt_from_core: Pose
    """Into the belt frame: origin where the core's optical axis meets the belt, x across, y along, z up."""
    x_mm: NDArray[np.float64]
    """(K,) float64 nodes across the belt, ascending."""
    z_mm: NDArray[np.float64]
    """(K,) float64 the empty cross-section's height there."""
    across_mm: tuple[float, float]
    """Reach of the belt in x, as far as it was seen."""
    flat_mm: tuple[float, float] | None
    """Ends in x of the flat centre; None for a V-shaped or round trough, which has none."""
    flat_rms_mm: float
    """Robust scatter of the depth map's points about the flat (about the cross-section where there is none)."""
    noise_mm: float
    """Robust scatter of the points about the cross-section, over the whole belt."""
    correlation_px: float
    """Side of the square of neighbouring pixels whose errors act as one, from the scatter itself."""
    drift_mm: float
    """Scatter that does not average out over areas of a hundred pixels: the depth map's slow errors."""
    tilt_sigma_rad: float
    """One standard deviation of the direction of z."""
    yaw_sigma_rad: float | None
    """One standard deviation of the direction of x; None where the belt does not tell it."""
    yaw_from: Literal["shape", "edges", "camera"]
    """What gave x: the trough's shape, the flat belt's edges, or (nothing else did) the core image's u axis."""

    def height_mm(self, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height of the empty belt at any x, held constant beyond its ends."""
        return np.interp(x_mm, self.x_mm, self.z_mm)


def find_belt(depth: DepthMap, camera: Camera) -> Belt:
    """Belt frame from an empty belt's depth map.

    The belt is taken for a surface that is the same all along: normals of small blocks give its direction, then
    direction and cross-section are fitted together to the points, robustly. The straight middle of the
    cross-section gives z; a trough without one stands upright on its line of symmetry. A flat belt does not show
    its direction: its edges do where they are seen, else x is the core image's u axis.

    Raises
    ------
    InputError
        if the depth map is not the camera's size.
    MeasureError
        if there is no belt-like surface under the optical axis.
    """
    width, height = camera.size_px
    if depth.depth_mm.shape != (height, width):
        rows, columns = depth.depth_mm.shape
        raise InputError(
            f"empty belt: the depth map is {columns}×{rows}, the core camera {width}×{height}; "
            "give the depth and the rig of one reconstruction"
        )
    if depth.coverage < _LEAST_MEASURED:
        raise MeasureError(
            f"empty belt: only {depth.coverage:.1%} of the pixels are measured; "
            "project speckle or give a better frame"
        )
    points = _sample(depth, camera)
    start = find_start(depth, camera, points)
    section = fit_section(points, start.rotation, turn_yaw=start.troughed)
    middle = _middle(section, float(np.median(points[:, 2])), camera)
    plane = _flat_plane(points @ section.rotation.T, middle)
    up = (
        np.array([-np.sin(middle.slope_rad), 0.0, np.cos(middle.slope_rad)])
        if plane is None
        else plane.normal
    )
    rotation = frame_along(section.rotation[1], up @ section.rotation)
    upright = fit_section(points, rotation, rounds=0)
    pose = Pose(rotation, -_foot(upright))
    flat = None
    if middle.flat_mm is not None:
        ends = np.array([[x, 0.0, section.height_mm(np.array([x]))[0]] for x in middle.flat_mm])
        flat = pose.apply(ends @ section.rotation)[:, 0]
    return _assemble(depth, camera, upright, pose, start, plane, flat)


def _sample(depth: DepthMap, camera: Camera) -> NDArray[np.float64]:
    """(N, 3) points of an even grid of pixels, in the camera's frame."""
    stride = max(1, round(np.sqrt(depth.measured.sum() / _SAMPLES)))
    z = depth.depth_mm[::stride, ::stride].astype(np.float64)
    points = np.concatenate([camera.rays()[::stride, ::stride] * z[..., None], z[..., None]], axis=-1)
    return points[np.isfinite(z)]


def _middle(section: Section, depth_mm: float, camera: Camera) -> Middle:
    """The section's flat or symmetry, once the section has shown to be a belt's."""
    if section.noise_mm > _ROUGHEST * depth_mm:
        raise MeasureError(
            f"empty belt: the surface scatters by {section.noise_mm:.1f} mm about any even belt; "
            "give the frame of an empty belt"
        )
    own = _reach(section)
    node_mm = section.noise_mm / np.sqrt(len(section.residual_mm) / len(section.x_mm))
    pixel_mm = depth_mm / float(camera.focal_px[0])
    return find_middle(section.x_mm[own], section.z_mm[own], 4 * node_mm + 0.1 * pixel_mm)


def _reach(section: Section) -> slice:
    """Nodes of the unbroken surface that the optical axis meets."""
    own = reach(section.x_mm, section.z_mm, section.noise_mm, float(_foot(section)[0]))
    if own is None:
        raise MeasureError(
            "empty belt: nothing measured where the core camera's optical axis meets the belt; "
            "aim the core camera at the belt"
        )
    return own


def _foot(section: Section) -> NDArray[np.float64]:
    """(3,) where the optical axis meets the section, in the section's frame."""
    axis = section.rotation[:, 2]
    distance = float(np.nanmedian(section.z_mm)) / axis[2]
    for _ in range(30):  # the axis is nearly upright: a few rounds settle it
        distance = float(section.height_mm(np.array([distance * axis[0]]))[0]) / axis[2]
    return distance * axis


def _flat_plane(points: NDArray[np.float64], middle: Middle) -> Plane | None:
    """Plane of the flat, its ends left out, from points in the section's frame."""
    if middle.flat_mm is None:
        return None
    left, right = middle.flat_mm
    inset = 0.04 * (right - left)
    return fit_plane(points[(points[:, 0] > left + inset) & (points[:, 0] < right - inset)])


def _assemble(
    depth: DepthMap,
    camera: Camera,
    section: Section,
    pose: Pose,
    start: Start,
    plane: Plane | None,
    flat: NDArray[np.float64] | None,
) -> Belt:
    """The belt, with what the scatter about it says of the depth map's errors."""
    own = _reach(section)
    x, z = section.x_mm[own] + pose.translation_mm[0], section.z_mm[own] + pose.translation_mm[2]
    known = np.isfinite(z)
    x, z = x[known], z[known]
    points = pose.apply(depth.points_mm(camera))
    residual = points[..., 2] - np.interp(points[..., 0], x, z, left=np.nan, right=np.nan)
    related = correlation(residual, section.noise_mm)
    # the samples stand for fewer independent ones where neighbouring pixels err together
    factor = float(np.sqrt(max(1.0, related.area_px * len(section.residual_mm) / depth.measured.sum())))
    yaw_sigma = section.sigma_rad[1] * factor if start.troughed else None
    yaw_sigma = start.edges.sigma_rad if start.edges is not None else yaw_sigma
    return Belt(
        belt_from_core=pose,
        x_mm=x,
        z_mm=z,
        across_mm=(float(x[0]), float(x[-1])),
        flat_mm=None if flat is None else (float(flat[0]), float(flat[1])),
        flat_rms_mm=section.noise_mm if plane is None else plane.rms_mm,
        noise_mm=section.noise_mm,
        correlation_px=float(np.sqrt(related.area_px)),
        drift_mm=related.drift_mm,
        tilt_sigma_rad=factor * (section.sigma_rad[0] if plane is None else plane.sigma_rad),
        yaw_sigma_rad=yaw_sigma,
        yaw_from="shape" if start.troughed else "camera" if start.edges is None else "edges",
    )
