"""Score of a rig on board views: reprojection errors in pixels, errors on the board in millimetres.

Board corners are triangulated with the least reprojection error, without assuming a board.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.calibration.solver.lens import pack_intrinsics, project_points, project_with_jacobians
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels
from beltscape.target.board import Board, adjacent_corners, corner_points_mm

STEPS = 3
"""Gauss-Newton steps from the linear solution, which is near the minimum: the third moves it by below 1e-6 mm."""
DAMPING = 1e-9
"""Share of the normal matrix's trace that keeps it invertible for nearly parallel rays."""


def triangulate_corners(rig: Rig, views: Mapping[str, Corners], count: int, kernels: Kernels) -> Array:
    """Triangulate corners (count, 3) in the core frame, mm; NaN where fewer than two cameras see one.

    The linear solution (Eqs. 2-3), which minimises no error in the images, is the start of Gauss-Newton steps on the
    reprojection errors in the distorted images (Hartley & Zisserman, Multiple View Geometry, 2004, Section 12.3).
    """
    pixels = np.full((len(views), count, 2), np.nan)
    ideal = pixels.copy()
    for i, (name, corners) in enumerate(views.items()):
        camera = rig.cameras[name]
        pixels[i, corners.ids] = corners.pixels
        ideal[i, corners.ids] = camera.undistort(corners.pixels) * camera.focal_px + camera.center_px
    pixels[np.isnan(ideal)] = np.nan  # beyond the lens's domain of validity
    points = kernels.triangulate(np.stack([rig.projection(name) for name in views]), ideal, threads=1)
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    refined = points[known]
    for _ in range(STEPS):
        refined = _step(rig, tuple(views), refined, pixels[:, known])
    points[known] = refined
    return points


def _step(rig: Rig, names: tuple[str, ...], points: Array, pixels: Array) -> Array:
    """Return points (n, 3) after a Gauss-Newton step, where it lowers the squared errors."""
    normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    for name, seen in zip(names, pixels, strict=True):
        camera, pose = rig.cameras[name], rig.cam_from_core[name]
        lens = np.tile(pack_intrinsics(camera), (len(points), 1))
        projected, by_point, _ = project_with_jacobians(pose.apply(points), lens, camera.model)
        visible = np.isfinite(seen[:, :1])
        jacobian = np.where(visible[..., None], by_point @ pose.rotation, 0.0)
        normal += np.einsum("nri,nrj->nij", jacobian, jacobian)
        right += np.einsum("nri,nr->ni", jacobian, np.where(visible, seen - projected, 0.0))
    normal += DAMPING * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    moved: Array = points + np.asarray(np.linalg.solve(normal, right[..., None]), np.float64)[..., 0]
    better = _compute_cost(rig, names, moved, pixels) <= _compute_cost(rig, names, points, pixels)
    return np.where(better[:, None], moved, points)


def _compute_cost(rig: Rig, names: tuple[str, ...], points: Array, pixels: Array) -> Array:
    """Return the sum (n,) of the squared reprojection errors of points (n, 3) over all cameras that see them."""
    total = np.zeros(len(points))
    for name, seen in zip(names, pixels, strict=True):
        camera = rig.cameras[name]
        lens = np.tile(pack_intrinsics(camera), (len(points), 1))
        projected = project_points(rig.cam_from_core[name].apply(points), lens, camera.model)
        total += np.where(np.isfinite(seen[:, 0]), ((projected - seen) ** 2).sum(axis=1), 0.0)
    return total


@dataclass(frozen=True, slots=True)
class Score:
    """Score of a rig on board views, to which only the board's pose in each frame was fitted."""

    views: int
    frames: int
    corners: int
    rms_px: float
    """RMS length of the reprojection errors."""
    median_px: float
    """Median length of the reprojection errors."""
    square_bias_mm: float
    """Mean of triangulated minus true square edges."""
    square_rms_mm: float
    """RMS of triangulated minus true square edges."""
    planarity_rms_mm: float
    """RMS out-of-plane distance of triangulated corners from the board."""

    @property
    def has_squares(self) -> bool:
        """True if edges were triangulated: two cameras saw both ends at one instant."""
        return bool(np.isfinite(self.square_rms_mm))

    def document(self) -> dict[str, float]:
        """Return plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class ViewResiduals:
    """Reprojection errors of one view."""

    ids: NDArray[np.int64]
    """(n,) index of the corner on the board."""
    pixels: NDArray[np.float64]
    """(n, 2) detected position of the corners."""
    errors_px: NDArray[np.float64]
    """(n, 2) detected minus projected."""

    @property
    def rms_px(self) -> float:
        """RMS length of the errors."""
        return float(np.sqrt((self.errors_px**2).sum(axis=1).mean()))


@dataclass(frozen=True, slots=True, eq=False)
class RigErrors:
    """Errors of a rig on board views."""

    residuals: Mapping[str, Mapping[str, ViewResiduals]]
    """By camera and frame."""
    frames: int
    edge_errors_mm: NDArray[np.float64]
    """(e,) triangulated minus true square edges."""
    edge_frames: NDArray[np.int64]
    """(e,) index of the frame of each edge."""
    plane_distances_mm: NDArray[np.float64]
    """(p,) out-of-plane distances of triangulated corners from the board, which is fitted to them rigidly."""

    def compute_edge_bias_error_mm(self) -> float:
        """Return the standard error of the mean edge error, from the scatter of the frames' means.

        For a single frame it is the scatter of its edges, since errors within a frame are not independent. ∞ where no
        two cameras see the same corner.
        """
        if not self.edge_errors_mm.size:
            return float("inf")
        means = [self.edge_errors_mm[self.edge_frames == i].mean() for i in np.unique(self.edge_frames)]
        if len(means) < 2:
            return float(np.std(self.edge_errors_mm))
        return float(np.std(means, ddof=1) / np.sqrt(len(means)))

    def compute_errors_px(self) -> NDArray[np.float64]:
        """Return all reprojection errors (n, 2)."""
        return np.concatenate([v.errors_px for views in self.residuals.values() for v in views.values()])


def compute_rig_errors(
    rig: Rig,
    detections: BoardDetections,
    board: Board,
    kernels: Kernels,
    *,
    corners_mm: NDArray[np.float64] | None = None,
) -> RigErrors:
    """Compute the errors of a rig in the frames that at least two of its cameras see.

    ``corners_mm`` (P, 3) are the board's corners if its shape is known; the nominal ones by default.

    Raises
    ------
    CalibrationError
        When no frame shows the board to two cameras of the rig.
    """
    board_mm = corner_points_mm(board) if corners_mm is None else corners_mm
    names = [name for name in rig.cameras if name in detections.cameras]
    residuals: dict[str, dict[str, ViewResiduals]] = {name: {} for name in names}
    edges: list[NDArray[np.float64]] = []
    heights: list[NDArray[np.float64]] = []
    for frame in detections.frames:
        views = {name: detections.views[name][frame] for name in names if frame in detections.views[name]}
        if len(views) < 2:
            continue
        core_from_board = fit_board_pose(rig, views, board_mm)
        for name, corners in views.items():
            predicted = project_board(rig, name, core_from_board, board_mm[corners.ids])
            seen = np.isfinite(predicted).all(axis=1)  # the others lie beyond the lens's domain
            if seen.any():
                errors = corners.pixels - predicted
                residuals[name][frame] = ViewResiduals(corners.ids[seen], corners.pixels[seen], errors[seen])
        points = triangulate_corners(rig, views, len(board_mm), kernels)
        edges.append(_compute_edge_errors(points, board_mm, board))
        heights.append(_compute_form_errors(points, board_mm))
    if not edges:
        raise CalibrationError(
            "no frame shows the board to two cameras of the rig; take views that they share"
        )
    numbers = np.repeat(np.arange(len(edges)), [len(e) for e in edges])
    return RigErrors(residuals, len(edges), np.concatenate(edges), numbers, np.concatenate(heights))


def summarise_errors(*rig_errors: RigErrors) -> Score:
    """Summarise the errors of one or several folds."""
    lengths = np.linalg.norm(np.concatenate([e.compute_errors_px() for e in rig_errors]), axis=1)
    edges = np.concatenate([e.edge_errors_mm for e in rig_errors])
    heights = np.concatenate([e.plane_distances_mm for e in rig_errors])
    return Score(
        views=sum(len(views) for e in rig_errors for views in e.residuals.values()),
        frames=sum(e.frames for e in rig_errors),
        corners=len(lengths),
        rms_px=_compute_rms(lengths),
        median_px=float(np.median(lengths)),
        square_bias_mm=float(edges.mean()) if edges.size else float("nan"),
        square_rms_mm=_compute_rms(edges),
        planarity_rms_mm=_compute_rms(heights),
    )


def _compute_rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else float("nan")


def project_board(
    rig: Rig, name: str, core_from_board: Pose, points_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Project points (n, 3) of a board into a camera's image (n, 2), px."""
    return rig.cameras[name].project((rig.cam_from_core[name] @ core_from_board).apply(points_mm))


def _compute_edge_errors(
    points_mm: NDArray[np.float64], board_mm: NDArray[np.float64], board: Board
) -> NDArray[np.float64]:
    """Return measured minus true length of every square edge of which both ends were triangulated."""
    first, second = adjacent_corners(board).T
    lengths, true = (np.linalg.norm(p[first] - p[second], axis=1) for p in (points_mm, board_mm))
    return (lengths - true)[np.isfinite(lengths)]


def _compute_form_errors(
    points_mm: NDArray[np.float64], board_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return out-of-plane distances of triangulated corners from the board, fitted to them rigidly (Kabsch)."""
    known = np.isfinite(points_mm).all(axis=1)
    if known.sum() < 8:
        return np.empty(0)
    points, nominal = points_mm[known], board_mm[known]
    points, nominal = points - points.mean(axis=0), nominal - nominal.mean(axis=0)
    u, _, vt = np.linalg.svd(points.T @ nominal)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return (points @ turn - nominal)[:, 2]
