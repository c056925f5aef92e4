"""Reading and writing of reconstructions: ``DIR/rig.json`` and one folder ``DIR/<frame>/`` per frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_dict, is_list, is_list_or_tuple
from beltscape.core.cloud import PointCloud
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import Image
from beltscape.core.geometry.rig import Rig
from beltscape.files.atomic import ensure_output_folder
from beltscape.files.images import EXTENSIONS, read_image, write_image
from beltscape.files.json_text import (
    add_digest,
    compute_file_digests,
    parse_numbers,
    read_json,
    require_digest,
    write_json,
)
from beltscape.files.output_folder import require_finished
from beltscape.files.paths import AnyPath, as_path, summarise_names
from beltscape.files.ply import write_ply
from beltscape.files.rig_json import read_rig
from beltscape.files.tiff import read_float_tiff, write_float_tiff

FORMAT, DOCUMENT = "beltscape-reconstruction/1", "reconstruction.json"
_MEASURED = ("depth.tiff", "sigma.tiff", "confidence.tiff", "views.png")
"""Files of a frame folder from which heights are measured; reconstruction.json has their digests."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """One reconstructed frame read from its folder."""

    folder: Path
    rig: Rig
    depth: DepthMap
    image: Image | None = None
    """The core camera's image (H, W) or (H, W, 3) on the same grid; None if it was not stored."""
    faults: tuple[str, ...] = ()
    """Faults that the camera consistency check found, one line each (``doubts`` in reconstruction.json)."""


def write_frame(
    folder: Path, depth: DepthMap, cloud: PointCloud, preview: Image, image: Image | None = None
) -> None:
    """Write depth.tiff, sigma.tiff, confidence.tiff, views.png, cloud.ply, preview.png and, if given, image.png.

    ``image`` is the core camera's, on the depth map's undistorted grid.
    """
    ensure_output_folder(folder)
    write_float_tiff(folder / "depth.tiff", depth.depth_mm)
    write_float_tiff(folder / "sigma.tiff", depth.sigma_mm)
    write_float_tiff(folder / "confidence.tiff", depth.confidence)
    write_image(folder / "views.png", depth.views)
    write_ply(folder / "cloud.ply", cloud)
    write_image(folder / "preview.png", preview)
    if image is not None:
        write_image(folder / "image.png", image)


def write_depth_map(folder: Path, depth: DepthMap | NDArray[np.floating]) -> None:
    """Write a depth map into a frame folder: of an array of depths depth.tiff alone, of a DepthMap all it holds."""
    ensure_output_folder(folder)
    if not isinstance(depth, DepthMap):
        write_float_tiff(folder / "depth.tiff", depth.astype(np.float32))
        return
    for name in ("depth", "sigma", "confidence"):
        values = depth.confidence if name == "confidence" else getattr(depth, f"{name}_mm")
        write_float_tiff(folder / f"{name}.tiff", values)
    write_image(folder / "views.png", depth.views.astype(np.uint8))


def read_depth_map(path: Path) -> DepthMap:
    """Read the depth map of a frame folder, or a depth.tiff alone; σ is NaN where there is no sigma.tiff beside it.

    Raises
    ------
    InputError
        If a file is missing, unreadable, or of another size.
    """
    folder, file = (path, path / "depth.tiff") if path.is_dir() else (path.parent, path)
    depth = read_float_tiff(file)
    sigma = np.full_like(depth, np.nan)
    if (folder / "sigma.tiff").is_file() and file.name == "depth.tiff":
        sigma = read_float_tiff(folder / "sigma.tiff")
    confidence = _confidence(folder / "confidence.tiff", depth)
    for name, values in (("sigma.tiff", sigma), ("confidence.tiff", confidence)):
        if values.shape != depth.shape:
            raise InputError(
                f"{folder / name}: {values.shape[1]}×{values.shape[0]} px, but {file.name} beside it has "
                f"{depth.shape[1]}×{depth.shape[0]}; write both again"
            )
    return DepthMap(depth, sigma, _views(folder / "views.png", depth), confidence)


def write_reconstruction(folder: Path, how: Mapping[str, Any], frames: Sequence[Mapping[str, Any]]) -> None:
    """Write reconstruction.json: how frames were matched, each frame's coverage and faults, and files' digests."""
    frames = [{key: value for key, value in frame.items() if key != "folder"} for frame in frames]
    names = ["rig.json", *(f"{frame['frame']}/{name}" for frame in frames for name in _MEASURED)]
    files = compute_file_digests(folder, names)
    write_json(folder / DOCUMENT, add_digest({"format": FORMAT, **how, "frames": frames, "files": files}))


def require_intact(folder: Path, frame: str) -> None:
    """Raise InputError if a frame's files, the rig, or reconstruction.json contradict the digests in the latter.

    A reconstruction without digests is accepted.
    """
    path, fix = folder / DOCUMENT, "copy the reconstruction again, or reconstruct again"
    document = read_json(path) if path.is_file() else None
    if not is_dict(document):
        return
    require_digest(path, document, fix)
    expected = document.get("files")
    if not is_dict(expected):
        return
    own = [name for name in expected if "/" not in name or name.startswith(f"{frame}/")]
    for name, digest in compute_file_digests(folder, own).items():
        if digest != expected[name]:
            raise InputError(
                f"{folder / name}: its content contradicts its sha256 in {DOCUMENT}: the file was changed or "
                f"damaged after it was written; {fix}"
            )


def list_frame_folders(folder: Path) -> list[Path]:
    """Return the frame folders of a reconstruction in order, the folder itself if it is one, or an empty list."""
    require_finished(folder)
    if (folder / "depth.tiff").is_file():
        return [folder]
    return sorted(path.parent for path in folder.glob("*/depth.tiff")) if folder.is_dir() else []


def find_single_frame(folder: Path) -> Path:
    """Return ``folder`` if it is a frame folder, or the only frame folder in it.

    Raises
    ------
    InputError
        When there is no such folder, no frame in it, or more than one.
    """
    if folder.is_file():
        raise InputError(
            f"{folder}: is a file; give the frame folder of beltscape reconstruct that it lies in"
        )
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a frame folder of beltscape reconstruct")
    frames = list_frame_folders(folder)
    if not frames:
        if any(path.suffix.lower() in EXTENSIONS for path in folder.glob("*/*")):
            raise InputError(f"{folder}: holds images, not depths; give a folder of beltscape reconstruct")
        raise InputError(
            f"{folder}: holds no depth.tiff, nor folders with one; give a frame folder of beltscape reconstruct"
        )
    if len(frames) > 1:
        names = [path.name for path in frames]
        shown = summarise_names(names)
        raise InputError(f"{folder}: holds the frames {shown}; give one of them, such as {frames[0]}")
    return frames[0]


def read_frame(folder: AnyPath) -> FrameResult:
    """Read a frame folder, or the only one of a reconstruction, and the rig beside it.

    Raises
    ------
    InputError
        When a file is missing, unreadable, or does not match the rig.
    """
    folder = as_path(folder, "folder")
    folder = find_single_frame(folder)
    if not (_reconstruction_folder(folder) / "rig.json").is_file():
        raise InputError(
            f"{folder}: no rig.json lies beside this frame, in {_reconstruction_folder(folder)}; "
            "copy the reconstruction as a whole, or reconstruct again"
        )
    rig = read_rig(_reconstruction_folder(folder) / "rig.json")
    depth, sigma = read_float_tiff(folder / "depth.tiff"), read_float_tiff(folder / "sigma.tiff")
    confidence = _confidence(folder / "confidence.tiff", depth)
    width, height = rig.core_camera.size_px
    for name, values in (("depth.tiff", depth), ("sigma.tiff", sigma), ("confidence.tiff", confidence)):
        if values.shape != (height, width):
            raise InputError(
                f"{folder / name}: {values.shape[1]}×{values.shape[0]} px, but the rig's core camera {rig.core} "
                f"has {width}×{height}; the rig.json beside the frame is another rig's"
            )
    views, image = _views(folder / "views.png", depth), _image(folder / "image.png", depth)
    systematic_mm, faults = _read_faults(folder)
    return FrameResult(folder, rig, DepthMap(depth, sigma, views, confidence, systematic_mm), image, faults)


def _read_faults(folder: Path) -> tuple[float, tuple[str, ...]]:
    """Return the systematic σ (mm) and the faults of a frame in reconstruction.json; none without the file."""
    path = folder.parent / DOCUMENT
    if not path.is_file():
        return 0.0, ()
    document = read_json(path)
    if not is_dict(document) or document.get("format") != FORMAT:
        raise InputError(f"{path}: format is not {FORMAT!r}; reconstruct the capture again")
    frames: Any = document.get("frames")
    for frame in frames if is_list(frames) else ():
        if is_dict(frame) and frame.get("frame") == folder.name:
            systematic: Any = frame.get("systematic_mm") or 0.0
            faults: Any = frame.get("doubts") or ()
            if parse_numbers(systematic) is None or not is_list_or_tuple(faults):
                raise InputError(
                    f"{path}: frame {folder.name}: systematic_mm must be a number, doubts a list"
                )
            return float(systematic), tuple(map(str, faults))
    return 0.0, ()


def find_rig_file(frame: Path) -> Path:
    """Return the rig.json beside a frame folder or the depth.tiff in one; it need not exist."""
    return _reconstruction_folder(frame.resolve().parent if frame.is_file() else frame) / "rig.json"


def _reconstruction_folder(folder: Path) -> Path:
    """Return the reconstruction's folder, also for a frame given as ``.`` or ``..``."""
    return folder.resolve().parent if folder.name in ("", "..") else folder.parent


def _confidence(path: Path, depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return each pixel's confidence; without the file, 1 where there is a depth."""
    return read_float_tiff(path) if path.is_file() else np.isfinite(depth).astype(np.float32)


def _views(path: Path, depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the number of auxiliaries that measured each pixel; without the file, 1 where there is a depth."""
    if path.is_file():
        views = read_image(path)
        if views.shape == depth.shape and views.dtype == np.uint8:
            return np.asarray(views, np.uint8)
    return np.isfinite(depth).astype(np.uint8)


def _image(path: Path, depth: NDArray[np.float32]) -> Image | None:
    """Return the core camera's image, if it was stored."""
    if not path.is_file():
        return None
    image = read_image(path)
    if image.shape[:2] != depth.shape:
        raise InputError(
            f"{path}: {image.shape[1]}×{image.shape[0]} px, but the depth map beside it has "
            f"{depth.shape[1]}×{depth.shape[0]}; reconstruct the frame again"
        )
    return image
