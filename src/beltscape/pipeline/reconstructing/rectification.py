"""Rectification of a capture into epipolar pairs, with a measured check of their row error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.atomic import ensure_output_folder
from beltscape.files.images import write_image
from beltscape.files.json_text import write_json
from beltscape.files.paths import AnyPath, as_path
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.pipeline.reconstructing.reconstruction import check_images, open_capture
from beltscape.pipeline.reconstructing.search_range import check_depth_range, find_capture_depth_range
from beltscape.report.control_pictures import draw_rectification
from beltscape.sources.folder import FolderSource, scale_rig_to_capture
from beltscape.stereo.cameras import list_usable_auxiliaries
from beltscape.stereo.consistency.check import check_consistency
from beltscape.stereo.consistency.diagnosis import describe_undecided, diagnose_cameras
from beltscape.stereo.consistency.rig_consistency import (
    CameraConsistency,
    RigConsistency,
    make_consistency_document,
)
from beltscape.stereo.pairwise.rectification import RectifiedImages, rectify_images, rectify_pair


def rectify_capture(
    capture: AnyPath,
    rig: Rig,
    out: AnyPath,
    reporter: Reporter,
    *,
    depth_range_mm: tuple[float, float] | None = None,
) -> tuple[tuple[float, float], list[Mapping[str, Any]]]:
    """Rectify every frame into ``out``; return the depth range used and one document per frame.

    Raises
    ------
    InputError, ReconstructionError, OutputError
        With one line that names the fault and the fix.
    """
    capture, out = as_path(capture, "capture"), as_path(out, "out")
    rig = scale_rig_to_capture(rig, capture, reporter)
    source = open_capture(capture, rig, reporter)
    ensure_output_folder(out)
    check_depth_range(depth_range_mm, source, rig, reporter)
    near_far = depth_range_mm or find_capture_depth_range(source, rig, reporter)
    frames: list[Mapping[str, Any]] = []
    for frame_set, pairs, consistency, faults in rectify(source, rig, near_far, reporter):
        folder = out / frame_set.frame
        for images in pairs:
            write_image(folder / images.pair.auxiliary / "core.png", images.core)
            write_image(folder / images.pair.auxiliary / "auxiliary.png", images.auxiliary)
        write_image(
            folder / "rectification.png",
            draw_rectification(rig, frame_set, pairs, consistency, faults),
        )
        document = {
            "frame": frame_set.frame,
            "pairs": [
                _document(images, each) for images, each in zip(pairs, consistency.cameras, strict=True)
            ],
            "doubts": faults,
            "consistency": make_consistency_document(consistency),
        }
        write_json(folder / "rectification.json", document)
        frames.append({**document, "folder": folder})
    return near_far, frames


def _document(images: RectifiedImages, camera: CameraConsistency) -> Mapping[str, Any]:
    """Return a pair as plain values; row errors are rows of the auxiliary minus those of the core."""
    pair, rows = images.pair, camera.rows
    return {
        "core": pair.core,
        "auxiliary": pair.auxiliary,
        "size_px": pair.size_px,
        "focal_px": pair.focal_px,
        "core_center_px": pair.core_center_px,
        "auxiliary_center_px": pair.aux_center_px,
        "baseline_mm": pair.baseline_mm,
        "disparities": pair.disparities,
        "rectified_from_core": pair.rectified_from_core.rotation,
        "rectified_from_auxiliary": pair.rectified_from_aux.rotation,
        "row_error": {
            "points": rows.explained,
            "searched": camera.searched,
            "median_px": -rows.offset_px,
            "slope_x_px": -rows.slope_x_px,
            "slope_y_px": -rows.slope_y_px,
            "sigma_px": rows.sigma_px,
            "rms_px": rows.rms_px,
        },
    }


def rectify(
    source: FolderSource, rig: Rig, depth_range_mm: tuple[float, float], reporter: Reporter
) -> Iterator[tuple[FrameSet, list[RectifiedImages], RigConsistency, list[str]]]:
    """Yield every frame's pairs about the core camera (the paper's Section 2.3.1) and its cameras' consistency."""
    pairs = {
        name: rectify_pair(rig, name, depth_range_mm) for name in rig.auxiliaries if name in source.cameras
    }
    monitor = ImageMonitor(rig, HealthSettings(learning=False))
    for done, frame_set in enumerate(source, start=1):
        check_images(monitor, frame_set, reporter)
        try:
            names = list_usable_auxiliaries(rig, frame_set, tuple(pairs))
        except ReconstructionError as error:
            reporter.warn(f"{error}; going on without this frame")
            continue
        images = [rectify_images(frame_set, pairs[name]) for name in names]
        consistency = check_consistency(frame_set, rig, None, names)
        faults = [
            *(fault.text for fault in diagnose_cameras(frame_set, rig, consistency)),
            *describe_undecided(consistency, rig),
        ]
        for line in faults:
            reporter.warn(f"frame {frame_set.frame}: {line}")
        reporter.step("rectifying", done, len(source))
        yield frame_set, images, consistency, faults
