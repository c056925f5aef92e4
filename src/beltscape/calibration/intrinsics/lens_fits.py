"""Fits of a camera's lens models to its own views.

A fit starts from equidistant lenses of several focal lengths, or from another model's lens.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners, has_planar_extent
from beltscape.calibration.intrinsics.zhang import (
    MIN_VIEWS,
    LensGuess,
    MonocularCalibration,
    fit_with_guess,
    reject_outlying_views,
    set_up_adjustment,
    to_noise_px,
)
from beltscape.calibration.solver.lens import (
    compute_lens_prior,
    fit_view_pose,
    get_coefficient_prior,
    pack_intrinsics,
)
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.lens_domain import find_radius_of_image_radius
from beltscape.files.rig_limits import find_turning_radius_px
from beltscape.target.planar_boards import MIN_CORNERS

EQUIDISTANT_FOCALS = 0.22, 0.27, 0.33, 0.4, 0.5, 0.62, 0.77, 0.95, 1.3
"""Focal lengths over the image's longer side that are tried; 0.22 is 260° across it, 0.32 180°, 0.95 60°."""
TRIED_VIEWS = 8
"""Views that choose among them: their residuals differ by tens of px."""
TRIED_FOCALS = 4
"""Of them that are tried in a fit: through a wide lens the pose of a board at the image's edge takes up most of a
wrong focal length, so that the residuals alone do not choose."""
STEEPEST = 1.45
"""Largest angle off the axis of a corner that is used, rad: a view beyond 83° has no pinhole coordinates."""
FITTED_RADII = 60
"""Number of radii at which one lens model is fitted to another; the curves are smooth between them."""
TILTED_FIXED = ("k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
"""Coefficients of the tilted model that are held at 0: lenses on Scheimpflug adapters are long, and a prism looks
like a tilt to second order, so that with it no view determines the angles."""
RIDGE = 1e-3
"""Weight of the coefficients' prior, which the radii do not determine by themselves."""


def list_starts(
    name: str,
    size_px: tuple[int, int],
    views: Mapping[str, Corners],
    board_mm: Array,
    model: str,
    brown: Camera | None,
) -> list[Camera]:
    """Return cameras with a lens model at which a fit can start, the likelier first."""
    if model == "brown":
        return [brown] if brown is not None else []
    if model == "tilted" and brown is not None:
        return [_start_tilted(brown)]
    if (
        model != "fisheye"
        and brown is not None
        and find_turning_radius_px(brown) > find_reach_px(brown, views)
    ):
        return [refit_radially(brown, model, find_reach_px(brown, views))]
    equidistant = list_equidistant(name, size_px, views, board_mm)
    if model == "fisheye":
        return equidistant
    if model == "tilted":
        return [_start_tilted(start) for start in equidistant]
    return [refit_radially(start, model, find_reach_px(start, views)) for start in equidistant]


def _start_tilted(camera: Camera) -> Camera:
    """Return a camera of the tilted model without tilt, with the focal length and the first coefficients of another.

    Brown's model takes up a tilt as a principal point that is off by f tan τ. From there the fit converges to angles
    of 10° and more.
    """
    lens = np.zeros(len(MODELS["tilted"].coefficients))
    lens[:2] = camera.distortion[:2] if camera.model == "brown" else 0.0
    return replace(camera, model="tilted", distortion=lens, focal_px=np.full(2, camera.focal_px.mean()))


def list_fixed(model: str) -> tuple[str, ...]:
    """Return the coefficients that a fit holds at 0, because others of the model take their part."""
    return TILTED_FIXED if model == "tilted" else ()


def list_equidistant(
    name: str, size_px: tuple[int, int], views: Mapping[str, Corners], board_mm: Array
) -> list[Camera]:
    """Return equidistant fisheyes (r = f θ) of several focal lengths that explain the views best, the best first."""
    center = (np.array(size_px) - 1) / 2
    cameras = [
        Camera(name, size_px, np.full(2, share * max(size_px)), center, np.zeros(4), "fisheye")
        for share in EQUIDISTANT_FOCALS
    ]
    some = select_views(views, TRIED_VIEWS)
    return sorted(cameras, key=lambda camera: _compute_misfit(camera, some, board_mm))[:TRIED_FOCALS]


def select_views(views: Mapping[str, Corners], count: int) -> dict[str, Corners]:
    """Return some of the views, evenly spread."""
    names = list(views)
    return {
        names[int(i)]: views[names[int(i)]]
        for i in np.unique(np.linspace(0, len(names) - 1, count).astype(int))
    }


def refit_radially(camera: Camera, model: str, reach_px: float) -> Camera:
    """Return a camera of a rational model whose radial distortion is that of another one, up to a distance in px.

    With f the other model's radial factor, N − f D = 0 is linear in the coefficients of numerator and denominator.
    """
    farthest = find_radius_of_image_radius(camera.model, camera.distortion, reach_px / camera.focal_px.mean())
    r = np.tan(np.linspace(0.02, min(float(np.arctan(farthest)), STEEPEST), FITTED_RADII))
    t, factor = r * r, camera.lens.radial.compute(r * r, camera.distortion)
    columns = np.stack([t, t * t, t**3, -factor * t, -factor * t * t, -factor * t**3], axis=1)
    weights = (1 / (1 + t**3))[:, None]
    means, sigmas = np.array([get_coefficient_prior(f"k{i}", model) for i in range(1, 7)]).T
    system = np.concatenate([columns * weights, RIDGE * np.diag(1 / sigmas)])
    right = np.concatenate([(factor - 1) * weights[:, 0], RIDGE * means / sigmas])
    k1, k2, k3, k4, k5, k6 = np.linalg.lstsq(system, right, rcond=None)[0]
    lens = np.zeros(len(MODELS[model].coefficients))
    lens[[0, 1, 4, 5, 6, 7]] = k1, k2, k3, k4, k5, k6
    return replace(camera, model=model, distortion=lens)


def find_reach_px(camera: Camera, views: Mapping[str, Corners]) -> float:
    """Return the largest distance of a corner from the principal point, px."""
    return max(float(np.linalg.norm(view.pixels - camera.center_px, axis=1).max()) for view in views.values())


def _compute_misfit(camera: Camera, views: Mapping[str, Corners], board_mm: Array) -> float:
    """Return the median over the views of their RMS residuals, px, with the board's pose fitted in each.

    Corners beyond `STEEPEST` under this lens are left out; a view that consists of them counts as infinitely bad.
    """
    return float(np.median([_compute_view_misfit(camera, view, board_mm) for view in views.values()]))


def _compute_view_misfit(camera: Camera, view: Corners, board_mm: Array) -> float:
    angles: Array = np.linalg.norm(view.pixels - camera.center_px, axis=1) / float(camera.focal_px.mean())
    seen = view.select(angles <= STEEPEST)
    points = board_mm[seen.ids]
    if len(seen) < MIN_CORNERS or not has_planar_extent(points):
        return float("inf")
    try:
        pose = fit_view_pose(camera, points, seen.pixels)
    except CalibrationError:
        return float("inf")
    squares: Array = ((camera.project(pose.apply(points)) - seen.pixels) ** 2).sum(axis=1)
    return float(np.sqrt(np.nanmean(squares)))


Views = Mapping[str, Corners]

RANKING_VIEWS = 12
"""Views that choose among several starts; false minima differ from the true one by many px in any of them."""


def fit_model(
    name: str, detections: BoardDetections, board_mm: Array, model: str, brown: MonocularCalibration | None,
    min_views: int = MIN_VIEWS,
) -> MonocularCalibration:  # fmt: skip
    """Return the best fit of a model over its starts, without outlying views.

    Raises
    ------
    CalibrationError
        When the views are too few, or the model does not fit them.
    """
    views = detections.views[name]
    if len(views) < min_views:
        raise CalibrationError(
            f"camera {name} sees the board in {len(views)} of {detections.images[name]} images; "
            f"at least {min_views} tilted views are needed"
        )
    starts = list_starts(
        name, detections.sizes_px[name], views, board_mm, model, brown.camera if brown else None
    )
    guesses = [LensGuess(start, 1.0, fixed=list_fixed(model)) for start in starts]
    for guess in _rank_guesses(guesses, select_views(views, RANKING_VIEWS), board_mm):
        with suppress(CalibrationError):
            return reject_outlying_views(
                views, lambda kept, guess=guess: fit_with_guess(kept, board_mm, guess)
            )
    raise CalibrationError(f"camera {name}: the lens model {model} does not fit its views")


def _rank_guesses(guesses: list[LensGuess], views: Views, board_mm: Array) -> list[LensGuess]:
    """Return the guesses, that which leads to the smallest residuals of some views first, continued from there."""
    if len(guesses) == 1:
        return guesses
    ranked: list[tuple[float, LensGuess]] = []
    for guess in guesses:
        try:
            fit = fit_with_guess(views, board_mm, guess)
            ranked.append((fit.rms_px, replace(guess, camera=fit.camera)))
        except CalibrationError:
            ranked.append((np.inf, guess))
    return [guess for _, guess in sorted(ranked, key=lambda each: each[0])]


def predict_gain(brown: MonocularCalibration, detections: BoardDetections, board_mm: Array) -> float:
    """Return the share of the squared residuals that the rational model removes, to first order (a score test)."""
    views = detections.views[brown.camera.name]
    used = {frame: views[frame] for frame in brown.cam_from_board}
    camera = replace(
        brown.camera, model="rational", distortion=np.concatenate([brown.camera.distortion, np.zeros(3)])
    )
    prior = pack_intrinsics(camera), compute_lens_prior(camera)[1]
    poses = list(brown.cam_from_board.values())
    bundle, state = set_up_adjustment(
        used, camera, poses, board_mm, prior=prior, sigma_px=to_noise_px(brown.rms_px)
    )
    try:
        linear = bundle.linearise(state)
        return linear.predict_decrease(linear.solve_step(0.0)) / linear.cost
    except np.linalg.LinAlgError:
        return 0.0
