"""Evidence for a camera's lens model: errors of its corners, by rings around the image's middle.

Brown's model, the default, is compared with others on views that they were not fitted to. Two others, neither of them
the default, are compared on all views: where few views reach the edge, to hold one out is to extrapolate.

A lens model fails at the edge first, where few corners are. So two models are compared ring by ring and corner by
corner, and not by means over views or folds. Both have the same noise in a corner: with errors e and e + Δ the sum of
the differences of their squares, 2eΔ + Δ², scatters by 2σ√ΣΔ² about 0 if the model with the errors e is right.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree

from beltscape.calibration.detection.board_poses import list_lens_folds
from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.like_cameras import VIEW_FREEDOM
from beltscape.calibration.intrinsics.zhang import (
    MonocularCalibration,
    calibrate_camera,
    set_up_adjustment,
    to_noise_px,
)
from beltscape.calibration.solver.lens import compute_lens_prior, unpack_intrinsics
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.core.arrays import Array, Indices
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import BROWN

MIN_CHOICE_VIEWS = 8
"""Least number of views for a comparison: two in every one of four folds."""
REFITTING = Damping(tolerance=1e-5, iterations=15)
"""Fits to some of the views start at the fit to all of them."""
MAX_OUTSIDE = 0.005
"""Largest share of held-out corners beyond a model's domain; more make the model unfit for the lens."""
RINGS = 5
"""Rings of equal width from the image's middle to the farthest corner: the errors of a wrong model at the edge of an
image differ from those at half the radius tenfold."""
MIN_RING_CORNERS = 40
"""Least number of corners of a ring: with fewer it is joined with the next inner one."""
MIN_GAIN = 0.15
"""Least relative decrease of the held-out RMS of a ring from Brown's model to another; a board that is bent by 0.1 mm
makes 5 % through a normal lens, a lens of 100° that is described by the polynomial 50 %."""
MIN_GAIN_PX = 0.01
"""Least decrease of the held-out RMS of a ring from Brown's model to another, px: smaller ones do not matter."""
MIN_OTHER_GAIN = 0.03
"""Least relative decrease between two other models, neither of which is the default: 6 % to 9 % for one of 105°."""
SIGNIFICANCE = 3.0
"""Standard deviations by which the decrease must exceed 0; several rings are tested."""


@dataclass(frozen=True, slots=True, eq=False)
class LensErrors:
    """Errors of views under a lens model, fitted to other folds or to the views themselves."""

    errors_px: Mapping[str, Array]
    """By view: errors (n, 2) of its corners, NaN beyond the lens's domain; empty if the model does not fit views that
    it was not fitted to."""

    @property
    def rms_px(self) -> float:
        """RMS over the corners; infinite without any."""
        if not self.errors_px:
            return float("inf")
        errors = np.concatenate(list(self.errors_px.values()))
        return float(np.sqrt(np.nanmean((errors**2).sum(axis=1))))


@dataclass(frozen=True, slots=True)
class RingGain:
    """Held-out errors of two models in one ring of the image."""

    inner_px: float
    outer_px: float
    first_px: float
    """RMS under the first model."""
    second_px: float
    """RMS under the second."""
    significance: float
    """Decrease of the sum of squares from the first to the second model, over its standard deviation."""

    def is_clear(self, least: float, least_px: float) -> bool:
        """Return whether the second model is clearly better."""
        is_large = self.second_px < min((1 - least) * self.first_px, self.first_px - least_px)
        return is_large and self.significance > SIGNIFICANCE

    def reverse(self) -> RingGain:
        """Return the gain from the second model to the first."""
        return RingGain(self.inner_px, self.outer_px, self.second_px, self.first_px, -self.significance)


@dataclass(frozen=True, slots=True)
class Gain:
    """Decrease of the held-out errors from one model to another, over their common views."""

    rings: tuple[RingGain, ...]
    """From the middle outwards, and the whole image at last; empty with too few common views."""
    is_default: bool
    """Whether the first model is Brown's, which only a larger gain replaces."""

    @property
    def is_clear(self) -> bool:
        """True if the second model is clearly better in a ring or as a whole, and in none clearly worse."""
        least, least_px = (MIN_GAIN, MIN_GAIN_PX) if self.is_default else (MIN_OTHER_GAIN, 0.0)
        if any(ring.reverse().is_clear(least, least_px) for ring in self.rings):
            return False
        return any(ring.is_clear(least, least_px) for ring in self.rings)

    def describe(self) -> str:
        """Return the decrease in the whole image, and that of the ring in which it is greatest."""
        if not self.rings:
            return "too few common views"
        whole, most = (
            self.rings[-1],
            min(self.rings, key=lambda ring: ring.second_px / max(ring.first_px, 1e-9)),
        )
        return (
            f"{whole.first_px:.3f} to {whole.second_px:.3f} px; from {most.inner_px:.0f} to {most.outer_px:.0f} px "
            f"off the middle {most.first_px:.3f} to {most.second_px:.3f} px, {most.significance:.0f} σ"
        )


def compare_errors(
    errors: Mapping[str, LensErrors], models: tuple[str, str], detections: BoardDetections, name: str
) -> Gain:
    """Return the decrease of a camera's errors from the first of two models to the second."""
    first, second = (errors[model].errors_px for model in models)
    common = [frame for frame in first if frame in second]
    is_default = models[0] == BROWN.name
    if len(common) < MIN_CHOICE_VIEWS:
        return Gain((), is_default)
    views, middle = detections.views[name], (np.array(detections.sizes_px[name]) - 1) / 2
    a, b = (np.concatenate([each[frame] for frame in common]) for each in (first, second))
    radius = np.linalg.norm(np.concatenate([views[frame].pixels for frame in common]) - middle, axis=1)
    view = np.repeat(np.arange(len(common)), [len(views[frame]) for frame in common])
    known = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    a, b, radius, view = a[known], b[known], radius[known], view[known]
    limits = _limit_rings(radius)
    spans = [*pairwise(limits), (0.0, limits[-1])]
    inside = [(radius >= low) & (radius <= high) for low, high in spans]
    better = min((a, b), key=lambda each: float((each**2).mean()))
    alike = _estimate_alikeness(
        better, np.concatenate([views[frame].pixels for frame in common])[known], view
    )
    rings = [
        _measure_ring(a[own], b[own], span, alike * float((better**2).mean()))
        for span, own in zip(spans, inside, strict=True)
    ]
    return Gain(tuple(rings), is_default)


def _estimate_alikeness(errors: Array, pixels: Array, view: Indices) -> float:
    """Return how many corners count as one: 1 if errors (n, 2) of neighbouring corners are independent.

    With ρ the correlation of neighbours, 1 + (m − 1) ρ: if all errors of a view are alike, as of a bent board, m of
    its corners count as one, so that it gives no more than a homography.
    """
    places = np.column_stack([pixels, 1e5 * view])  # views far from each other
    nearest = np.asarray(KDTree(places).query(places, k=2)[1])[:, 1]
    correlation = float((errors * errors[nearest]).sum() / max(float((errors**2).sum()), 1e-12))
    most = max(len(errors) / (VIEW_FREEDOM / 2 * len(np.unique(view))), 1.0)
    return 1 + (most - 1) * min(max(correlation, 0.0), 1.0)


def _limit_rings(radius: Array) -> list[float]:
    """Return the limits of the rings, from 0 to the farthest corner, with enough corners in each."""
    limits = [float(radius.max())]
    for limit in np.linspace(0, limits[0], RINGS + 1)[-2:0:-1].tolist():
        inside = int(((radius > limit) & (radius <= limits[-1])).sum())
        if inside >= MIN_RING_CORNERS and (radius <= limit).sum() >= MIN_RING_CORNERS:
            limits.append(limit)
    return [0.0, *limits[::-1]]


def _measure_ring(a: Array, b: Array, span: tuple[float, float], variance: float) -> RingGain:
    """Return the errors (n, 2) of two models in a ring; ``variance`` is that of a coordinate under the better one."""
    first, second = (float(np.sqrt(np.mean((each**2).sum(axis=1)))) for each in (a, b))
    scatter = 2 * np.sqrt(variance * float(((a - b) ** 2).sum()))
    decrease = float((a**2 - b**2).sum())
    return RingGain(*span, first, second, decrease / max(float(scatter), 1e-12))


Views = Mapping[str, Corners]


def hold_out(
    name: str,
    detections: BoardDetections,
    board_mm: Array,
    whole: MonocularCalibration,
    frames: Iterable[str],
) -> LensErrors:
    """Return the errors of frames under lenses fitted to others; rejected views are held out from all."""
    kept = detections.restrict([name], whole.cam_from_board)
    found: dict[str, Array] = {}
    rest = [frame for frame in frames if frame not in whole.cam_from_board]
    try:
        for train, test in list_lens_folds(kept, name):
            lens = _refit(kept.restrict([name], train).views[name], whole, board_mm)
            found |= _score(kept.restrict([name], test), lens, board_mm)
        found |= _score(detections.restrict([name], rest), whole.camera, board_mm) if rest else {}
    except (CalibrationError, np.linalg.LinAlgError):
        return LensErrors({})
    is_outside = np.isnan(np.concatenate([*found.values(), np.empty((0, 2))])[:, 0])
    return LensErrors(found if is_outside.sum() <= MAX_OUTSIDE * is_outside.size else {})


def _score(detections: BoardDetections, lens: Camera, board_mm: Array) -> dict[str, Array]:
    """Return the errors of the views of a given lens, by frame."""
    views = detections.views[lens.name]
    scored = calibrate_camera(lens.name, detections, board_mm, known=lens, min_views=1)
    return _project_errors(scored, views, board_mm)


def compute_own_errors(
    detections: BoardDetections, board_mm: Array, whole: MonocularCalibration
) -> LensErrors:
    """Return the errors of the views that a lens was fitted to."""
    return LensErrors(_project_errors(whole, detections.views[whole.camera.name], board_mm))


def _project_errors(calibration: MonocularCalibration, views: Views, board_mm: Array) -> dict[str, Array]:
    """Return the errors (n, 2), projected minus seen, of the corners of every view with a pose."""
    return {
        frame: calibration.camera.project(pose.apply(board_mm[views[frame].ids])) - views[frame].pixels
        for frame, pose in calibration.cam_from_board.items()
    }


def _refit(views: Views, whole: MonocularCalibration, board_mm: Array) -> Camera:
    """Return the lens that fits some of the views, started at the fit to all of them."""
    camera, poses = whole.camera, [whole.cam_from_board[frame] for frame in views]
    prior = compute_lens_prior(camera)
    bundle, state = set_up_adjustment(
        views, camera, poses, board_mm, prior=prior, fixed=whole.fixed, sigma_px=to_noise_px(whole.rms_px)
    )
    return unpack_intrinsics(camera, minimise(bundle, state, REFITTING).state.intrinsics[0])
