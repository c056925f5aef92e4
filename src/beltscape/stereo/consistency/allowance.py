"""How far off a sound rig's residuals may be: what its covariance permits, and a floor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.camera import Camera
from beltscape.core.pose import Pose
from beltscape.core.rig import Rig
from beltscape.stereo.consistency.residuals import disparity_px, pair_residuals
from beltscape.stereo.consistency.tie_points import Array, TiePoints

FLOOR_PX = 0.25
"""Allowed to every rig: rendered captures stay below 0.03 px, real lenses leave 0.1 to 0.2 px."""
FLOOR_OF_SEARCH = 0.25
"""The same in pixels of the small images of an unguided search, whose matches are that coarse."""
_SIGMAS = 3.0
"""Of the rig's own uncertainty."""
_LENS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
_POSE = ("turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_mm", "shift_y_mm", "shift_z_mm")
_GRID = (5, 4)


@dataclass(frozen=True, slots=True)
class Allowance:
    """Greatest systematic residuals of a sound rig, px."""

    across_px: Mapping[str, float]
    """By auxiliary: across the epipolar line."""
    between_px: Mapping[tuple[str, str], float]
    """By two auxiliaries: of `disparity_px`."""

    def widened(self, pixel: float) -> Allowance:
        """Return what an unguided search allows in images whose pixels are that large."""
        least = FLOOR_OF_SEARCH * pixel
        return Allowance(
            {name: float(np.hypot(value, least)) for name, value in self.across_px.items()},
            {pair: float(np.hypot(value, 2 * least)) for pair, value in self.between_px.items()},
        )


def allowance_of(rig: Rig, depth_mm: float) -> Allowance:
    """Return the allowance of a rig for surfaces about so far away; the floor where it has no covariance."""
    names = rig.auxiliaries
    pairs = [(one, other) for i, one in enumerate(names) for other in names[i + 1 :]]
    tie = _ideal_points(rig, depth_mm)
    parameters, covariance = _covariance(rig)
    base = _values(tie, rig, names, pairs)
    variance = np.zeros(base.shape)
    if parameters:
        sigma = np.sqrt(np.diag(covariance))
        free = np.flatnonzero(sigma > 0)
        slopes = np.stack(
            [
                (_values(tie, _moved(rig, parameters[i], sigma[i]), names, pairs) - base) / sigma[i]
                for i in free
            ]
        )
        variance = np.einsum("irn,ij,jrn->rn", slopes, covariance[np.ix_(free, free)], slopes)
    own = (
        np.sqrt(np.nanmean(np.where(np.isfinite(variance), variance, np.nan), axis=1))
        if base.size
        else np.empty(0)
    )
    limit = np.hypot(FLOOR_PX, _SIGMAS * np.nan_to_num(own))
    return Allowance(
        {name: float(limit[i]) for i, name in enumerate(names)},
        {pair: float(limit[len(names) + i]) for i, pair in enumerate(pairs)},
    )


def _values(tie: TiePoints, rig: Rig, names: tuple[str, ...], pairs: list[tuple[str, str]]) -> Array:
    """Return (pairs with the core, then pairs of auxiliaries; N) residuals, px."""
    residuals = {name: pair_residuals(tie, rig, name) for name in names}
    across = [residuals[name].across_px for name in names]
    between = [disparity_px(residuals[one], residuals[other]) for one, other in pairs]
    return np.array(across + between)


def _ideal_points(rig: Rig, depth_mm: float) -> TiePoints:
    """Points on a plane before the core, found exactly where the rig says; NaN outside an image."""
    width, height = rig.core_camera.size_px
    u, v = np.meshgrid(
        *((np.arange(n) + 0.5) / n * size - 0.5 for n, size in zip(_GRID, (width, height), strict=True))
    )
    core_px = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = (core_px - rig.core_camera.center_px) / rig.core_camera.focal_px
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * depth_mm
    found = {
        name: rig.cameras[name].project(rig.cam_from_core[name].apply(points)) for name in rig.auxiliaries
    }
    for name, pixels in found.items():
        pixels[~((pixels >= 0) & (pixels <= np.array(rig.cameras[name].size_px) - 1)).all(axis=1)] = np.nan
    searched = {name: np.isfinite(pixels[:, 0]) for name, pixels in found.items()}
    return TiePoints(core_px, np.full(len(core_px), 1 / depth_mm), found, searched)


def _covariance(rig: Rig) -> tuple[list[str], Array]:
    """Parameters and their covariance (G, G) where rig.json holds one that fits."""
    parameters, matrix = rig.covariance.get("parameters"), rig.covariance.get("matrix")
    if parameters is None or matrix is None:
        return [], np.empty((0, 0))
    names, values = [str(name) for name in parameters], np.asarray(matrix, np.float64)
    known = set(_parameters(rig))
    if values.shape != (len(names), len(names)) or not set(names) <= known or not np.isfinite(values).all():
        return [], np.empty((0, 0))
    return names, values


def _parameters(rig: Rig) -> Iterator[str]:
    for name in rig.cameras:
        yield from (f"{name}.{parameter}" for parameter in _LENS + _POSE)


def _moved(rig: Rig, parameter: str, step: float) -> Rig:
    """Return the rig with one parameter, as rig.json's covariance names it, changed by a step."""
    name, _, what = parameter.rpartition(".")
    if what in _POSE:
        change = np.zeros(6)
        change[_POSE.index(what)] = step
        pose = rig.cam_from_core[name]
        turned = Pose.of(change[:3], np.zeros(3)).rotation @ pose.rotation
        moved = Pose(turned, pose.translation_mm + change[3:])
        return replace(rig, cam_from_core={**rig.cam_from_core, name: moved})
    return replace(rig, cameras={**rig.cameras, name: _changed(rig.cameras[name], _LENS.index(what), step)})


def _changed(camera: Camera, index: int, step: float) -> Camera:
    values = np.concatenate([camera.focal_px, camera.center_px, camera.distortion])
    values[index] += step
    return replace(camera, focal_px=values[:2], center_px=values[2:4], distortion=values[4:])
