"""Coverage of the measuring volume: where each camera looks at it, but never saw the board.

The volume consists of the points before the core camera whose depth the rig is to measure. Findings say in words what
the board never reached, and what to photograph.

σ of depths is also computed as if the lenses need not follow their models exactly. A polynomial that fits the
corners may still be wrong where no corner was: its σ there holds only if lenses are such polynomials. So σ is
computed with more radial terms than the model has, free within what lenses have; corners hold these terms where the
board was, and nothing else does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from beltscape.calibration.assessment.covariance import (
    compute_depth_jacobian,
    compute_formal_covariance,
    compute_unit_depths,
)
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.solver.bundle import Bundle, Geometry
from beltscape.calibration.solver.lens import compute_lens_prior, list_parameters, pad_rows, stack_intrinsics
from beltscape.core.arrays import Array, Mask
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

GENERAL = {"brown": "rational"}
"""Lens model → the model that has its terms and more; the others are general enough, and limited to their corners."""


def compute_general_covariance(adjustment: BundleAdjustmentResult) -> tuple[Rig, Array]:
    """Return the rig with general lens models, at the adjusted values, and its formal covariance (G, G).

    Given lenses stay fixed.
    """
    cameras = {name: _generalise(camera) for name, camera in adjustment.rig.cameras.items()}
    rig, lenses = replace(adjustment.rig, cameras=cameras), stack_intrinsics(cameras.values())
    prior, geometry = adjustment.bundle.prior, replace(adjustment.geometry, intrinsics=lenses)
    is_free = np.any(prior.intrinsics_free, axis=1).tolist()
    free = [
        np.full(len(list_parameters(camera.model)), free)
        for camera, free in zip(cameras.values(), is_free, strict=True)
    ]
    general = replace(
        prior,
        models=tuple(camera.model for camera in cameras.values()),
        intrinsics=lenses,
        intrinsics_information=pad_rows(
            _extend_information(own, adjustment.rig.cameras[name], cameras[name])
            for own, name in zip(prior.intrinsics_information, cameras, strict=True)
        ),
        intrinsics_free=pad_rows(free),
    )
    bundle = Bundle(adjustment.bundle.observations, general, adjustment.bundle.weights)
    return rig, compute_formal_covariance(rig, bundle, bundle.linearise(geometry))


def _generalise(camera: Camera) -> Camera:
    model = GENERAL.get(camera.model, camera.model)
    added = len(MODELS[model].coefficients) - len(camera.distortion)
    return replace(camera, model=model, distortion=np.append(camera.distortion, np.zeros(added)))


def _extend_information(own: Array, camera: Camera, general: Camera) -> Array:
    """Return the information (W, W) of the adjustment's prior, with that of lenses for the added coefficients."""
    count = len(list_parameters(camera.model))
    information = compute_lens_prior(general)[1]
    information[:count, :count] = own[:count, :count]
    return information


COLUMNS = 25
"""Points across the core's image; the predicted σ is smooth between them."""
NEAR, FAR = 0.05, 0.95
"""Quantiles of the boards' depths between which a rig without a known belt is taken to measure."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuringVolume:
    """Points that the rig is to measure."""

    name: str
    """As in "the part of the image that sees <name>"."""
    points_mm: Array
    """(N, 3) in the core frame."""
    is_given: bool
    """True if the belt is known; False if the whole view of the core stands for it."""
    tolerance_mm: float | None = None
    """Largest σ of a depth from calibration that the plan of the belt assumes; None: none is stated."""


def make_view_volume(rig: Rig, geometry: Geometry) -> MeasuringVolume:
    """Return the core camera's view on the grid of depth maps, over the boards' depths; for an unknown belt."""
    depths = (geometry.board_rotation @ geometry.points_mm.T)[:, 2] + geometry.board_translation_mm[:, 2:]
    near, far = np.quantile(depths, [NEAR, FAR]).tolist()
    return make_volume_of_view(rig, (near, far))


def make_volume_of_view(rig: Rig, depths_mm: tuple[float, float]) -> MeasuringVolume:
    """Return the core camera's view on the grid of depth maps, at two depths."""
    camera = rig.core_camera
    width, height = camera.size_px
    rows = max(3, round(COLUMNS * height / width))
    u, v = np.linspace(0, width - 1, COLUMNS), np.linspace(0, height - 1, rows)
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = (grid - camera.center_px) / camera.focal_px  # of the undistorted grid, on which depth is measured
    rays = rays[np.isfinite(camera.distort(rays)[:, 0])]
    rays = np.column_stack([rays, np.ones(len(rays))])
    points = np.concatenate([depth * rays for depth in depths_mm])
    return MeasuringVolume(f"the whole view of {rig.core}", points, is_given=False)


REACH = 0.08
"""Distance from the nearest corner, over the image's diagonal, within which the board reached a pixel: distortion is
smooth over it, and boards on a sound grid of poses leave no larger gap."""
UNCERTAIN_PX, UNUSABLE_PX = 0.1, 0.5
"""σ of a depth, as the shift in an image that it equals, from which it is remarked on, and from which it is unusable:
matching is certain to 0.03 px (`plan`), and finds little along epipolar lines that are off by half a pixel."""
MIN_CONTRAST = 5.0
"""Least ratio of such a σ to its median where the board was: corners with much noise are another fault."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraCoverage:
    """The part of the measuring volume that one camera sees."""

    camera: Camera
    pixels: Array
    """(N, 2) of the volume's points; beyond the lens's domain as extrapolated, NaN where not in the image."""
    is_reached: Mask
    """(N,) pixels that the board reached."""
    is_beyond: Mask
    """(N,) pixels beyond the lens's domain."""
    corners_px: Array
    """(K, 2) of the board, that the calibration used."""

    @property
    def is_seen(self) -> Mask:
        """(N,) points in the camera's image within the lens's domain."""
        return np.isfinite(self.pixels[:, 0]) & ~self.is_beyond


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Coverage of a measuring volume by the views of the board."""

    volume: MeasuringVolume
    cameras: Mapping[str, CameraCoverage]
    """The core camera first."""
    sigma_mm: Array
    """(N,) σ of a depth if lenses need not follow their models exactly; NaN with fewer than two cameras, and where no
    lens is known."""
    sigma_px: Array
    """(N,) the same as a shift in an image."""
    is_uncertain: Mask
    """(N,) points in the core's image that a camera sees where the board never was, and whose σ is large by that."""
    is_unusable: Mask
    """(N,) those of them that cannot be measured, with those that no two lenses reach."""

    @property
    def is_needed(self) -> Mask:
        """(N,) points in the core's image."""
        return np.isfinite(next(iter(self.cameras.values())).pixels[:, 0])

    def share(self, mask: Mask) -> float:
        """Return the share of points in a mask (N,) among those in the core's image."""
        return float((mask & self.is_needed).sum() / max(int(self.is_needed.sum()), 1))


def assess_coverage(
    adjustment: BundleAdjustmentResult,
    limited: Rig,
    inflation: float,
    volume: MeasuringVolume,
    general: tuple[Rig, Array] | None = None,
) -> Coverage:
    """Return the coverage of a volume; ``limited`` is the adjusted rig with its lenses' domains.

    ``general`` is the result of `compute_general_covariance`, where it is known.
    """
    general_rig, covariance = general or compute_general_covariance(adjustment)
    points = volume.points_mm
    cameras = {name: _view(adjustment, limited, name, points) for name in limited.cameras}
    core = cameras[limited.core]
    sigma_mm, unit_mm = _compute_sigma(_limit(general_rig, limited), covariance, points)
    sigma_mm = inflation * sigma_mm
    sigma_px = sigma_mm / unit_mm
    sees = np.stack([each.is_seen for each in cameras.values()])
    reached = np.stack([each.is_reached for each in cameras.values()])
    all_reached = (reached | ~sees).all(axis=0)
    usual_px = float(np.nanmedian(np.where(all_reached, sigma_px, np.nan))) if all_reached.any() else 0.0
    contrast_px = MIN_CONTRAST * (usual_px if np.isfinite(usual_px) else 0.0)
    needed = np.isfinite(core.pixels[:, 0])
    has_gap = needed & ~all_reached
    beyond = np.stack([each.is_beyond for each in cameras.values()])
    lost = needed & beyond.any(axis=0) & (~sees[0] | (sees.sum(axis=0) < 2))
    if not volume.is_given:
        lost = np.zeros_like(lost)  # a lens's domain is no gap in an image that need not be used whole
    sigma_mm[lost] = sigma_px[lost] = np.nan
    return Coverage(
        volume, cameras, sigma_mm, sigma_px,
        is_uncertain=lost | (has_gap & (sigma_px > max(UNCERTAIN_PX, contrast_px))),
        is_unusable=lost | (has_gap & (sigma_px > max(UNUSABLE_PX, contrast_px))),
    )  # fmt: skip


def _limit(general: Rig, limited: Rig) -> Rig:
    """Return the rig of general lenses within the domains of the calibrated ones."""
    cameras = {
        name: replace(camera, valid_radius_px=limited.cameras[name].valid_radius_px)
        for name, camera in general.cameras.items()
    }
    return Rig(general.core, cameras, general.cam_from_core)


def _compute_sigma(rig: Rig, covariance: Array, points: Array) -> tuple[Array, Array]:
    """Return σ of depths (N,) and the depth (N,) that one pixel of error in every image makes, mm."""
    jacobian = compute_depth_jacobian(rig, points)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian))
    return sigma, compute_unit_depths(rig, points)[0]


def _view(adjustment: BundleAdjustmentResult, limited: Rig, name: str, points: Array) -> CameraCoverage:
    camera, index = limited.cameras[name], list(limited.cameras).index(name)
    observed = adjustment.bundle.observations
    corners = observed.pixels[adjustment.used & (observed.camera == index)]
    pixels, beyond = project_beyond(camera, limited.cam_from_core[name], points)
    within = (pixels >= -0.5) & (pixels <= np.array(camera.size_px) - 0.5)
    inside = within[:, 0] & within[:, 1]
    pixels[~inside] = np.nan
    reached = np.zeros(len(points), bool)
    if len(corners):
        distance, _ = KDTree(corners).query(pixels[inside])
        reached[inside] = np.asarray(distance) <= REACH * float(np.hypot(*camera.size_px))
    return CameraCoverage(camera, pixels, reached, inside & beyond, corners)


def project_beyond(camera: Camera, cam_from_core: Pose, points_mm: Array) -> tuple[Array, Mask]:
    """Return the pixels (N, 2) of points, and which lie beyond the lens's domain; NaN behind the camera.

    Beyond the domain the distance from the principal point grows with the angle off the axis as it does on average
    within: enough to say that a part of the image looks there.
    """
    in_camera = cam_from_core.apply(points_mm)
    pixels = camera.project(in_camera)
    beyond = np.isnan(pixels[:, 0]) & (in_camera[:, 2] > 0)
    if beyond.any():
        ideal = in_camera[beyond, :2] / in_camera[beyond, 2:]
        radius, edge = np.linalg.norm(ideal, axis=1), camera.valid_radius * (1 - 1e-9)
        at_edge = camera.distort(ideal * (edge / radius)[:, None]) * camera.focal_px
        pixels[beyond] = camera.center_px + at_edge * (np.arctan(radius) / np.arctan(edge))[:, None]
    return pixels, beyond


MAX_LOST, MAX_LOST_OF_VIEW = 0.02, 0.25
"""Largest share of unusable points of a given volume, and of the core's whole view, of which an unknown belt may fill
the middle only."""
MIN_REMARK, MIN_REMARK_OF_VIEW = 0.005, 0.02
"""Share of uncertain points from which a gap is remarked on."""
TOLERANCE_SHARE = 0.95
"""Share of the volume over which the tolerance must be kept; its rim is seen by the fewest cameras."""
MAX_STATED_PX = 10.0
"""Largest σ of a depth, as the shift in an image that it equals, that is stated in figures: matching finds nothing so
far off, and a larger σ only says that the lens is not known there."""
OFF_CENTRE = 0.25
"""Mean offset of a gap from the image's middle, in half images, from which it lies on one side."""


class UncoveredVolumeError(CalibrationError):
    """The board never reached a part of the images that the measuring volume needs."""

    def __init__(self, line: str, coverage: Coverage) -> None:
        """Keep the coverage, of which a picture is drawn."""
        super().__init__(line)
        self.coverage = coverage


def require_coverage(coverage: Coverage) -> None:
    """Raise UncoveredVolumeError if depth cannot be measured in a part of the volume for lack of board views."""
    if has_lost_volume(coverage):
        raise UncoveredVolumeError(describe_gap(coverage, coverage.is_unusable), coverage)


def has_lost_volume(coverage: Coverage) -> bool:
    """Return whether depth cannot be measured in too large a part of the volume."""
    return coverage.share(coverage.is_unusable) > (MAX_LOST if coverage.volume.is_given else MAX_LOST_OF_VIEW)


def describe_tolerance(coverage: Coverage) -> str | None:
    """Return whether σ of depth over the given volume is within its tolerance, in one line; None without one."""
    tolerance_mm = coverage.volume.tolerance_mm
    known = coverage.sigma_mm[coverage.is_needed & np.isfinite(coverage.sigma_mm)]
    if tolerance_mm is None or not known.size:
        return None
    reached_mm = float(np.quantile(known, TOLERANCE_SHARE))
    verdict = "passes" if reached_mm <= tolerance_mm else "fails"
    return (
        f"{verdict}: σ of depth from calibration is {reached_mm:.2g} mm or less over {TOLERANCE_SHARE:.0%} of "
        f"{coverage.volume.name}, which assumes {tolerance_mm:g} mm (calibration_sigma_mm)"
    )


def list_coverage_findings(coverage: Coverage) -> list[str]:
    """Return a line about a gap in the coverage; empty without one."""
    least = MIN_REMARK if coverage.volume.is_given else MIN_REMARK_OF_VIEW
    return (
        [describe_gap(coverage, coverage.is_uncertain)]
        if coverage.share(coverage.is_uncertain) > least
        else []
    )


def describe_gap(coverage: Coverage, gap: Mask) -> str:
    """Return the gap in one line: the cameras, its size and place, what it costs, and what to photograph."""
    counts = {
        name: int((gap & np.isfinite(each.pixels[:, 0]) & (each.is_beyond | ~each.is_reached)).sum())
        for name, each in coverage.cameras.items()
    }
    worst = max(counts, key=lambda name: counts[name])
    own = coverage.cameras[worst]
    hidden = gap & np.isfinite(own.pixels[:, 0]) & (own.is_beyond | ~own.is_reached)
    others = [name for name in counts if name != worst and counts[name] > 0.3 * counts[worst]]
    also = f" (so too {', '.join(others)})" if others else ""
    seen = int(np.isfinite(own.pixels[:, 0]).sum())
    depth_mm = float(np.median(coverage.volume.points_mm[hidden, 2]))
    return (
        f"camera {worst}: the board never came to {hidden.sum() / max(seen, 1):.0%} of the part of its image that "
        f"sees {coverage.volume.name}{also}, where {_describe_cost(coverage, gap)}; photograph the board "
        f"{describe_place(own.pixels[hidden], own.camera.size_px)} of {worst}'s image, about {depth_mm:.0f} mm away"
    )


def _describe_cost(coverage: Coverage, gap: Mask) -> str:
    known = gap & np.isfinite(coverage.sigma_px)
    sigma = np.where(known, coverage.sigma_px, 0.0)
    if 2 * known.sum() < gap.sum():
        return "its lens is not known and nothing is measured"
    at = int(np.argmax(sigma))
    if sigma[at] > MAX_STATED_PX:
        return "the lens is extrapolated and depth not measurable"
    return (
        f"the lens is extrapolated and a depth uncertain by up to {coverage.sigma_mm[at]:.2g} mm "
        f"({coverage.sigma_px[at]:.2g} px)"
    )


def describe_place(pixels: np.ndarray, size_px: tuple[int, int]) -> str:
    """Return where pixels (n, 2) lie in the image, as in "at the upper left"."""
    across, down = (2 * (pixels / (np.array(size_px) - 1) - 0.5)).mean(axis=0).tolist()
    row = "" if abs(down) < OFF_CENTRE else "upper" if down < 0 else "lower"
    column = "" if abs(across) < OFF_CENTRE else "left" if across < 0 else "right"
    if not row and not column:
        return "at all edges and corners"
    place = " ".join(word for word in (row, column) if word)
    return f"at the {place}" if row and column else f"at the {place} edge"
