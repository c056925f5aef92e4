"""Export of a frame's point cloud as PLY, LAS or LAZ, in the core camera's or the belt's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from beltscape.core.checks import is_dict
from beltscape.core.cloud import PointCloud
from beltscape.core.errors import InputError
from beltscape.files.belt_json import read_belt
from beltscape.files.clouds import ENDINGS, FORMATS, require_ending, write_cloud
from beltscape.files.json_text import compute_file_digests, read_json
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.ply import read_cloud
from beltscape.files.reconstruction import DOCUMENT, FrameResult, read_frame

EXTRA_FORMATS = tuple(ending.removeprefix(".") for ending in ENDINGS if ending != ".ply")
"""Formats that `reconstruct` writes beside cloud.ply."""


@dataclass(frozen=True, slots=True)
class ExportedCloud:
    """The cloud that was written."""

    path: Path
    points: int
    frame: str
    """Coordinate frame of its points: core or belt."""
    unit: str
    """Unit of its coordinates."""


def export_cloud(source: AnyPath, out: AnyPath, belt: AnyPath | None = None) -> ExportedCloud:
    """Write the cloud of a frame folder, or of the only one of a reconstruction, in the format of ``out``'s ending.

    ``belt`` is a belt.json, in whose frame the points are written; None: they stay in the core camera's.

    Raises
    ------
    InputError
        When the frame has no cloud, ``out`` has no ending of `beltscape.files.clouds.ENDINGS`, or a library is
        missing.
    """
    out = as_path(out, "out")
    ending = require_ending(out.name)
    frame = read_frame(source)
    cloud = _read_cloud(frame)
    if belt is not None:
        cloud = cloud.transform(read_belt(as_path(belt, "belt"))[0].belt_from_core, "belt")
    write_cloud(out, cloud, _describe_provenance(frame))
    return ExportedCloud(out, len(cloud.points_mm), cloud.frame, FORMATS[ending].unit)


def export_clouds(folders: Sequence[Path], formats: Sequence[str]) -> None:
    """Write cloud.las or cloud.laz beside the cloud.ply of finished frame folders."""
    for folder in folders:
        for name in formats:
            export_cloud(folder, folder / f"cloud.{name}")


def _read_cloud(frame: FrameResult) -> PointCloud:
    """Return the points of cloud.ply, with the confidence of the depth map if it has as many pixels."""
    path = frame.folder / "cloud.ply"
    if not path.is_file():
        raise InputError(f"{frame.folder}: holds no cloud.ply; reconstruct the frame again")
    cloud = read_cloud(path)
    confidence = frame.depth.confidence[frame.depth.measured]
    return replace(cloud, confidence=confidence) if len(confidence) == len(cloud.points_mm) else cloud


def _describe_provenance(frame: FrameResult) -> dict[str, object]:
    """Return where the points come from: frame, core camera, digest of the rig, and how they were matched."""
    above = frame.folder.resolve().parent
    document: Any = read_json(above / DOCUMENT) if (above / DOCUMENT).is_file() else None
    how = {key: document.get(key) for key in ("method", "preset")} if is_dict(document) else {}
    digests = compute_file_digests(above, ["rig.json"])
    return {
        **how,
        "core": frame.rig.core,
        "frame_folder": frame.folder.resolve().name,
        "rig_sha256": digests["rig.json"],
    }
