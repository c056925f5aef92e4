"""Measurement of the empty belt from reconstructed frames, and its file belt.json; warnings of frames' faults."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beltscape import __version__
from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError, MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Reporter
from beltscape.files.atomic import write_text
from beltscape.files.belt_json import read_belt, write_belt
from beltscape.files.json_text import hash_file
from beltscape.files.reconstruction import FrameResult, list_frame_folders, read_frame, require_intact
from beltscape.learned.registry import hash_networks
from beltscape.measure.belt.empty_belt import average_depth_maps, learn_belt
from beltscape.measure.belt.given import apply_given, describe_doubts, measure_width_mm
from beltscape.measure.belt.settings import NOTHING_GIVEN, GivenBelt


def warn_of_camera_faults(frame: FrameResult, reporter: Reporter) -> None:
    """Warn of a frame's camera faults; their systematic error is included in its depth map's σ."""
    for line in frame.faults:
        reporter.warn(f"{frame.folder}: {line}")


def measure_empty_belt(
    folder: Path, frames: Sequence[str] | None, reporter: Reporter, given: GivenBelt = NOTHING_GIVEN
) -> tuple[Belt, DepthMap]:
    """Return the empty belt measured in a reconstruction's frames (all by default), and the mean of these.

    ``given`` is what is known of the belt's width, ends or place. A warning names the ends that remain unknown.

    Raises
    ------
    InputError, MeasureError
        With one line that names the fault and the fix.
    """
    names = list_frame_names(folder) if frames is None else list(frames)
    results: list[FrameResult] = []
    for number, name in enumerate(names, 1):
        results.append(read_intact_frame(folder / name))
        warn_of_camera_faults(results[-1], reporter)
        reporter.step("reading empty belt", number, len(names))
    depths = [result.depth for result in results]
    belt = _learn_belt(depths, results[0].rig.core_camera, given, folder, reporter)
    return belt, average_depth_maps(depths)


def _learn_belt(
    depths: Sequence[DepthMap], camera: Camera, given: GivenBelt, source: Path, reporter: Reporter
) -> Belt:
    """Return the belt learned from depth maps; warn of ends that are not known, naming the ``source``."""
    try:
        belt = learn_belt(depths, camera, given)
    except MeasureError as error:
        raise MeasureError(f"{source}: {error}") from error
    for warning in describe_doubts(belt):
        reporter.warn(f"{source}: {warning}")
    return belt


def list_frame_names(folder: Path) -> list[str]:
    """Return the names of a reconstruction's frame folders in order."""
    if folder.is_file():
        raise InputError(f"{folder}: is a file; give a reconstruction of beltscape reconstruct")
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a reconstruction of beltscape reconstruct")
    names = [path.name for path in list_frame_folders(folder) if path != folder]
    if not names:
        raise InputError(
            f"{folder}: no frame folder with a depth.tiff; give a reconstruction of beltscape reconstruct"
        )
    return names


def read_empty_belt(path: Path, reporter: Reporter, given: GivenBelt = NOTHING_GIVEN) -> tuple[Belt, Camera]:
    """Return the empty belt and its core camera from a belt.json, a frame folder or a whole reconstruction.

    ``given`` is what is known of the belt's width, ends or place; a region needs depth maps.
    """
    if path.is_file():
        return _limit_read_belt(path, given)
    if not path.exists():
        raise InputError(
            f"{path}: no such file or folder; give a belt.json of beltscape measure belt, a reconstruction of the "
            "empty belt, or a frame folder of one"
        )
    if (path / "rig.json").is_file() and not (path / "depth.tiff").is_file():
        belt = measure_empty_belt(path, None, reporter, given)[0]
        return belt, require_camera(belt)
    frame = read_intact_frame(path)
    warn_of_camera_faults(frame, reporter)
    camera = frame.rig.core_camera
    return _learn_belt([frame.depth], camera, given, path, reporter), camera


def _limit_read_belt(path: Path, given: GivenBelt) -> tuple[Belt, Camera]:
    """Return the belt of a belt.json within the ends that are given."""
    belt, camera = read_belt(path)
    for name, value, option in (
        ("region_px", given.region_px, "--region"),
        ("travel_deg", given.travel_deg, "--travel"),
    ):
        if value is not None:
            raise InputError(
                f"{path}: {name} needs the depth maps of the empty belt; give it to beltscape measure belt {option}, "
                "or a reconstruction as the empty belt"
            )
    try:
        return apply_given(belt, given), camera
    except MeasureError as error:
        raise MeasureError(f"{path}: {error}") from error


def require_camera(belt: Belt) -> Camera:
    """Return the core camera of a belt that was learned."""
    assert belt.camera is not None
    return belt.camera


def hash_empty_belt(path: Path) -> str:
    """Return the SHA-256 of what `read_empty_belt` reads: of a belt.json, or of the frames' depth maps."""
    if path.is_file():
        return hash_file(path)
    joined = "".join(hash_file(frame / "depth.tiff") for frame in list_frame_folders(path))
    return hashlib.sha256(joined.encode()).hexdigest()


def describe_measured_by(rig: Path, empty: Path) -> dict[str, str]:
    """Return what a measurement rests on: the program's version, and SHA-256 of rig, empty belt and networks.

    Raises
    ------
    InputError
        If one of the files cannot be read.
    """
    try:
        return {
            "program": __version__,
            "rig": hash_file(rig),
            "empty": hash_empty_belt(empty),
            "networks": hash_networks(),
        }
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read ({error.strerror})") from error


def read_intact_frame(folder: Path) -> FrameResult:
    """Return a frame whose files are those that were written."""
    frame = read_frame(folder)
    place = frame.folder.resolve()
    require_intact(place.parent, place.name)
    return frame


def require_same_camera(loaded: Path, camera: Camera, empty: Path, other: Camera) -> None:
    """Raise InputError if the load and the empty belt were not reconstructed on the same grid."""
    same = (
        camera.name == other.name
        and camera.size_px == other.size_px
        and np.allclose(camera.focal_px, other.focal_px, rtol=1e-9)
        and np.allclose(camera.center_px, other.center_px, atol=1e-6)
    )
    if not same:
        raise InputError(
            f"{loaded} and {empty}: reconstructed with different rigs; reconstruct both with the same rig.json"
        )


def write_belt_files(out: Path, belt: Belt, depth: DepthMap) -> Path:
    """Write belt.json and its report, with a picture of what was taken as belt; return the report's path."""
    from beltscape.report.measuring.belt import render_belt_page

    write_belt(out, belt, require_camera(belt))
    page = out.with_suffix(".html")
    write_text(page, render_belt_page(belt, depth, describe_doubts(belt)))
    return page


def make_belt_document(belt: Belt) -> Mapping[str, Any]:
    """Return the result of ``measure belt --json``."""
    edges = belt.edges
    return {
        "frames": belt.frames,
        "belt_from_core": {
            "rotation": belt.belt_from_core.rotation,
            "translation_mm": belt.belt_from_core.translation_mm,
        },
        "tilt_sigma_deg": float(np.rad2deg(belt.tilt_sigma_rad)),
        "yaw_sigma_deg": None if belt.yaw_sigma_rad is None else float(np.rad2deg(belt.yaw_sigma_rad)),
        "yaw_from": belt.yaw_from,
        "across_mm": belt.across_mm,
        "ends": belt.ends,
        "width_mm": measure_width_mm(belt),
        "width_given_mm": belt.width_mm,
        "along_mm": belt.along_mm,
        "flat_mm": belt.flat_mm,
        "noise_mm": belt.noise_mm,
        "section_sigma_mm": float(np.median(belt.z_sigma_mm)),
        "deviation_mm": None if belt.deviation is None else float(np.std(belt.deviation.height_mm)),
        "edges_mm": None if edges is None else [edges.left_mm, edges.right_mm],
        "edges_sigma_mm": None if edges is None else [edges.left_sigma_mm, edges.right_sigma_mm],
        "misaligned_mm": None if edges is None else edges.offset_mm,
        "misaligned_sigma_mm": None if edges is None else edges.sigma_mm,
        "trough_middle_mm": belt.middle_mm,
    }
