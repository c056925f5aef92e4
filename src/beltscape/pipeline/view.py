"""Contents of the engineer's 3-D viewer, collected from a rig, a frame or a sequence on disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_mapping
from beltscape.core.cloud import PointCloud
from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.atomic import write_text
from beltscape.files.json_text import read_json
from beltscape.files.ply import read_cloud
from beltscape.files.reconstruction import list_frame_folders, read_frame
from beltscape.files.rig_json import read_rig
from beltscape.measure.lumps.lumps import DOWN
from beltscape.pipeline.measuring.solids import read_solid_outlines
from beltscape.report.drawing.scene import make_belt_triangles, make_rig_scene
from beltscape.report.viewer import ViewerCloud, ViewerScene, render_viewer_page

_POINTS = 300_000
"""Largest number of points of one frame; a browser rotates them smoothly."""
_ALL_POINTS = 1_200_000
"""Largest number of points of a sequence."""
_BELT, _PRIMITIVE = "#748ffc", "#ffd43b"


def collect_view(source: Path, *, belt: Path | None, features: Path | None) -> ViewerScene:
    """Return the viewer's contents for rig.json or its folder, a frame's folder, or a reconstruction.

    ``belt`` is a belt.json, which also gives the upright frame; ``features`` a features.json.

    Raises
    ------
    InputError
        With one line that names the file and the fix.
    """
    rig, frames = _find_frames(source)
    document: Mapping[str, Any] = {} if belt is None else _read_mapping(belt)
    belt_from_core = None if belt is None else _parse_belt_pose(belt, document)
    up = belt_from_core or DOWN
    budget = min(_POINTS, max(_ALL_POINTS // max(len(frames), 1), 20_000))
    clouds: list[ViewerCloud] = []
    total = 0
    for folder in frames:
        cloud = _read_cloud(folder, rig)
        total += len(cloud.points_mm)
        clouds.append(_rotate_upright(folder.name, _thin(cloud, rig, budget), up))
    lines: list[tuple[str, str, NDArray[np.float64]]] = []
    labels: list[tuple[str, str, NDArray[np.float64]]] = []
    surfaces: list[tuple[str, str, NDArray[np.float64]]] = []
    if rig is not None:
        cameras = make_rig_scene(rig, length_mm=0.2 * _estimate_viewing_distance(rig, clouds, up))
        lines += [("cameras", color, up.apply(line)) for color, line in cameras.lines]
        labels += [("cameras", text, up.apply(where)) for text, where in cameras.labels]
    if belt is not None:
        triangles = make_belt_triangles(document, _find_extent_along(clouds))
        if triangles is None:
            raise InputError(f"{belt}: holds no cross-section x_mm, z_mm; give the belt.json of measure belt")
        surfaces.append(("belt", _BELT, triangles))
    if features is not None:
        for name, outline in read_solid_outlines(features):
            upright = [up.apply(line) for line in outline]
            lines += [("features", _PRIMITIVE, line) for line in upright]
            corners = np.concatenate(upright)
            labels.append(("features", name, np.append(corners[:, :2].mean(axis=0), corners[:, 2].max())))
    frame = "core frame, z towards the camera" if belt is None else "belt frame"
    parts = [] if rig is None else [f"{len(rig.cameras)} cameras"]
    shown = sum(len(cloud.points_mm) for cloud in clouds)
    parts += [f"{shown:,} of {total:,} points"] if clouds else []
    parts += [f"{len(clouds)} frames"] if len(clouds) > 1 else []
    title = source.resolve().name if source.is_dir() else source.resolve().parent.name
    if len(frames) == 1 and frames[0] == source:
        title = f"{source.resolve().parent.name} / {title}"
    return ViewerScene(title, " · ".join([*parts, frame]), clouds, lines, surfaces, labels)


def write_view(path: Path, view: ViewerScene) -> None:
    """Write the viewer's page atomically."""
    write_text(path, render_viewer_page(view))


def _find_frames(source: Path) -> tuple[Rig | None, Sequence[Path]]:
    """Return the rig and the frames' folders in order."""
    if source.is_file():
        return read_rig(source), ()
    frames = list_frame_folders(source)
    rig = (source.parent if frames == [source] else source) / "rig.json"
    if not frames and not rig.is_file():
        raise InputError(
            f"{source}: holds neither rig.json nor frames with depth.tiff; "
            "give a rig.json, or a folder of beltscape calibrate or reconstruct"
        )
    return (read_rig(rig) if rig.is_file() else None), frames


def _read_cloud(folder: Path, rig: Rig | None) -> PointCloud:
    """Return the points of cloud.ply, or of the depth map in grey if there is none."""
    if (folder / "cloud.ply").is_file():
        return read_cloud(folder / "cloud.ply")
    if rig is None:
        raise InputError(
            f"{folder}: holds no cloud.ply, and no rig.json lies beside it; reconstruct the frame again"
        )
    depth = read_frame(folder).depth
    points = depth.points_mm(rig.core_camera)[depth.measured].astype(np.float32)
    unknown = np.full(points.shape, np.nan, np.float32)
    return PointCloud(points, unknown, np.full(points.shape, 190, np.uint8), depth.sigma_mm[depth.measured])


def _thin(cloud: PointCloud, rig: Rig | None, budget: int) -> PointCloud:
    """Return at most ``budget`` points: a regular subset of the core's pixels if it fits, else a random sample."""
    count = len(cloud.points_mm)
    if count <= budget:
        return cloud
    keep = None
    if rig is not None:
        camera = rig.core_camera
        points = cloud.points_mm.astype(np.float64)
        pixel = np.rint(points[:, :2] / points[:, 2:] * camera.focal_px + camera.center_px).astype(np.int64)
        step = int(np.ceil(np.sqrt(count / budget)))
        keep = np.flatnonzero((pixel % step == 0).all(axis=1))
    if keep is None or not 0.5 * budget / 4 < len(keep) <= 1.1 * budget:
        keep = np.sort(np.random.default_rng(0).permutation(count)[:budget])
    return PointCloud(
        cloud.points_mm[keep], cloud.normals[keep], cloud.colors[keep], cloud.sigma_mm[keep], cloud.frame
    )


def _rotate_upright(name: str, cloud: PointCloud, up: Pose) -> ViewerCloud:
    normals = cloud.normals.astype(np.float64) @ up.rotation.T
    return ViewerCloud(
        name, up.apply(cloud.points_mm.astype(np.float64)), normals, cloud.colors, cloud.sigma_mm
    )


def _estimate_viewing_distance(rig: Rig, clouds: Sequence[ViewerCloud], up: Pose) -> float:
    """Return the distance from the core camera to the surface, estimated from the baselines without a cloud."""
    if clouds and len(clouds[0].points_mm):
        return float(np.median(np.linalg.norm(clouds[0].points_mm - up.translation_mm, axis=1)))
    centers = [pose.inverse().translation_mm for pose in rig.cam_from_core.values()]
    apart = max(float(np.linalg.norm(center)) for center in centers)
    return 2.5 * apart if apart else 500.0


def _find_extent_along(clouds: Sequence[ViewerCloud]) -> tuple[float, float]:
    """Return the range of the points along the belt."""
    along = [np.quantile(cloud.points_mm[:, 1], [0.005, 0.995]) for cloud in clouds if len(cloud.points_mm)]
    return (float(min(a for a, _ in along)), float(max(b for _, b in along))) if along else (-300.0, 300.0)


def _read_mapping(path: Path) -> Mapping[str, Any]:
    document = read_json(path)
    if not is_mapping(document):
        raise InputError(f"{path}: is no JSON object; give the file that beltscape measure wrote")
    return document


def _parse_belt_pose(path: Path, document: Mapping[str, Any]) -> Pose:
    belt = document.get("belt", document)
    pose: Any = belt.get("belt_from_core") if is_mapping(belt) else None
    try:
        rotation = np.array(pose["rotation"], np.float64).reshape(3, 3)
        return Pose(rotation, np.array(pose["translation_mm"], np.float64).reshape(3))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: holds no pose belt_from_core; give the belt.json of measure belt"
        ) from error
