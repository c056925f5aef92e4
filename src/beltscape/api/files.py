"""Reading and writing of rigs, captures, belts and point clouds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import require_array, require_instance, require_reporter
from beltscape.core.cloud import PointCloud
from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter, Silent
from beltscape.files import belt_json, clouds, reconstruction, rig_json
from beltscape.files.capture import DEMO_FOLDER, Capture
from beltscape.files.capture import read_capture as list_capture
from beltscape.files.images import read_image
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.ply import write_ply as write_ply_file
from beltscape.sources.folder import FolderSource


def demo_folder() -> Path:
    """Return the folder of the small capture that ships with Beltscape.

    >>> demo = bs.demo_folder()

    It holds the scenes ``calibration``, ``belt_empty``, ``belt_loaded`` and ``module``, ``board.toml``,
    ``module.toml``, and in ``truth`` the true rig and depths.
    """
    return DEMO_FOLDER


def read_rig(path: AnyPath) -> Rig:
    """Return the calibrated rig of a rig.json.

    >>> rig = bs.read_rig(demo / "truth/rig.json")

    Raises
    ------
    InputError
        with the first key that is missing or invalid.
    """
    return rig_json.read_rig(as_path(path, "path"))


def write_rig(rig: Rig, path: AnyPath) -> None:
    """Write a rig as rig.json, atomically and with full float precision.

    >>> bs.write_rig(rig, "rig.json")
    """
    require_instance(rig, Rig, "rig", "bs.read_rig(path)")
    rig_json.write_rig(as_path(path, "path"), rig)


def read_belt(path: AnyPath) -> Belt:
    """Return the empty belt of a belt.json.

    >>> belt = bs.read_belt("belt.json")

    Raises
    ------
    InputError
        with the first key that is missing or invalid, or if the file was changed by hand.
    """
    return belt_json.read_belt(as_path(path, "path"))[0]


def write_belt(belt: Belt, path: AnyPath) -> None:
    """Write an empty belt, with the core camera that it was learned with, as belt.json.

    >>> bs.write_belt(belt, "belt.json")

    Raises
    ------
    InputError
        if the belt does not know its camera, because it was built by hand.
    """
    require_instance(belt, Belt, "belt", "bs.learn_belt(depths, rig)")
    if belt.camera is None:
        raise InputError("belt has no camera: learn it with bs.learn_belt(depths, rig)")
    belt_json.write_belt(as_path(path, "path"), belt, belt.camera)


def write_depth(depth: DepthMap | NDArray[np.floating], folder: AnyPath) -> None:
    """Write a depth map into a frame folder, which `beltscape evaluate depth` and `read_depth` take.

    >>> bs.write_depth(depth_mm, "sgbm/000")

    Parameters
    ----------
    depth
        A DepthMap; or an array (H, W) of depths along the core camera's optical axis on its undistorted grid, mm, NaN
        where not measured, by a method of your own.
    folder
        Folder of the frame, such as ``sgbm/000``; it is created.

    Raises
    ------
    InputError, OutputError
        if the depth is no such array, or the folder cannot be written.
    """
    if not isinstance(depth, DepthMap):
        require_array(depth, "depth", (None, None))
        if not depth.size:
            raise InputError("depth is an array without pixels: must be (H, W)")
    reconstruction.write_depth_map(as_path(folder, "folder"), depth)


def read_depth(folder: AnyPath) -> DepthMap:
    """Return the depth map of a frame folder, or of a depth.tiff alone; σ is NaN where no sigma.tiff is beside it.

    >>> depth = bs.read_depth("depth_loaded/000")

    Raises
    ------
    InputError
        if a file is missing, unreadable, or of another size.
    """
    return reconstruction.read_depth_map(as_path(folder, "folder"))


def read_capture(folder: AnyPath, rig: Rig | None = None, reporter: Reporter | None = None) -> FolderSource:
    """Return the frame sets of a capture folder, read one at a time while they are iterated over.

    >>> for frame in bs.read_capture(demo / "belt_loaded", rig):
    ...     print(frame)
    FrameSet(000: cam0, cam1, cam2, cam3, cam4)

    With a ``rig``, its cameras are read and images of another size are left out; without one, all cameras of the
    folder are read, and images of another size than a camera's first are left out. Every image that is left out is
    reported.

    Raises
    ------
    InputError
        if the folder has no images, or those of the core camera have another size than the rig's.
    """
    require_reporter(reporter)
    capture = list_capture(as_path(folder, "folder"))
    if rig is None:
        first = {name: files[min(files)] for name, files in capture.files.items()}
        sizes_px = {name: _read_size_px(first[name]) for name in capture.cameras}
    else:
        require_instance(rig, Rig, "rig", "bs.read_rig(path)")
        sizes_px = {name: camera.size_px for name, camera in rig.cameras.items()}
        _require_size(capture, rig)
    return FolderSource(capture, sizes_px, reporter or Silent())


def _require_size(capture: Capture, rig: Rig) -> None:
    """Raise InputError if the core camera's first image has another size than the rig's core camera."""
    files = capture.files.get(rig.core)
    if not files:
        raise InputError(
            f"{capture.folder}: no images of the core camera {rig.core}; there are {', '.join(capture.cameras)}"
        )
    path = files[min(files)]
    (width, height), own = _read_size_px(path), rig.core_camera.size_px
    if (width, height) != own:
        raise InputError(
            f"{path}: {width}×{height} px, but the rig's {rig.core} has {own[0]}×{own[1]}; scale the rig to the "
            f"images: bs.scale_rig(rig, {width / own[0]:g})"
        )


def _read_size_px(path: AnyPath) -> tuple[int, int]:
    height, width = read_image(as_path(path)).shape[:2]
    return width, height


def write_ply(cloud: PointCloud, path: AnyPath) -> None:
    """Write a point cloud as a binary PLY file in mm, with normals, colours and σ.

    >>> bs.write_ply(cloud, "cloud.ply")

    Raises
    ------
    InputError
        if the file's name ends as another format's does; `write_cloud` writes that.
    """
    require_instance(cloud, PointCloud, "cloud", "bs.point_cloud(depth, rig)")
    if clouds.find_ending(as_path(path, "path").name) not in (None, ".ply"):
        raise InputError(f"{path}: write_ply writes PLY only; use bs.write_cloud(cloud, path)")
    write_ply_file(as_path(path, "path"), cloud)


def write_cloud(cloud: PointCloud, path: AnyPath) -> None:
    """Write a point cloud as PLY (mm), LAS or LAZ (m), by the file's ending.

    >>> bs.write_cloud(cloud, "cloud.ply")

    LAS and LAZ need ``pip install 'beltscape[export]'``. They hold σ (mm), confidence and normals as extra
    dimensions, and the frame as a local coordinate system.

    Raises
    ------
    InputError
        if no format has that ending, or the library is not installed.
    """
    require_instance(cloud, PointCloud, "cloud", "bs.point_cloud(depth, rig)")
    clouds.write_cloud(as_path(path, "path"), cloud)
