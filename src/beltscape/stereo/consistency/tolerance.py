"""Tolerances of the systematic residuals: what the rig's covariance permits, and a least value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from beltscape.core.arrays import Array
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import list_intrinsics
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.residuals import (
    PairResiduals,
    compute_disparity_residuals,
    compute_pair_residuals,
)
from beltscape.stereo.consistency.tie_points import TiePoints

_LEAST_RAD, _LEAST_PX = 2e-4, (0.1, 0.25)
"""Least tolerance of one frame as an angle, and its bounds in px; rendered captures stay below 0.03 px, real lenses
leave 0.1 to 0.2 px in images of 1200 px. A shift of 0.3 mm at 0.7 m is 4e-4 rad."""
_POOLED_RAD, _POOLED_PX = 1.5e-4, (0.06, 0.2)
"""The same for several frames together, whose noise is less: a roll of 0.05° leaves 1.7e-4 rad."""
_CHANGE_RAD, _CHANGE_PX = 6e-5, (0.03, 0.08)
"""The same for the change since the reference was taken: in rendered captures of sound rigs it is below 0.006 px at
580 px of focal length; 0.3 mm along the optical axis at 0.7 m change it by 0.05 px."""
_UNSTATED_PX = 0.6
"""Least tolerance of a rig that does not say how well it is known (no covariance), where no other cameras show it:
rigs that are published with stereo pairs are right to about half a pixel."""
LEAST_UNGUIDED_PX = 0.25
"""Least tolerance of unguided matching, in pixels of its small images."""
_SIGMAS = 3.0
"""Coverage factor of the rig's own uncertainty."""
_POSE = ("turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_mm", "shift_y_mm", "shift_z_mm")
_GRID = (5, 4)
"""Columns and rows of the points over an image at which tolerances are computed."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Greatest systematic residuals of a sound rig, px."""

    epipolar_px: Mapping[str, float]
    """By auxiliary: of its epipolar residuals."""
    disparity_px: Mapping[tuple[str, str], float]
    """By two auxiliaries: of their disparity residuals."""
    is_stated: bool = True
    """Whether it comes from what the rig says about itself, or from a reference; else the rig has no covariance."""

    def loosen(self) -> Tolerance:
        """Return the tolerance of a rig that does not say how well it is known."""
        return Tolerance(
            {name: max(value, _UNSTATED_PX) for name, value in self.epipolar_px.items()},
            {pair: max(value, _UNSTATED_PX) for pair, value in self.disparity_px.items()},
        )

    def widen(self, pixel_scale: float) -> Tolerance:
        """Return the tolerance of unguided matching in images whose pixels are ``pixel_scale`` px of the rig's."""
        least = LEAST_UNGUIDED_PX * pixel_scale
        return Tolerance(
            {name: float(np.hypot(value, least)) for name, value in self.epipolar_px.items()},
            {pair: float(np.hypot(value, 2 * least)) for pair, value in self.disparity_px.items()},
            self.is_stated,
        )


def compute_least_px(
    rig: Rig, least_rad: float = _LEAST_RAD, bounds_px: tuple[float, float] = _LEAST_PX
) -> float:
    """Return the least tolerance of a rig, px: what remains of lens models and matching."""
    return float(np.clip(least_rad * rig.core_camera.focal_px.mean(), *bounds_px))


def compute_change_tolerance(rig: Rig) -> Tolerance:
    """Return the tolerance of changes of the residuals since the reference was taken."""
    least = compute_least_px(rig, _CHANGE_RAD, _CHANGE_PX)
    names = rig.auxiliaries
    return Tolerance(dict.fromkeys(names, least), dict.fromkeys(combinations(names, 2), least))


def compute_tolerance(rig: Rig, depth_mm: float, *, pooled: bool = False) -> Tolerance:
    """Return the tolerance of a rig for surfaces at about this depth; the least one if it has no covariance.

    ``pooled``: for the tie points of several frames together.
    """
    names = rig.auxiliaries
    pairs = list(combinations(names, 2))
    tie_points = _make_ideal_points(rig, depth_mm)
    parameters, covariance = _read_covariance(rig)
    unperturbed = {name: compute_pair_residuals(tie_points, rig, name) for name in names}
    base = _stack_residuals(unperturbed, pairs)
    variance = np.zeros(base.shape)
    if parameters:
        sigma = np.sqrt(np.diag(covariance))
        free = np.flatnonzero(sigma > 0)
        slopes = np.empty((len(free), *base.shape))
        for row, i in enumerate(free):
            perturbed = _perturb_rig(rig, parameters[i], sigma[i])
            camera = parameters[i].rpartition(".")[0]
            affected = names if camera == rig.core else (camera,)
            changed = {name: compute_pair_residuals(tie_points, perturbed, name) for name in affected}
            slopes[row] = (_stack_residuals({**unperturbed, **changed}, pairs) - base) / sigma[i]
        variance = np.einsum("irn,ij,jrn->rn", slopes, covariance[np.ix_(free, free)], slopes)
    own = (
        np.sqrt(np.nanmean(np.where(np.isfinite(variance), variance, np.nan), axis=1))
        if base.size
        else np.empty(0)
    )
    least = compute_least_px(rig, _POOLED_RAD, _POOLED_PX) if pooled else compute_least_px(rig)
    limit = np.hypot(least, _SIGMAS * np.nan_to_num(own))
    return Tolerance(
        {name: float(limit[i]) for i, name in enumerate(names)},
        {pair: float(limit[len(names) + i]) for i, pair in enumerate(pairs)},
        bool(parameters),
    )


def _stack_residuals(residuals: Mapping[str, PairResiduals], pairs: list[tuple[str, str]]) -> Array:
    """Return (R, N) px: a row of epipolar residuals per auxiliary, then of disparity residuals per pair."""
    epipolar = [each.epipolar_px for each in residuals.values()]
    disparity = [compute_disparity_residuals(residuals[one], residuals[other]) for one, other in pairs]
    return np.array(epipolar + disparity)


def _make_ideal_points(rig: Rig, depth_mm: float) -> TiePoints:
    """Return tie points without error, on a plane parallel to the core's image; NaN outside an image."""
    width, height = rig.core_camera.size_px
    u, v = np.meshgrid(
        *((np.arange(n) + 0.5) / n * size - 0.5 for n, size in zip(_GRID, (width, height), strict=True))
    )
    core_px = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = (core_px - rig.core_camera.center_px) / rig.core_camera.focal_px
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * depth_mm
    projected = {
        name: rig.cameras[name].project(rig.cam_from_core[name].apply(points)) for name in rig.auxiliaries
    }
    for name, pixels in projected.items():
        pixels[~((pixels >= 0) & (pixels <= np.array(rig.cameras[name].size_px) - 1)).all(axis=1)] = np.nan
    searched = {name: np.isfinite(pixels[:, 0]) for name, pixels in projected.items()}
    return TiePoints(core_px, np.full(len(core_px), 1 / depth_mm), projected, searched)


def _read_covariance(rig: Rig) -> tuple[list[str], Array]:
    """Return the names of the rig's uncertain parameters and their covariance (G, G); empty without a valid one."""
    parameters, matrix = rig.covariance.get("parameters"), rig.covariance.get("matrix")
    if parameters is None or matrix is None:
        return [], np.empty((0, 0))
    names, values = [str(name) for name in parameters], np.asarray(matrix, np.float64)
    valid = set(_list_parameters(rig))
    if values.shape != (len(names), len(names)) or not set(names) <= valid or not np.isfinite(values).all():
        return [], np.empty((0, 0))
    return names, values


def _list_parameters(rig: Rig) -> Iterator[str]:
    for name, camera in rig.cameras.items():
        yield from (f"{name}.{parameter}" for parameter in list_intrinsics(camera.model) + _POSE)


def _perturb_rig(rig: Rig, parameter: str, step: float) -> Rig:
    """Return the rig with a step added to one parameter, named as in rig.json's covariance."""
    name, _, quantity = parameter.rpartition(".")
    if quantity in _POSE:
        change = np.zeros(6)
        change[_POSE.index(quantity)] = step
        pose = rig.cam_from_core[name]
        rotation = Pose.of(change[:3], np.zeros(3)).rotation @ pose.rotation
        perturbed = Pose(rotation, pose.translation_mm + change[3:])
        return replace(rig, cam_from_core={**rig.cam_from_core, name: perturbed})
    index = list_intrinsics(rig.cameras[name].model).index(quantity)
    camera = _perturb_camera(rig.cameras[name], index, step)
    return replace(rig, cameras={**rig.cameras, name: camera})


def _perturb_camera(camera: Camera, index: int, step: float) -> Camera:
    values = np.concatenate([camera.focal_px, camera.center_px, camera.distortion])
    values[index] += step
    return replace(camera, focal_px=values[:2], center_px=values[2:4], distortion=values[4:])
