"""Plausibility of rigs: lenses that fold the image, absurd intrinsics, coincident cameras, wrong units.

An impossible rig is refused; an unusual one gives a warning.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens_domain import BEFORE_POLE, find_valid_radius
from beltscape.core.geometry.rig import Rig
from beltscape.core.quantities import BASELINE, UNITS

FOCAL_OVER_DIAGONAL = (0.1, 100.0)
"""Limits of the focal length over the image's diagonal: fields of view of 157°, that of the lens model, and
of 0.6°."""
_ODD_FOCAL = (0.25, 20.0)
"""Limits beyond which the focal length over the diagonal is unusual: fields of view of 127° and 2.9°."""
_OFF_CENTRE = 1.5
"""Largest distance of the principal point from the middle, in image sizes; shifted sensors stay below 1."""
_ODD_CENTRE = 0.3
"""Distance of the principal point from which it is unusual: only deliberately shifted lenses reach it."""
_ASPECT = 1.25
"""Ratio of the focal lengths; pixels that are not square reach 1.1."""
LEAST_BASELINE_MM = 2.0
"""Cameras of industrial rigs are wider than this, so are the lens pairs of stereo microscopes (10 to 25 mm); metres
written as millimetres make 0.05 to 1.5 of every rig up to 1.5 m."""
_ODD_BASELINE_MM = 15.0
"""A smaller baseline is unusual: industrial cameras have housings of 29 mm and stand no closer."""
_GREATEST_BASELINE_MM = 100_000.0
"""100 m: no rig is wider; one in micrometres, or one in mm that was converted as if from metres, is."""
LEAST_DEPTH_MM = 10.0
"""Surfaces nearer than this to a core camera are within its lens."""
_SAMPLES = 25
"""Pixels along each side of the grid on which a fold is searched; distortion is smooth between them."""
_ROUNDED = 1e-6
"""Relative tolerance of a stated domain that ends where the lens turns back: rounding of the file's digits."""
_HORIZON = 1e3
"""tan θ that stands for 90° off the axis: 0.06° from it."""
_ODD_REACH = 0.9
"""Share of the image's half diagonal below which a lens's stated domain is remarked on: boards rarely reach more."""


def find_refusal(rig: Rig) -> str | None:
    """Return why the rig is impossible, with the camera and the value; None if it is possible."""
    return next(_refusals(rig), None)


def find_oddities(rig: Rig) -> list[str]:
    """Return a line for everything unusual in the rig."""
    lines: list[str] = []
    for name, camera in rig.cameras.items():
        ratio = float(camera.focal_px.mean() / np.hypot(*camera.size_px))
        if not _ODD_FOCAL[0] <= ratio <= _ODD_FOCAL[1]:
            lines.append(
                f"camera {name}: focal_px = {_two(camera.focal_px)} is unusual for {_size(camera)} px"
            )
        off = np.abs(camera.center_px / (np.array(camera.size_px) - 1) - 0.5).max()
        if off > _ODD_CENTRE:
            lines.append(
                f"camera {name}: center_px = {_two(camera.center_px)} is far off the middle of {_size(camera)} px"
            )
        reach = camera.valid_radius_px
        if reach is not None and reach < _ODD_REACH * find_corner_radius_px(camera):
            lines.append(
                f"camera {name}: its lens is valid up to {reach:.0f} px from the principal point, the image reaches "
                f"{find_corner_radius_px(camera):.0f} px; pixels beyond are not used"
            )
    for name in rig.auxiliaries:
        baseline = float(np.linalg.norm(rig.cam_from_core[name].center_mm))
        if baseline < _ODD_BASELINE_MM:
            low, high = BASELINE.usual
            fixes = [
                f"; in {unit}? multiply its translations by {factor:g}"
                for unit, factor in UNITS["mm"]
                if low <= baseline * factor <= high
            ]
            lines.append(
                f"camera {name} stands {baseline:.3g} mm from {rig.core}: unusually near; are the units mm"
                f"{''.join(fixes[:2]) or '?'}"
            )
    return lines


def _refusals(rig: Rig) -> Iterator[str]:
    for name, camera in rig.cameras.items():
        ratio = camera.focal_px / float(np.hypot(*camera.size_px))
        low, high = FOCAL_OVER_DIAGONAL
        if ratio.min() < low or ratio.max() > high or not 1 / _ASPECT <= ratio[0] / ratio[1] <= _ASPECT:
            yield f"camera {name}: focal_px = {_two(camera.focal_px)} is no lens for an image of {_size(camera)} px"
        off = np.abs(camera.center_px / (np.array(camera.size_px) - 1) - 0.5).max()
        if off > _OFF_CENTRE:
            yield f"camera {name}: center_px = {_two(camera.center_px)} is far outside an image of {_size(camera)} px"
        yield from _lens_refusals(camera)
    yield from _position_refusals(rig)


def _lens_refusals(camera: Camera) -> Iterator[str]:
    """Yield a lens model that folds within the part of the image in which the rig uses it."""
    turning_px = find_turning_radius_px(camera)
    stated_px = camera.valid_radius_px
    needed_px = find_corner_radius_px(camera) if stated_px is None else stated_px
    if has_fold(camera) if stated_px is None else turning_px < needed_px * (1 - _ROUNDED):
        values = ", ".join(f"{value:g}" for value in camera.distortion)
        if np.isinf(turning_px):
            yield (
                f"camera {camera.name}: its image reaches {needed_px:.0f} px from the principal point, where a lens "
                f"with distortion = [{values}] of model {camera.model} looks 90° or more off its axis; a rig uses "
                f"less: give valid_radius_px, below {find_horizon_px(camera):.0f}"
            )
            return
        yield (
            f"camera {camera.name}: distortion = [{values}] of model {camera.model} turns back within the image, "
            f"{turning_px:.0f} px from the principal point, which no lens does (the farthest pixel lies at "
            f"{needed_px:.0f} px); calibrate with a model for wide lenses, or give valid_radius_px"
        )


def find_turning_radius_px(camera: Camera) -> float:
    """Return the distance from the principal point at which the lens model turns back, px of the image; ∞: never."""
    turning = find_valid_radius(camera.model, camera.distortion)
    if np.isinf(turning):
        return turning
    radius = BEFORE_POLE * turning
    factor = camera.lens.radial.compute(np.array(radius**2), camera.distortion)
    return float(radius * factor * camera.focal_px.mean())


def find_horizon_px(camera: Camera) -> float:
    """Return the distance from the principal point of the directions at right angles to the axis, px of the image."""
    factor = camera.lens.radial.compute(np.array(_HORIZON**2), camera.distortion)
    return float(_HORIZON * factor * camera.focal_px.mean())


def find_corner_radius_px(camera: Camera) -> float:
    """Return the distance of the image's farthest pixel from the principal point, px."""
    far = np.maximum(camera.center_px, np.array(camera.size_px) - 1 - camera.center_px)
    return float(np.hypot(*far))


def _position_refusals(rig: Rig) -> Iterator[str]:
    """Yield cameras at the same place, or at distances that no rig has."""
    baselines = {name: float(np.linalg.norm(rig.cam_from_core[name].center_mm)) for name in rig.auxiliaries}
    for name, baseline in baselines.items():
        if baseline == 0:
            yield f"camera {name} stands where {rig.core} does (translation_mm is 0); depth needs a baseline"
        if baseline > _GREATEST_BASELINE_MM:
            yield f"camera {name} stands {baseline / 1000:.4g} m from {rig.core}; are the translations in mm?"
    if baselines and max(baselines.values()) < LEAST_BASELINE_MM:
        name = max(baselines, key=lambda each: baselines[each])
        yield (
            f"camera {name} stands {baselines[name]:.3g} mm from {rig.core} and no camera farther: the rig seems to "
            "be in metres; multiply its translations by 1000"
        )


def has_fold(camera: Camera) -> bool:
    """Return whether the distortion turns back within the image, so that some pixels belong to no direction."""
    width, height = camera.size_px
    u, v = np.linspace(0, width - 1, _SAMPLES), np.linspace(0, height - 1, _SAMPLES)
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    return bool(np.isnan(camera.undistort(pixels)).any())


def _two(values: np.ndarray) -> str:
    return f"[{values[0]:.6g}, {values[1]:.6g}]"


def _size(camera: Camera) -> str:
    return f"{camera.size_px[0]}×{camera.size_px[1]}"
