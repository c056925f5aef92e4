"""Readers of three real stereo pairs with references, used in tests and benchmarks of the matchers.

``dice_gt4_speckle``, ``dice_stereo_auto``
    Examples of DICe (Sandia, https://github.com/dicengine/dice, tests/regression/stereo_d_spec and stereo_auto):
    painted speckle, calibrated with VIC-3D.
``middlebury_motorcycle``
    Middlebury 2014 (Scharstein et al., GCPR 2014), in scikit-image's quarter size of 741×500.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.exchange import import_rig
from beltscape.files.images import read_image
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.pairwise.reconstructor import reconstruct_pairwise
from beltscape.stereo.settings import MultiviewSettings, PairwiseSettings
from stereo_pairs.disparity_pair import DisparityPair
from stereo_pairs.speckle_pair import SpecklePair
from stereo_pairs.subsets import find_subsets, fit_auxiliary_pose

Reconstruct = Callable[[Rig, FrameSet, tuple[float, float]], DepthMap]
"""A method under test: rig, frame set and (near, far) in mm → depth map of the core."""


def run_pairwise(rig: Rig, frame_set: FrameSet, depth_range_mm: tuple[float, float]) -> DepthMap:
    """Reconstruct by the paper's method, which is binocular with one auxiliary."""
    return reconstruct_pairwise(rig, frame_set, PairwiseSettings(), Silent(), depth_range_mm=depth_range_mm)


def run_multiview(rig: Rig, frame_set: FrameSet, depth_range_mm: tuple[float, float]) -> DepthMap:
    """Reconstruct by the multi-view matcher with its standard preset and one auxiliary."""
    return MultiviewReconstructor(rig, depth_range_mm, MultiviewSettings()).reconstruct(frame_set, Silent())


METHODS: Mapping[str, Reconstruct] = {"pairwise": run_pairwise, "multiview": run_multiview}
"""Methods that the tests and the benchmark run."""

_SUBSET_PX = 27
"""Edge of a subset, as in DICe's example."""
_STEP_PX = 35
"""Distance of the subsets' centres, as in DICe's example."""
_BORDER_PX = 20
"""Distance of the outermost subsets' centres from the image's border: half a subset and some search."""
_CORRELATED = 0.95
"""Least correlation of a located subset; false ones stay far below."""
_OFF_LINE_PX = 0.5
"""Largest distance from the epipolar line: false matches are pixels off, true ones hundredths."""
_CONTRAST = 15.0
"""Least standard deviation of the grey levels of each quarter of a subset; the specimens' speckle has more."""


def read_dice_gt4(folder: Path) -> SpecklePair:
    """Read a flat specimen, 1920×1200 px, with DICe's correspondences of step 0 (25 px subsets every 100 px).

    DICe matches the left images over time from GT4-0000, and left to right in that image only.
    """
    table = _dice_table(folder / "DICe_solution_0.txt")
    rig, _ = import_rig(folder / "cal.xml", Silent(), kind="vic3d")
    core = np.column_stack([table["COORDINATE_X"], table["COORDINATE_Y"]])
    moved = np.column_stack([table["CROSS_CORR_Q"], table["CROSS_CORR_R"]])
    frames = _frame_set(folder, "GT4-0000")
    return SpecklePair("dice_gt4_speckle", rig, frames, (360.0, 400.0), core, core + moved)


def read_dice_auto(folder: Path) -> SpecklePair:
    """Read three nearly coplanar specimens with gaps between them, 1280×800 px; 27 px subsets every 35 px.

    The folder's own reference is unsuitable: its CROSS_CORR is the projective map of a plane, to 0.0005 px, and 0.3
    to 0.8 px off the correlation peak; its cal.xml is of another set-up, with epipolar errors of 23 px. Therefore
    the subsets are located here, starting from that map, and the rig's pose is fitted to them: depth in mm is
    nominal, and epipolar errors are residuals of that fit.
    """
    plane, _ = read_dice_auto_plane(folder)
    rig, _ = import_rig(folder / "cal.xml", Silent(), kind="vic3d")
    frames = _frame_set(folder, "img_0000")
    core, auxiliary = (frames.images[name] for name in rig.cameras)
    points = _grid(core)
    start = np.column_stack([points, np.ones(len(points))]) @ plane.T
    found, score = find_subsets(
        core, auxiliary, points, start[:, :2] / start[:, 2:], subset_px=_SUBSET_PX, reach_px=(70, 17)
    )
    good = score > _CORRELATED
    points, found = points[good], found[good]
    rig = fit_auxiliary_pose(rig, points, found)
    pair = SpecklePair("dice_stereo_auto", rig, frames, (1000.0, 1200.0), points, found)
    true = np.abs(pair.epipolar_px()) < _OFF_LINE_PX
    return SpecklePair(pair.name, rig, frames, pair.depth_range_mm, points[true], found[true])


def read_dice_auto_plane(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return DICe's homography (3, 3) from left to right pixels, and its table (N, 4): u, v left and their shift."""
    table = _dice_table(folder / "DICe_solution_auto_0.txt")
    text = (folder / "projection_out.dat").read_text(encoding="utf-8")
    numbers = text.split("after simplex optimization:")[-1].split()[:8]
    columns = ("COORDINATE_X", "COORDINATE_Y", "CROSS_CORR_Q", "CROSS_CORR_R")
    plane = np.array([*map(float, numbers), 1.0]).reshape(3, 3)
    return plane, np.column_stack([table[name] for name in columns])


def read_motorcycle(folder: Path) -> DisparityPair:
    """Read a room with a motorcycle, 741×500 px, with dense true disparity.

    The calibration is the scene's own (f = 3979.911, cx = 1244.772, cy = 1019.507, doffs = 124.343 px, baseline
    193.001 mm at 2964×2000), a quarter of it in px.
    """
    size, focal = (741, 500), np.full(2, 994.978)
    cameras = {
        "left": Camera("left", size, focal, np.array([311.193, 254.877]), np.zeros(5)),
        "right": Camera("right", size, focal, np.array([342.279, 254.877]), np.zeros(5)),
    }
    poses = {"left": Pose.identity(), "right": Pose(np.eye(3), np.array([-193.001, 0.0, 0.0]))}
    images = {name: read_image(folder / f"motorcycle_{name}.png") for name in cameras}
    with np.load(folder / "motorcycle_disp.npz") as arrays:
        disparity = arrays["arr_0"].astype(np.float64)
    disparity[~np.isfinite(disparity)] = np.nan
    return DisparityPair(
        "middlebury_motorcycle", Rig("left", cameras, poses), FrameSet("motorcycle", images),
        (2000.0, 5400.0), disparity,
    )  # fmt: skip


def _frame_set(folder: Path, frame: str) -> FrameSet:
    return FrameSet(frame, {f"cam{i}": read_image(folder / f"{frame}_{i}.tif") for i in range(2)})


def _grid(image: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return the whole pixels (N, 2) u, v of subsets with texture in each quarter, which excludes single edges."""
    height, width = image.shape
    half = _SUBSET_PX // 2
    points: list[tuple[int, int]] = []
    for v in range(_BORDER_PX, height - _BORDER_PX, _STEP_PX):
        for u in range(_BORDER_PX, width - _BORDER_PX, _STEP_PX):
            quarters = [
                image[top : top + half + 1, left : left + half + 1]
                for top in (v - half, v)
                for left in (u - half, u)
            ]
            if min(quarter.std() for quarter in quarters) > _CONTRAST:
                points.append((u, v))
    return np.array(points, dtype=np.float64)


def _dice_table(path: Path) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a DICe solution by name, without failed subsets."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    head = next((line for line in lines if "COORDINATE_X," in line), None)
    if head is None:
        raise InputError(f"{path}: has no row of column names; give a solution of DICe")
    try:
        rows = [[float(text) for text in line.split(",")] for line in lines if re.match(r"[-\d]", line)]
        columns = dict(zip(head.split(","), np.array(rows).T, strict=True))
    except ValueError as error:
        raise InputError(
            f"{path}: a row has another form than the column names; give a solution of DICe"
        ) from error
    return {name: column[columns["MATCH"] == 0] for name, column in columns.items()}
