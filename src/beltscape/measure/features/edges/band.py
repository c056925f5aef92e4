"""The pixels about one edge of an upper face, in coordinates across and along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.measure.features.face import Face, rays_at
from beltscape.measure.features.pose.nominal import NOTHING, NominalView
from beltscape.measure.features.view import MATCHER_REACH_PX, scale_of

WIDE_PX = 9.0
"""Half of a band's width."""
BIN_PX = 1.5
"""Length of the pieces along the edge that are judged one by one."""
_NEXT_PX = (1.0, 3.5)
"""What lies so far outside may hide the edge; up to the farther it should be one thing: a strip is another step."""
_MIXED_PX = 1.0
"""About something else, a pixel is of both."""
_NEARER_MM = 1.0
_SIDE_SHARE = 0.15
"""Of what lies beyond an edge: with more of the solid's own side the edge is a crease."""


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Pixels about an edge; what hides the edge, or steps beside it, has been left out."""

    across_px: NDArray[np.float64]
    """(N,) from where the edge should be, outwards, in pixels on the face."""
    along_px: NDArray[np.float64]
    """(N,) along it, from its middle."""
    bins: NDArray[np.intp]
    """(N,) number of the piece along the edge."""
    shapes: NDArray[np.float64]
    """(N, J) how the edge moves across when a nuisance (tilt; shifts of a circle) grows by one px."""
    index: NDArray[np.intp]
    """(N,) into the raveled image."""
    px_mm: float
    """Size of a pixel on the face."""
    off_mm: NDArray[np.float32]
    """(N,) measured depth minus the face's, NaN where not measured."""
    clear: NDArray[np.bool_]
    """(N,) whether the matcher's windows met nothing else near its piece: else its depth says nothing of the edge."""
    kind: Literal["outline", "crease", "round"]
    """Crease: one sees the solid's own side beyond the edge; a round edge is partly this, partly that."""


@dataclass(frozen=True, slots=True, eq=False)
class OnFace:
    """Where the pixels around a face lie in its plane."""

    window: tuple[slice, slice]
    """Rows and columns."""
    x_mm: NDArray[np.float64]
    """(h, w) along the module's x, from the place given."""
    y_mm: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    """(h, w) of the plane."""
    px_mm: float
    scale: float
    """See `scale_of`."""


def on_face(
    face: Face,
    camera: Camera,
    center_mm: NDArray[np.float64],
    axes: tuple[NDArray[np.float64], NDArray[np.float64]],
    half_mm: float,
) -> OnFace:
    """The face's plane about ``center_mm`` (3,), with directions (3,) that are brought into it."""
    normal = face.normal
    x_axis = axes[0] - (axes[0] @ normal) * normal
    x_axis /= np.linalg.norm(x_axis)
    y_axis = axes[1] - (axes[1] @ normal) * normal - (axes[1] @ x_axis) * x_axis
    y_axis /= np.linalg.norm(y_axis)
    height, _ = face.above(center_mm)
    center = center_mm - height * normal
    pixel = float(center[2] / camera.focal_px.mean())
    reach = half_mm / pixel + WIDE_PX + 2
    u, v = center[:2] / center[2] * camera.focal_px + camera.center_px
    width, tall = camera.size_px
    window = (
        slice(max(int(v - reach), 0), max(min(int(v + reach) + 1, tall), 0)),
        slice(max(int(u - reach), 0), max(min(int(u + reach) + 1, width), 0)),
    )
    rays = rays_at(camera, *np.mgrid[window])
    depth = face.depth_at(rays)
    local = rays * depth[..., None] - center
    return OnFace(window, local @ x_axis, local @ y_axis, depth, pixel, scale_of(camera))


def straight_band(
    plane: OnFace,
    view: NominalView,
    label: int,
    depth_mm: NDArray[np.float32],
    half_mm: tuple[float, float],
    axis: int,
    sign: int,
) -> Band | None:
    """About the edge at ``sign · half_mm[axis]`` along the axis; None where too little of it is to be seen."""
    coordinates = plane.x_mm, plane.y_mm
    across = (sign * coordinates[axis] - half_mm[axis]) / plane.px_mm
    along = coordinates[1 - axis] / plane.px_mm
    reach = half_mm[1 - axis] / plane.px_mm - 5
    near = (np.abs(across) < WIDE_PX) & (np.abs(along) < reach)
    return _band(plane, view, label, depth_mm, near, across, along, along[..., None] / max(reach, 1.0))


def round_band(
    plane: OnFace, view: NominalView, label: int, depth_mm: NDArray[np.float32], radius_mm: float
) -> Band | None:
    """About a circle of that radius around the plane's origin."""
    far = np.hypot(plane.x_mm, plane.y_mm)
    across = (far - radius_mm) / plane.px_mm
    angle = np.arctan2(plane.y_mm, plane.x_mm)
    near = np.abs(across) < min(WIDE_PX, 0.7 * radius_mm / plane.px_mm)
    shapes = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return _band(plane, view, label, depth_mm, near, across, angle * radius_mm / plane.px_mm, shapes)


def _band(
    plane: OnFace,
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
    last = _furthest(bins, across, count, ((labels != label) | ~tops) & (across < -1.0))
    next_ = -_furthest(bins, -across, count, over & (across > 1.0))
    bad = (last > -_NEXT_PX[1]) | (next_ < _NEXT_PX[1])
    outside = (across > 0.15) & (across < _NEXT_PX[1]) & (labels != label)
    highest, lowest = np.full(count, NOTHING - 1), np.full(count, np.iinfo(np.int16).max)
    np.maximum.at(highest, bins[outside], labels[outside])
    np.minimum.at(lowest, bins[outside], labels[outside])
    bad |= (highest > lowest) & (highest >= NOTHING)
    keep = ~bad[bins] & (across > last[bins] + _MIXED_PX) & (across < next_[bins] - _MIXED_PX)
    if keep.sum() < 60:
        return None
    rows, columns = np.mgrid[window]
    at = (rows * view.label.shape[1] + columns)[near][keep]
    off = (depth_mm.ravel()[at] - plane.depth_mm[near][keep]).astype(np.float32)
    beyond = keep & (across > 0.7) & (across < _NEXT_PX[1])
    crease = bool(beyond.any()) and float(np.mean(labels[beyond] == label)) > _SIDE_SHARE
    kind = "round" if shapes.shape[1] == 2 else "crease" if crease else "outline"
    reach = min(MATCHER_REACH_PX * plane.scale + 2, WIDE_PX)
    clear = ((last < -reach) & (next_ > reach))[bins[keep]]
    return Band(across[keep], along[keep], bins[keep], shapes[keep], at, plane.px_mm, off, clear, kind)


def _furthest(
    bins: NDArray[np.intp], across: NDArray[np.float64], count: int, other: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(count,) the largest place across of what is something else, by piece; far inside where nothing is."""
    furthest = np.full(count, -np.inf)
    np.maximum.at(furthest, bins[other], across[other])
    return furthest
