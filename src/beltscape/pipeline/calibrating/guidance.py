"""Guidance while views of a board are taken: what each camera still needs, where to hold the board, who moved.

All of it follows from the newest calibration of these views, where there is one; before, cells that the board has not
reached are shown, and starting poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from beltscape.calibration.assessment.coverage import (
    REACH,
    MeasuringVolume,
    make_volume_of_view,
    project_beyond,
)
from beltscape.calibration.assessment.findings import find_displaced_camera
from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.core.arrays import Array, Mask
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.calibrating.measuring_volume import read_measuring_volume
from beltscape.target.board import Board, corner_points_mm

CELLS = (16, 12)
"""Cells across and down an image in which its coverage is painted."""
NOT_NEEDED, MISSING, REACHED = 0, 1, 2
"""What a cell is."""
_EDGE_POINTS = 8
"""Points of a ghost's edge: lenses bend it."""
_ASSUMED_FOCAL = 1.2
"""Focal length over the image's width, before it is known: 45° across, usual over belts."""
_FILL = 0.55
"""Share of the image's width that the board fills in a starting pose."""
_STARTS = (
    ((0.0, 0.0), (0.0, 0.0)), ((-0.2, -0.15), (0.5, 0.0)), ((0.2, -0.15), (0.0, 0.5)),
    ((0.2, 0.15), (-0.5, 0.0)), ((-0.2, 0.15), (0.0, -0.5)), ((0.0, 0.0), (0.4, 0.4)),
)  # fmt: skip
"""Starting poses: centre in shares of the image, and tilts about x and y, rad; as Zhang (2000) asks, not parallel."""


@dataclass(frozen=True, slots=True, eq=False)
class RigVerdict:
    """The newest calibration of the views, as it is guided by."""

    rig: Rig
    views: int
    """Frames that it was made from."""
    held_out_px: float
    square_rms_mm: float
    sigma_mm: float
    """Median σ of depth from calibration at the distance where it is largest."""
    uncovered: float
    """Share of what the belt needs whose depth is uncertain for lack of views."""
    is_sound: bool
    findings: tuple[str, ...]
    next_pose: Pose | None
    next_words: str
    volume: MeasuringVolume

    def is_enough(self, tolerance_mm: float) -> bool:
        """Return whether σ over what the belt needs is within a tolerance, and nothing contradicts the fit."""
        return self.is_sound and self.sigma_mm <= tolerance_mm and self.uncovered <= MAX_UNCOVERED


MAX_UNCOVERED = 0.02
"""Largest share of what the belt needs that may be uncertain: as the calibration remarks on."""


def read_verdict(folder: Path, plan: Path | None) -> RigVerdict | None:
    """Read what `calibrate` wrote into a folder; None where there is nothing. ``plan``: the belt's plan.toml."""
    path = folder / "calibration.json"
    if not (folder / "rig.json").is_file() or not path.is_file():
        return None
    document, rig = read_json(path), read_rig(folder / "rig.json")
    score, sigmas = document["held_out"] or document["training"], document["depth_sigma_mm"]
    depths = sigmas[0]["depth_mm"], sigmas[-1]["depth_mm"]
    pose = document["next_pose"]
    return RigVerdict(
        rig=rig,
        views=document["training"]["frames"],
        held_out_px=score["rms_px"],
        square_rms_mm=score["square_rms_mm"],
        sigma_mm=max(one["median"] for one in sigmas),
        uncovered=document["coverage"]["uncertain"],
        is_sound=document["fit"]["sound"],
        findings=tuple(document["fit"]["doubts"]),
        next_pose=None if pose is None else Pose.of(**_name_pose(pose["core_from_board"])),
        next_words="" if pose is None else pose["words"],
        volume=make_volume_of_view(rig, depths) if plan is None else read_measuring_volume(plan),
    )


def _name_pose(entry: Mapping[str, Sequence[float]]) -> dict[str, Sequence[float]]:
    return {"rotation": entry["rotation"], "translation_mm": entry["translation_mm"]}


def paint_coverage(
    sizes_px: Mapping[str, tuple[int, int]], corners_px: Mapping[str, Array], verdict: RigVerdict | None
) -> dict[str, list[list[int]]]:
    """Return for each camera the cells (rows, columns) of its image: not needed, missing or reached.

    ``corners_px``: all corners (n, 2) of the views taken. Without a verdict every cell is needed.
    """
    return {name: _paint(size, corners_px.get(name), name, verdict) for name, size in sizes_px.items()}


def _paint(
    size_px: tuple[int, int], corners_px: Array | None, name: str, verdict: RigVerdict | None
) -> list[list[int]]:
    (columns, rows), (width, height) = CELLS, size_px
    u = (np.arange(columns) + 0.5) * width / columns - 0.5
    v = (np.arange(rows) + 0.5) * height / rows - 0.5
    centres = np.stack(np.meshgrid(u, v), axis=-1)
    needed = np.ones((rows, columns), bool)
    if verdict is not None and name in verdict.rig.cameras:
        needed = _find_needed(size_px, name, verdict)
    reached = np.zeros((rows, columns), bool)
    if corners_px is not None and len(corners_px):
        from scipy.spatial import KDTree

        distance, _ = KDTree(corners_px).query(centres)
        reached = np.asarray(distance) <= REACH * float(np.hypot(width, height))
    cells = np.where(reached, REACHED, np.where(needed, MISSING, NOT_NEEDED))
    return cells.astype(int).tolist()


def _find_needed(size_px: tuple[int, int], name: str, verdict: RigVerdict) -> Mask:
    """Return the cells (rows, columns) that see the measuring volume within the core camera's view."""
    (columns, rows), rig, (width, height) = CELLS, verdict.rig, size_px
    points = verdict.volume.points_mm
    core, _ = project_beyond(rig.core_camera, Pose.identity(), points)
    points = points[_is_within(core, rig.core_camera.size_px)]
    pixels, _ = project_beyond(rig.cameras[name], rig.cam_from_core[name], points)
    pixels = pixels[_is_within(pixels, size_px)]
    needed = np.zeros((rows, columns), bool)
    column = np.clip(((pixels[:, 0] + 0.5) * columns / width).astype(int), 0, columns - 1)
    row = np.clip(((pixels[:, 1] + 0.5) * rows / height).astype(int), 0, rows - 1)
    needed[row, column] = True
    return needed


def _is_within(pixels: Array, size_px: tuple[int, int]) -> Mask:
    with np.errstate(invalid="ignore"):
        within = (pixels >= -0.5) & (pixels <= np.array(size_px) - 0.5)
    return within[:, 0] & within[:, 1]


def draw_ghost(
    board: Board, sizes_px: Mapping[str, tuple[int, int]], core: str, verdict: RigVerdict | None, taken: int
) -> dict[str, list[list[float]]]:
    """Return the outline (n, 2) px of the next pose of the board in every camera that would see it.

    Before there is a rig it is one of a few starting poses, in the core camera only. Until there is a newer score,
    views after the first are at quarter turns of the next pose: each tilts the board in another direction.
    """
    outline = outline_mm(board)
    if verdict is not None and verdict.next_pose is not None:
        rig = verdict.rig
        pose = _turn_quarters(verdict.next_pose, outline.mean(axis=0), max(taken - verdict.views, 0))
        seen = {
            name: rig.cameras[name].project((rig.cam_from_core[name] @ pose).apply(outline))
            for name in rig.cameras
            if name in sizes_px
        }
    elif core in sizes_px:
        camera, pose = _make_start(outline, core, sizes_px[core], taken)
        seen = {core: camera.project(pose.apply(outline))}
    else:
        return {}
    return {
        name: np.round(pixels, 1).tolist()
        for name, pixels in seen.items()
        if np.isfinite(pixels).all() and _is_within(pixels, sizes_px[name]).mean() >= 0.5
    }


def _turn_quarters(pose: Pose, middle_mm: Array, quarters: int) -> Pose:
    """Return a pose turned about the core's optical axis through the board's middle."""
    turn = rotation_from_vector(np.array([0.0, 0.0, np.pi / 2 * (quarters % 4)]))
    return Pose.placing(turn @ pose.rotation, middle_mm, pose.apply(middle_mm))


def outline_mm(board: Board) -> Array:
    """Return points (n, 3) along the edge of the board's print: a square beyond its outermost corners."""
    points = corner_points_mm(board)
    low, high = points.min(axis=0)[:2] - board.square_mm, points.max(axis=0)[:2] + board.square_mm
    ends = np.array(
        [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]], [low[0], low[1]]]
    )
    share = np.linspace(0, 1, _EDGE_POINTS, endpoint=False)[:, None]
    edges = np.concatenate([a + share * (b - a) for a, b in pairwise(ends)])
    return np.column_stack([edges, np.zeros(len(edges))])


def _make_start(outline_mm: Array, name: str, size_px: tuple[int, int], taken: int) -> tuple[Camera, Pose]:
    width, height = size_px
    focal = _ASSUMED_FOCAL * width
    camera = Camera(name, size_px, np.full(2, focal), np.array([width, height]) / 2 - 0.5, np.zeros(5))
    (u, v), (about_x, about_y) = _STARTS[taken % len(_STARTS)]
    extent_mm = float(np.ptp(outline_mm[:, 0]))
    depth = focal * extent_mm / (_FILL * width)
    middle = (outline_mm.min(axis=0) + outline_mm.max(axis=0)) / 2
    rotation = rotation_from_vector(np.array([about_x, about_y, 0.0]))
    centre = np.array([u * width / focal * depth, v * height / focal * depth, depth])
    return camera, Pose.placing(rotation, middle, centre)


def find_moved_camera(
    verdict: RigVerdict,
    board: Board,
    views: Sequence[Mapping[str, Corners]],
    sizes_px: Mapping[str, tuple[int, int]],
) -> str:
    """Return the camera that stands elsewhere in these new views than in the calibrated ones; empty: none does."""
    rig = verdict.rig
    names = [name for name in rig.cameras if name in sizes_px]
    by_camera = {
        name: {f"{i:03d}": view[name] for i, view in enumerate(views) if name in view} for name in names
    }
    sizes = {name: rig.cameras[name].size_px for name in names}
    detections = BoardDetections(sizes, by_camera, {name: len(views) for name in names})
    return find_displaced_camera(rig, detections, board)
