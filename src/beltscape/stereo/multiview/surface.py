"""The surface on the core's grid: inverse depth and its slopes, its depth steps, and its visibility.

The planes (H, W) of that grid have NaN where there is nothing. An auxiliary sees a point of the surface that projects
into its image with nothing in front of it.

The normalised inverse depth s has a unit of about a pixel of disparity:

s is 1/Z divided by a rig's `inverse_depth_scale`, on the core's undistorted grid. A packed projection is a row of 39
numbers that maps a pixel of that grid with its s into a camera's image; `kernels.projection` defines it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels
from beltscape.kernels.planes import dilate, erode, find_plane_kernels, repeat_blocks
from beltscape.kernels.projection import pack_lens

STEP_PX = 2.5
"""Range of s within 5 × 5 pixels above which there may be a depth step."""
OCCLUDER_PX = 2.0
"""Distance (px of disparity) by which an occluder lies in front of a pixel: more than a slope accounts for."""
_RADIUS, _SIGMA, _TOLERANCE = 3, 2.0, 2.0
"""Window and tolerance (px) of the fit of slopes."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Inverse depth s of every pixel with its slopes; NaN where there is none."""

    s: NDArray[np.float32]
    """(H, W) inverse depth, px of the grid."""
    slope_u: NDArray[np.float32]
    """(H, W) derivative of s along u, per pixel."""
    slope_v: NDArray[np.float32]
    """(H, W) derivative of s along v, per pixel."""

    def keep(self, kernels: Kernels) -> Surface:
        """Return the surface for several kernels, see `beltscape.kernels.Kernels.keep`."""
        return Surface(kernels.keep(self.s), kernels.keep(self.slope_u), kernels.keep(self.slope_v))

    def replace_where(self, mask: NDArray[np.bool_], other: Surface) -> Surface:
        """Return the other surface inside the mask (H, W) and this one outside."""
        return Surface(
            np.where(mask, other.s, self.s),
            np.where(mask, other.slope_u, self.slope_u),
            np.where(mask, other.slope_v, self.slope_v),
        )


def fill_nan(plane: NDArray[np.floating], value: float = 0.0) -> NDArray[np.float32]:
    """Return a copy with ``value`` in place of NaN; about ten times faster than `numpy.nan_to_num`."""
    if find_plane_kernels(plane):
        return np.where(np.isnan(plane), np.float32(value), plane)
    filled = np.array(plane, np.float32, order="C")
    cv2.patchNaNs(filled, value)
    return filled


def enlarge_blocks(small: NDArray[np.floating], factor: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return (H, W) every value repeated over its block; the last row and column extend to the edge of ``shape``."""
    return repeat_blocks(small.astype(np.float32, copy=False), factor, shape)


def detect_depth_steps(s: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels around which s ranges over more than `STEP_PX` within 5 × 5 pixels.

    NaN counts as 0.
    """
    s = fill_nan(s)
    span = dilate(s, (5, 5))
    span -= erode(s, (5, 5))
    return span > STEP_PX


def upsample_surface(surface: Surface, step: int) -> NDArray[np.float32]:
    """Return (step · H, step · W) s, in units of the coarse grid, by continuing every pixel's plane over its block.

    Nothing is interpolated between blocks, so depth steps stay sharp.
    """
    if step == 1:
        return surface.s
    offsets = ((np.arange(step) - (step - 1) / 2) / step).astype(np.float32)
    height, width = surface.s.shape
    if find_plane_kernels(surface.s):
        planes = surface.s, surface.slope_u, surface.slope_v
        s, slope_u, slope_v = (enlarge_blocks(plane, step, (height * step, width * step)) for plane in planes)
        du, dv = np.tile(offsets, width), np.tile(offsets, height)
        return cast("NDArray[np.float32]", s + slope_u * du + slope_v * dv[:, None])
    fine = np.empty((height * step, width * step), np.float32)
    for column, du in enumerate(offsets):
        s_at_column = surface.s + surface.slope_u * du
        for row, dv in enumerate(offsets):
            fine[row::step, column::step] = s_at_column + surface.slope_v * dv
    return fine


def double_surface(surface: Surface, shape: tuple[int, ...]) -> Surface:
    """Return the surface on the grid (H, W) of twice the resolution, with s in pixels of that grid."""
    slope_u, slope_v = (enlarge_blocks(slope, 2, shape) for slope in (surface.slope_u, surface.slope_v))
    if find_plane_kernels(surface.s):
        s = enlarge_blocks(surface.s, 2, shape)
        du, dv = (_list_offsets(shape[axis], surface.s.shape[axis]) for axis in (1, 0))
        fine = 2 * (s + slope_u * du + slope_v * dv[:, None])
        return Surface(cast("NDArray[np.float32]", fine), slope_u, slope_v)
    return Surface(enlarge_blocks(2 * upsample_surface(surface, 2), 1, shape), slope_u, slope_v)


def _list_offsets(size: int, coarse: int) -> NDArray[np.float32]:
    """Return (size,) each pixel's offset from the middle of its block of two, of ``coarse`` blocks in a line."""
    offsets = np.tile(np.array([-0.25, 0.25], np.float32), coarse)
    return np.pad(offsets, (0, size - len(offsets)), mode="edge")


def fit_slopes(s: NDArray[np.float32], kernels: Kernels, threads: int) -> Surface:
    """Return the surface through s with slopes fitted to the neighbours of similar s."""
    fit = kernels.local_fit(
        np.ones_like(s), none := np.zeros_like(s), s, none, none, radii=((_RADIUS, _SIGMA),), tolerance=_TOLERANCE,
        prior_information=0.0, threads=threads,
    )  # fmt: skip
    return Surface(s, fit.slope_u, fit.slope_v)


def compute_visibility(
    s: NDArray[np.floating],
    views: NDArray[np.float32],
    sizes: Sequence[tuple[int, int]],
    kernels: Kernels,
    threads: int = 0,
) -> tuple[NDArray[np.uint8], list[NDArray[np.floating]]]:
    """Return (H, W) the number of auxiliaries that see s (H, W), and each auxiliary's inverse-depth buffer (h, w).

    ``views`` (n, 39) are the auxiliaries' packed projections, ``sizes`` their images' (width, height).
    """
    s = kernels.keep(s)
    buffers = kernels.inverse_depth_buffers(s, views, sizes, threads=threads)
    masks = [
        kernels.visible(s, view, buffer, OCCLUDER_PX, threads=threads)
        for view, buffer in zip(views, buffers, strict=True)
    ]
    return reduce(np.add, masks), list(buffers)


ON_AXIS = 0.1
"""Share of a baseline across the core's axis below which its whole length counts."""


def compute_inverse_depth_scale(rig: Rig, auxiliaries: Iterable[str], step: int = 1) -> float:
    """Return the unit of s in 1/mm on the grid of blocks of ``step`` px: about a pixel in the mean auxiliary.

    At full size it is 1 over the product of the core's mean focal length (px) and the mean length (mm) of the
    baselines across the core's optical axis. An auxiliary on that axis counts with its whole baseline.
    """
    lengths = [_measure_across_axis(rig.cam_from_core[name].center_mm) for name in auxiliaries]
    return 1.0 / float(rig.core_camera.focal_px.mean() * np.mean(lengths)) * step


def _measure_across_axis(center_mm: NDArray[np.float64]) -> float:
    whole, across = float(np.linalg.norm(center_mm)), float(np.linalg.norm(center_mm[:2]))
    return across if across > ON_AXIS * whole else whole


def pack_projection(
    rig: Rig, name: str, unit: float, core_step: int = 1, aux_step: int = 1
) -> NDArray[np.float32]:
    """Return the (39,) projection of the core's grid into a camera, for s in units of ``unit`` (1/mm).

    The images may be averaged in blocks of ``core_step`` and ``aux_step`` pixels. For the core's name it is the
    projection of the undistorted grid into the core's own distorted image, which does not depend on s.
    """
    camera, pose = rig.cameras[name], rig.cam_from_core[name]
    focal, center = _scale_to_blocks(camera, aux_step)
    ray = _invert_core_matrix(rig, core_step)
    direction, shift = pose.rotation @ ray, pose.translation_mm * unit
    lens = pack_lens(camera.model, camera.distortion, camera.valid_radius)
    return np.concatenate([direction.ravel(), shift, focal, center, lens]).astype(np.float32)


def pack_projections(rig: Rig, auxiliaries: tuple[str, ...], unit: float, step: int) -> NDArray[np.float32]:
    """Return the (n, 39) projections of the core's grid into the auxiliaries, all averaged in the same blocks."""
    return np.stack([pack_projection(rig, name, unit, step, step) for name in auxiliaries])


def crop_projection(view: NDArray[np.float32], first_u: int, first_v: int) -> NDArray[np.float32]:
    """Return the (39,) projection of the grid whose pixel (0, 0) is (first_u, first_v) of the given one."""
    direction = view[:9].astype(np.float64).reshape(3, 3).copy()
    direction[:, 2] += first_u * direction[:, 0] + first_v * direction[:, 1]
    return np.concatenate([direction.ravel(), view[9:]]).astype(np.float32)


def subsample_projection(view: NDArray[np.float32], stride: int) -> NDArray[np.float32]:
    """Return the (39,) projection of the grid of every ``stride``-th row and column, from ``stride // 2`` on."""
    direction = view[:9].astype(np.float64).reshape(3, 3).copy()
    direction[:, 2] += stride // 2 * (direction[:, 0] + direction[:, 1])
    direction[:, :2] *= stride
    return np.concatenate([direction.ravel(), view[9:]]).astype(np.float32)


def _invert_core_matrix(rig: Rig, step: int) -> NDArray[np.float64]:
    """Return the (3, 3) inverse camera matrix of the core for images averaged in blocks."""
    focal, center = _scale_to_blocks(rig.core_camera, step)
    return np.array(
        [[1 / focal[0], 0, -center[0] / focal[0]], [0, 1 / focal[1], -center[1] / focal[1]], [0, 0, 1]]
    )


def _scale_to_blocks(camera: Camera, step: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return focal lengths and centre, px, for images averaged in blocks: u_full = step · u + (step - 1) / 2."""
    return camera.focal_px / step, (camera.center_px - (step - 1) / 2) / step
