"""Lenses of like cameras: cameras whose own views determine no lens start again from the others' common one.

A few views of a board, or views nearly square to it, leave the focal length almost free (Zhang's equations of
parallel boards are the same equation), and the minimum that is found may be far off. Cameras of one image size often
are of one type; then a lens for all of them is determined by all their views. It serves as a start and a weak prior,
and only for cameras whose own views it explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.zhang import (
    LensGuess,
    MonocularCalibration,
    fit_with_guess,
    reject_outlying_views,
)
from beltscape.calibration.solver.lens import fit_view_pose
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera

MAX_SIGMA = 0.02
"""Largest σ of the focal length, over it, of a camera whose own views determine its lens; good sets have 0.002."""
VIEW_FREEDOM = 8
"""Independent numbers that a view gives if its corners' errors are alike, as of a bent board: a homography's."""
LIKE_FOCAL = 0.04
"""Largest relative difference of the focal lengths of like cameras: two specimens of a lens differ by 1 %, focused at
other distances by a few."""
LIKE_SIGMA = 0.02
"""Standard deviation of the focal length of like cameras about their mean, over it."""
MAX_RMS_RATIO, RMS_TOLERANCE_PX = 1.3, 0.03
"""A common lens explains a camera's views if they fit within this multiple of their RMS without it, and px more."""
MIN_FOCAL, MAX_FOCAL = 0.15, 60.0
"""Plausible focal lengths over the image's longer side: lenses between 147° and 1° of view."""
TRIED_FOCALS = 0.45, 0.65, 0.9, 1.3, 1.8, 2.6, 3.7
"""Focal lengths over the image's longer side that are tried as starts; lenses between 96° and 15° of view."""
TRIED_STARTS = 2
"""Starts with the smallest residuals that are continued to their minimum."""
POOLED_VIEWS, POOLED_CORNERS = 60, 60
"""Views, and corners of each, that determine a common start; more change it by less than like cameras differ."""


@dataclass(frozen=True, slots=True)
class Restart:
    """A camera that was started again, and why."""

    camera: str
    own_focal_px: float
    """Mean focal length from its own views."""
    focal_px: float
    """The same after the restart."""


def is_determined(detections: BoardDetections, camera: MonocularCalibration) -> bool:
    """Return whether the own views of a camera determine its focal length, were the errors of a view all alike."""
    views = detections.views[camera.camera.name]
    corners = sum(len(views[frame]) for frame in camera.cam_from_board)
    focal, sigma = float(camera.camera.focal_px.mean()), max(camera.sigma["fx"], camera.sigma["fy"])
    is_plausible = MIN_FOCAL < focal / max(camera.camera.size_px) < MAX_FOCAL
    return (
        is_plausible
        and compute_coherence_factor(corners, len(camera.cam_from_board)) * sigma < MAX_SIGMA * focal
    )


def compute_coherence_factor(corners: int, views: int) -> float:
    """Return the factor by which σ from independent corners is too small if the errors of a view are all alike."""
    return float(np.sqrt(max(corners / max(views, 1) / VIEW_FREEDOM, 1.0)))


def restart_weak_cameras(
    detections: BoardDetections,
    monocular: Mapping[str, MonocularCalibration],
    board_mm: Array,
    known: Sequence[str] = (),
) -> tuple[dict[str, MonocularCalibration], tuple[Restart, ...]]:
    """Start the cameras again whose own views do not determine a lens, or that differ from the like cameras.

    ``known`` cameras keep their intrinsics. Cameras of one image size, and of one maker's model where it is stated,
    are like if most of those that are determined agree in focal length (of one stated model, if any is determined);
    if none is determined, if one lens explains the views of all. A camera without a like one starts again from the
    best of several focal lengths.
    """
    result, restarts = dict(monocular), list[Restart]()
    for names in _group_cameras([name for name in monocular if name not in known], detections):
        guess, weak = _find_common_lens(names, monocular, detections, board_mm)
        if guess is None:
            continue
        for name in weak:
            again = _restart(name, detections, monocular[name], board_mm, guess)
            if again is not None:
                result[name] = again
                focal = float(monocular[name].camera.focal_px.mean())
                restarts.append(Restart(name, focal, float(again.camera.focal_px.mean())))
    return result, tuple(restarts)


def _group_cameras(names: Sequence[str], detections: BoardDetections) -> list[list[str]]:
    """Return the cameras by image size and stated model; those of unknown models are one group of their size."""
    groups: dict[tuple[tuple[int, int], str], list[str]] = {}
    for name in names:
        groups.setdefault((detections.sizes_px[name], _get_stated_model(name, detections)), []).append(name)
    return list(groups.values())


def _get_stated_model(name: str, detections: BoardDetections) -> str:
    stated = detections.types.get(name)
    return stated.model if stated else ""


def _find_common_lens(
    names: Sequence[str],
    monocular: Mapping[str, MonocularCalibration],
    detections: BoardDetections,
    board_mm: Array,
) -> tuple[LensGuess | None, list[str]]:
    """Return the common lens of cameras of one image size, and those of them to be started again with it."""
    determined = [monocular[name] for name in names if is_determined(detections, monocular[name])]
    agreeing = _find_agreeing(determined)
    if not agreeing and len(determined) == 1 and _get_stated_model(names[0], detections):
        agreeing = (determined[0].camera.name,)
    weak = [name for name in names if name not in agreeing]
    are_unlike = 2 * len(determined) > len(names) and not agreeing
    if not weak or are_unlike:
        return None, []
    if agreeing:
        return LensGuess(_average_lens([monocular[name].camera for name in agreeing]), LIKE_SIGMA), weak
    views, size = {name: detections.views[name] for name in names}, detections.sizes_px[names[0]]
    common = _fit_common_lens(views, size, board_mm)
    return (None, []) if common is None else (LensGuess(common, LIKE_SIGMA), weak)


def _find_agreeing(determined: Sequence[MonocularCalibration]) -> tuple[str, ...]:
    """Return the cameras of like focal length if they are the majority of the determined ones; else none."""
    ordered = sorted(determined, key=lambda camera: float(camera.camera.focal_px.mean()))
    focals = np.array([camera.camera.focal_px.mean() for camera in ordered])
    counts = [int(((focals >= low) & (focals < (1 + LIKE_FOCAL) * low)).sum()) for low in focals]
    if max(counts, default=0) < 2 or 2 * max(counts) <= len(ordered):
        return ()
    first = int(np.argmax(counts))
    return tuple(camera.camera.name for camera in ordered[first : first + counts[first]])


def _average_lens(cameras: Sequence[Camera]) -> Camera:
    """Return the median lens of cameras, of the model that most of them have."""
    models = [camera.model for camera in cameras]
    alike = [camera for camera in cameras if camera.model == max(models, key=models.count)]
    return replace(
        alike[0],
        focal_px=np.median([camera.focal_px for camera in alike], axis=0),
        center_px=np.median([camera.center_px for camera in alike], axis=0),
        distortion=np.median([camera.distortion for camera in alike], axis=0),
    )


def _fit_common_lens(
    views: Mapping[str, Mapping[str, Corners]], size_px: tuple[int, int], board_mm: Array
) -> Camera | None:
    """Fit one lens to the views of all cameras, from the best of several starts; None if none converges."""
    pooled = _thin({f"{name}/{frame}": c for name, frames in views.items() for frame, c in frames.items()})
    starts = sorted(
        (_make_ideal_camera(size_px, share) for share in TRIED_FOCALS),
        key=lambda camera: _compute_misfit(camera, pooled, board_mm),
    )
    fits: list[MonocularCalibration] = []
    for start in starts[:TRIED_STARTS]:
        with suppress(CalibrationError):
            fits.append(fit_with_guess(pooled, board_mm, LensGuess(start, 1.0)))
    return min(fits, key=lambda fit: fit.rms_px).camera if fits else None


def _thin(views: Mapping[str, Corners]) -> dict[str, Corners]:
    """Return some of the views and corners, evenly spread."""
    names = list(views)
    kept = (names[int(i)] for i in np.unique(np.linspace(0, len(names) - 1, POOLED_VIEWS).astype(int)))
    return {name: _thin_corners(views[name]) for name in kept}


def _thin_corners(corners: Corners) -> Corners:
    used = np.zeros(len(corners), bool)
    used[np.unique(np.linspace(0, len(corners) - 1, POOLED_CORNERS).astype(int))] = True
    return corners.select(used)


def _make_ideal_camera(size_px: tuple[int, int], share: float) -> Camera:
    """Return a camera without distortion whose focal length is a share of the image's longer side."""
    width, height = size_px
    focal = share * max(size_px)
    center = np.array([width - 1, height - 1]) / 2
    return Camera("", size_px, np.array([focal, focal]), center, np.zeros(5))


def _compute_misfit(camera: Camera, views: Mapping[str, Corners], board_mm: Array) -> float:
    """Return the RMS of the views' residuals, px, with the board's pose fitted in each."""
    squares: list[Array] = []
    for corners in views.values():
        points = board_mm[corners.ids]
        pose = fit_view_pose(camera, points, corners.pixels)
        squares.append(((camera.project(pose.apply(points)) - corners.pixels) ** 2).sum(axis=1))
    return float(np.sqrt(np.nanmean(np.concatenate(squares))))


def _restart(
    name: str,
    detections: BoardDetections,
    own: MonocularCalibration,
    board_mm: Array,
    guess: LensGuess,
) -> MonocularCalibration | None:
    """Return the calibration started at a guessed lens; None if the guess does not explain the camera's views."""
    guess = replace(guess, camera=replace(guess.camera, name=name))
    try:
        again = reject_outlying_views(
            detections.views[name], lambda views: fit_with_guess(views, board_mm, guess)
        )
    except CalibrationError:
        return None
    if len(again.cam_from_board) < len(own.cam_from_board):
        return None
    is_like = abs(again.camera.focal_px / guess.camera.focal_px - 1).max() < LIKE_FOCAL
    is_explained = again.rms_px < MAX_RMS_RATIO * own.rms_px + RMS_TOLERANCE_PX
    return again if is_like and is_explained else None
