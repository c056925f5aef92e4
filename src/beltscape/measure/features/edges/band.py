"""The pixels around one edge of an upper face, in coordinates across and along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.measure.features.face import Face, compute_rays
from beltscape.measure.features.matcher_scale import MATCHER_REACH_PX, compute_camera_scale
from beltscape.measure.features.pose.nominal import NO_PART, NominalView

WIDE_PX = 9.0
"""Half of a band's width."""
BIN_PX = 1.5
"""Length of the pieces along the edge that are evaluated one by one."""
_NEXT_PX = (1.0, 3.5)
"""Range outside the edge in which another part may occlude it; two parts in this range mean a second step."""
_MIXED_PX = 1.0
"""Pixels this near to another part are mixed."""
_NEARER_MM = 1.0
"""A part nearer to the camera by more than this occludes the edge."""
_SIDE_SHARE = 0.15
"""With a larger share of the solid's own side beyond an edge, the edge is a crease."""


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Pixels around an edge, without those that occlude it or lie beyond a second step."""

    across_px: NDArray[np.float64]
    """(N,) distance from the nominal edge, outwards, in pixels on the face."""
    along_px: NDArray[np.float64]
    """(N,) position along the edge, from its middle."""
    bins: NDArray[np.intp]
    """(N,) number of the piece along the edge."""
    shapes: NDArray[np.float64]
    """(N, J) derivative of the edge's position across by the nuisance parameters (tilt; shifts of a circle)."""
    index: NDArray[np.intp]
    """(N,) index into the flattened image."""
    px_mm: float
    """Size of a pixel on the face."""
    off_mm: NDArray[np.float32]
    """(N,) measured depth minus the face's, NaN where not measured."""
    clear: NDArray[np.bool_]
    """(N,) whether no other part lies within the matcher's windows at its piece, so that its depth can be used."""
    kind: Literal["outline", "crease", "round"]
    """Crease: the solid's own side is visible beyond the edge; a round edge is partly outline, partly crease."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceCoordinates:
    """Coordinates in a face's plane of the pixels around it."""

    window: tuple[slice, slice]
    """Rows and columns."""
    x_mm: NDArray[np.float64]
    """(h, w) along the module's x, from the given centre."""
    y_mm: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    """(h, w) depth of the plane."""
    px_mm: float
    scale: float
    """See `compute_camera_scale`."""


def compute_face_coordinates(
    face: Face,
    camera: Camera,
    center_mm: NDArray[np.float64],
    axes: tuple[NDArray[np.float64], NDArray[np.float64]],
    half_mm: float,
) -> FaceCoordinates:
    """Return the coordinates in the face's plane around ``center_mm`` (3,), along projected ``axes`` (3,)."""
    normal = face.normal
    x_axis = axes[0] - (axes[0] @ normal) * normal
    x_axis /= np.linalg.norm(x_axis)
    y_axis = axes[1] - (axes[1] @ normal) * normal - (axes[1] @ x_axis) * x_axis
    y_axis /= np.linalg.norm(y_axis)
    height, _ = face.height_above(center_mm)
    center = center_mm - height * normal
    pixel = float(center[2] / camera.focal_px.mean())
    reach = half_mm / pixel + WIDE_PX + 2
    u, v = center[:2] / center[2] * camera.focal_px + camera.center_px
    width, tall = camera.size_px
    window = (
        slice(max(int(v - reach), 0), max(min(int(v + reach) + 1, tall), 0)),
        slice(max(int(u - reach), 0), max(min(int(u + reach) + 1, width), 0)),
    )
    rays = compute_rays(camera, *np.mgrid[window])
    depth = face.depth_at(rays)
    local = rays * depth[..., None] - center
    return FaceCoordinates(window, local @ x_axis, local @ y_axis, depth, pixel, compute_camera_scale(camera))


def make_straight_band(
    plane: FaceCoordinates,
    view: NominalView,
    label: int,
    depth_mm: NDArray[np.float32],
    half_mm: tuple[float, float],
    axis: int,
    sign: int,
) -> Band | None:
    """Return the band around the edge at ``sign · half_mm[axis]``; None where too little of it is visible."""
    coordinates = plane.x_mm, plane.y_mm
    across = (sign * coordinates[axis] - half_mm[axis]) / plane.px_mm
    along = coordinates[1 - axis] / plane.px_mm
    reach = half_mm[1 - axis] / plane.px_mm - 5
    near = (np.abs(across) < WIDE_PX) & (np.abs(along) < reach)
    return _select_pixels(
        plane, view, label, depth_mm, near, across, along, along[..., None] / max(reach, 1.0)
    )


def make_round_band(
    plane: FaceCoordinates, view: NominalView, label: int, depth_mm: NDArray[np.float32], radius_mm: float
) -> Band | None:
    """Return the band around a circle about the plane's origin; None where too little of it is visible."""
    far = np.hypot(plane.x_mm, plane.y_mm)
    across = (far - radius_mm) / plane.px_mm
    angle = np.arctan2(plane.y_mm, plane.x_mm)
    near = np.abs(across) < min(WIDE_PX, 0.7 * radius_mm / plane.px_mm)
    shapes = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return _select_pixels(plane, view, label, depth_mm, near, across, angle * radius_mm / plane.px_mm, shapes)


def _select_pixels(
    plane: FaceCoordinates,
    view: NominalView,
    label: int,
    depth_mm: NDArray[np.float32],
    near: NDArray[np.bool_],
    across: NDArray[np.float64],
    along: NDArray[np.float64],
    shapes: NDArray[np.float64],
) -> Band | None:
    if near.sum() < 60:
        return None
    window = plane.window
    labels, tops, nominal = view.label[window][near], view.top[window][near], view.depth_mm[window][near]
    across, along, shapes = across[near], along[near], shapes[near]
    bins = np.floor((along - along.min()) / BIN_PX).astype(np.intp)
    count = int(bins.max()) + 1
    over = nominal < plane.depth_mm[near] - _NEARER_MM
    last = _find_outermost(bins, across, count, ((labels != label) | ~tops) & (across < -1.0))
    next_part = -_find_outermost(bins, -across, count, over & (across > 1.0))
    occluded = (last > -_NEXT_PX[1]) | (next_part < _NEXT_PX[1])
    outside = (across > 0.15) & (across < _NEXT_PX[1]) & (labels != label)
    highest, lowest = np.full(count, NO_PART - 1), np.full(count, np.iinfo(np.int16).max)
    np.maximum.at(highest, bins[outside], labels[outside])
    np.minimum.at(lowest, bins[outside], labels[outside])
    occluded |= (highest > lowest) & (highest >= NO_PART)
    keep = ~occluded[bins] & (across > last[bins] + _MIXED_PX) & (across < next_part[bins] - _MIXED_PX)
    if keep.sum() < 60:
        return None
    rows, columns = np.mgrid[window]
    at = (rows * view.label.shape[1] + columns)[near][keep]
    off = (depth_mm.ravel()[at] - plane.depth_mm[near][keep]).astype(np.float32)
    beyond = keep & (across > 0.7) & (across < _NEXT_PX[1])
    crease = bool(beyond.any()) and float(np.mean(np.equal(labels[beyond], label))) > _SIDE_SHARE
    kind = "round" if shapes.shape[1] == 2 else "crease" if crease else "outline"
    reach = min(MATCHER_REACH_PX * plane.scale + 2, WIDE_PX)
    clear = ((last < -reach) & (next_part > reach))[bins[keep]]
    return Band(across[keep], along[keep], bins[keep], shapes[keep], at, plane.px_mm, off, clear, kind)


def _find_outermost(
    bins: NDArray[np.intp], across: NDArray[np.float64], count: int, other: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the outermost position across (count,) of other parts, by piece; -inf where there are none."""
    furthest = np.full(count, -np.inf)
    np.maximum.at(furthest, bins[other], across[other])
    return furthest
