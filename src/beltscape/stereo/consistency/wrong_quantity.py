"""Search for the one quantity of a camera, such as a focal length, whose correction makes the images fit the rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.arrays import Array
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.stereo.consistency.pose_change import apply_pose_change
from beltscape.stereo.consistency.residuals import compute_disparity_residuals, compute_pair_residuals
from beltscape.stereo.consistency.rig_consistency import RigConsistency

_LEFT = 0.25
"""A correction explains the residuals if it leaves at most this share of them, the robust RMS."""
_AS_GOOD = 1.3
"""Corrections that leave at most this multiple of what the best one leaves explain the residuals as well."""
_NOISE_PX = 0.03
"""What corrections leave may differ by this, px of the matched images: matching leaves it on rendered images."""
_MOST = 3
"""Number of corrections that are named; more say nothing."""
_LOSS_PX = 3.0
"""Scale of Cauchy's loss, px of the matched images; false matches weigh less."""


@dataclass(frozen=True, slots=True)
class WrongQuantity:
    """A quantity with whose correction the images fit the rig."""

    camera: str
    text: str
    """The quantity and its correct value, such as "right's focal_px[1] is 1.010 of the stated"."""


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A quantity that may be wrong."""

    step: float
    """Step of the numerical derivative: some 0.1 to 1 px."""
    correct: Callable[[Rig, str, float], Rig]
    describe: Callable[[str, float], str]


def find_wrong_quantities(consistency: RigConsistency, rig: Rig) -> tuple[WrongQuantity, ...]:
    """Return the quantities of a contradicting camera that explain its residuals, the best first; none if many do.

    A pair of cameras shows the quantities of its auxiliary against the core's only; with one auxiliary, the same
    quantity of the core may be wrong the other way round.
    """
    names = tuple(each.camera for each in consistency.cameras if np.isfinite(each.epipolar_px))
    if consistency.is_change or (consistency.core_moved and len(names) > 1):
        return ()
    found: list[tuple[float, WrongQuantity]] = []
    for camera in consistency.find_auxiliaries("contradicting"):
        if camera in names:
            residuals = _OwnResiduals(consistency, rig, camera, names)
            found += _find_corrections(residuals, rig)
    return tuple(one for _, one in sorted(found, key=lambda one: one[0])) if len(found) <= _MOST else ()


class _OwnResiduals:
    """Residuals of one auxiliary: against the core, and against the depths of the others."""

    def __init__(self, consistency: RigConsistency, rig: Rig, camera: str, names: tuple[str, ...]) -> None:
        self.camera, self.pixel_scale = camera, consistency.tie_points.pixel_scale
        self._tie_points = consistency.tie_points
        sound = [name for name in consistency.find_auxiliaries("sound") if name in names]
        others = sound or [name for name in names if name != camera]
        self._others = [compute_pair_residuals(self._tie_points, rig, name) for name in others]

    def compute(self, rig: Rig) -> Array:
        """Return all residuals under a rig that differs in this camera, px; NaN: not found."""
        own = compute_pair_residuals(self._tie_points, rig, self.camera)
        return np.concatenate(
            [own.epipolar_px, *(compute_disparity_residuals(own, other) for other in self._others)]
        )

    def measure(self, rig: Rig) -> float:
        """Return the robust RMS of the residuals under a rig, px; infinite without any."""
        found = self.compute(rig)
        found = np.abs(found[np.isfinite(found)])
        return MAD_TO_SIGMA * float(np.median(found)) if len(found) else float("inf")


def _find_corrections(residuals: _OwnResiduals, rig: Rig) -> list[tuple[float, WrongQuantity]]:
    """Return the quantities that explain the residuals, each with what its correction leaves, px."""
    noise = _NOISE_PX * residuals.pixel_scale
    found = [_correct(residuals, rig, one) for one in _QUANTITIES.values()]
    limit = min(_AS_GOOD * min(left for left, _ in found) + noise, _LEFT * residuals.measure(rig) + noise)
    return [one for one in found if one[0] <= limit]


def _correct(residuals: _OwnResiduals, rig: Rig, quantity: _Quantity) -> tuple[float, WrongQuantity]:
    """Return what the best correction of a quantity leaves, px, and the quantity with its correct value."""
    scale, value, camera = _LOSS_PX * residuals.pixel_scale, 0.0, residuals.camera
    for loss in (10 * scale, 10 * scale, scale, scale):  # wide first, so that a large error is no outlier
        before = residuals.compute(quantity.correct(rig, camera, value))
        after = residuals.compute(quantity.correct(rig, camera, value + quantity.step))
        slopes = (after - before) / quantity.step
        weights = 1 / (1 + np.square(before / loss))
        curvature = float(np.nansum(weights * np.square(slopes)))
        value -= float(np.nansum(weights * slopes * before)) / curvature if curvature > 0 else 0.0
    left = residuals.measure(quantity.correct(rig, camera, value))
    return left, WrongQuantity(camera, quantity.describe(camera, value))


def _change_camera(rig: Rig, name: str, change: Callable[[Camera], Camera]) -> Rig:
    return replace(rig, cameras={**rig.cameras, name: change(rig.cameras[name])})


def _scale_focal(*axes: int, with_centre: bool = False) -> Callable[[Rig, str, float], Rig]:
    """Return the correction of the focal lengths of these axes by a share, or of the whole image's scale."""

    def change(camera: Camera, share: float) -> Camera:
        factor = np.ones(2)
        factor[list(axes)] += share
        centre = (camera.center_px + 0.5) * factor - 0.5 if with_centre else camera.center_px
        return replace(camera, focal_px=camera.focal_px * factor, center_px=centre)

    return lambda rig, name, share: _change_camera(rig, name, lambda camera: change(camera, share))


def _shift_centre(axis: int) -> Callable[[Rig, str, float], Rig]:
    def change(camera: Camera, pixels: float) -> Camera:
        return replace(camera, center_px=camera.center_px + pixels * np.eye(2)[axis])

    return lambda rig, name, pixels: _change_camera(rig, name, lambda camera: change(camera, pixels))


def _turn(axis: int) -> Callable[[Rig, str, float], Rig]:
    return lambda rig, name, angle: apply_pose_change(rig, name, angle * np.eye(6)[axis])


def _stretch_baseline(rig: Rig, name: str, share: float) -> Rig:
    pose = rig.cam_from_core[name]
    longer = Pose(pose.rotation, pose.translation_mm * (1 + share))
    return replace(rig, cam_from_core={**rig.cam_from_core, name: longer})


def _shift_aside(rig: Rig, name: str, share: float) -> Rig:
    """Return the rig with a camera displaced across its baseline and the core's axis by a share of the baseline."""
    pose = rig.cam_from_core[name]
    centre = pose.center_mm
    aside = np.cross([0.0, 0.0, 1.0], centre)
    moved = Pose(pose.rotation, -pose.rotation @ (centre + share * aside))
    return replace(rig, cam_from_core={**rig.cam_from_core, name: moved})


def _describe_share(what: str) -> Callable[[str, float], str]:
    return lambda name, share: f"{name}'s {what} is {1 + share:.4f} of the stated"


def _describe_shift(what: str) -> Callable[[str, float], str]:
    return lambda name, pixels: f"{name}'s {what} is {pixels:+.1f} px from the stated"


def _describe_turn(axis: str) -> Callable[[str, float], str]:
    return lambda name, angle: f"{name} is turned by {np.rad2deg(angle):+.2f}° about its {axis} axis"


_QUANTITIES: Mapping[str, _Quantity] = {
    "fx": _Quantity(1e-3, _scale_focal(0), _describe_share("focal_px[0]")),
    "fy": _Quantity(1e-3, _scale_focal(1), _describe_share("focal_px[1]")),
    "f": _Quantity(1e-3, _scale_focal(0, 1), _describe_share("focal_px (both)")),
    "scale": _Quantity(1e-3, _scale_focal(0, 1, with_centre=True), _describe_share("image scale")),
    "cx": _Quantity(1.0, _shift_centre(0), _describe_shift("center_px[0]")),
    "cy": _Quantity(1.0, _shift_centre(1), _describe_shift("center_px[1]")),
    "turn_x": _Quantity(1e-3, _turn(0), _describe_turn("x")),
    "turn_y": _Quantity(1e-3, _turn(1), _describe_turn("y")),
    "turn_z": _Quantity(1e-3, _turn(2), _describe_turn("optical")),
    "baseline": _Quantity(1e-3, _stretch_baseline, _describe_share("distance from the core")),
    "aside": _Quantity(
        1e-3,
        _shift_aside,
        lambda name, share: f"{name} stands {100 * share:+.1f} % of its baseline to the side",
    ),
}
"""Quantities that are wrong in calibrations by hand, by other programs, or for images of another size."""
