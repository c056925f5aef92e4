"""The truth of a simulated scene, read from its files: depth, labels and occluded pixels.

It is resampled to the grid of another core camera for depth measured with a calibrated rig; the empty belt of a
simulated plant is found in its true depth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_mapping
from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError, describe_cause
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.arrays import DAMAGED
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.files.tiff import read_float_tiff
from beltscape.kernels import Kernels, load_on_processor
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.simulate.core_truth import trace_core_view
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.stereo.multiview.surface import (
    compute_inverse_depth_scale,
    compute_visibility,
    pack_projections,
)


def occluded_mask(rig: Rig, true_depth_mm: NDArray[np.floating], kernels: Kernels) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels with a true depth that are occluded in every auxiliary.

    The true depth (H, W; mm, NaN: none) is projected into each auxiliary. Surfaces outside the core's view do not
    occlude here, so a few occluded pixels count as visible.
    """
    names = rig.auxiliaries
    unit = compute_inverse_depth_scale(rig, names)
    s = (1 / (np.asarray(true_depth_mm, np.float64) * unit)).astype(np.float32)
    sizes = [rig.cameras[name].size_px for name in names]
    visible, _ = compute_visibility(s, pack_projections(rig, names, unit, 1), sizes, kernels)
    return np.isfinite(s) & (visible == 0)


_STEP = 0.006
"""Relative depth range within 2 × 2 pixels above which there is a step, and no interpolation: 4 mm at 0.7 m."""


def resample_depth(rig: Rig, truth: Rig, true_mm: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the true depth on the grid of a calibrated core camera, mm; NaN outside the truth.

    ``true_mm`` is (H, W) on the true core's undistorted grid, both cores being the same camera. Inverse depth,
    which is linear on a plane, is interpolated bilinearly; at steps the nearest pixel is taken.
    """
    u, v = _true_pixels(rig, truth)
    height, width = true_mm.shape
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    left, top = (np.floor(x).astype(np.intp).clip(0, n - 2) for x, n in ((u, width), (v, height)))
    corners = np.stack([true_mm[top + j, left + i] for j in (0, 1) for i in (0, 1)]).astype(np.float64)
    a, b = u - left, v - top
    weights = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    nearest = np.take_along_axis(corners, weights.argmax(axis=0)[None], axis=0)[0]
    smooth = np.asarray(np.ptp(corners, axis=0) < _STEP * nearest, bool)  # false with a NaN, too
    mixed: NDArray[np.float64] = 1 / (weights / corners).sum(axis=0)
    return np.where(inside, np.where(smooth, mixed, nearest), np.nan)


def resample_mask(rig: Rig, truth: Rig, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask on the true core's grid resampled to a calibrated core's, (H, W); False outside."""
    u, v = (np.rint(x).astype(np.intp) for x in _true_pixels(rig, truth))
    height, width = mask.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return inside & mask[v.clip(0, height - 1), u.clip(0, width - 1)]


def _true_pixels(rig: Rig, truth: Rig) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    camera = truth.core_camera
    u, v = np.moveaxis(rig.core_camera.rays() * camera.focal_px + camera.center_px, -1, 0)
    return u, v


WITHIN_MM = 240.0
"""Half length of the evaluated region along the belt; the projector illuminates little more."""
REGIONS: Mapping[str, tuple[int, ...]] = {
    "belt": (1,),
    "material": (2,),
    "module": tuple(range(10, 256)),
}
"""Region → labels of the truth's files."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A frame's truth on the grid of a core camera, H × W pixels."""

    rig: Rig
    """The core camera is the grid's."""
    core_from_world: Pose | None
    """None: the belt's direction is not known, and every pixel with a depth is compared."""
    depth_mm: NDArray[np.float64]
    """(H, W) along the optical axis; NaN: none."""
    label: NDArray[np.uint8]
    """(H, W) label of the surface that the pixel shows, as in the truth's files."""
    occluded: NDArray[np.bool_]
    """(H, W) whether the pixel's surface is occluded in every auxiliary."""

    def resample_to(self, rig: Rig) -> Truth:
        """Return the truth on the grid of another rig whose core camera has the same pose."""
        labels = np.zeros(rig.core_camera.size_px[::-1], np.uint8)
        for value in np.unique(self.label):
            labels[resample_mask(rig, self.rig, self.label == value)] = value
        return replace(
            self,
            rig=rig,
            depth_mm=resample_depth(rig, self.rig, self.depth_mm),
            label=labels,
            occluded=resample_mask(rig, self.rig, self.occluded),
        )

    @property
    def is_placed(self) -> bool:
        """Return whether its rig is a calibrated one, to whose grid and from which depths can be resampled."""
        return self.rig.core != _UNKNOWN

    def near_mask(self, reach_mm: float = WITHIN_MM) -> NDArray[np.bool_]:
        """Return the mask (H, W) of pixels within ``reach_mm`` of the rig along the belt."""
        if self.core_from_world is None:
            return np.isfinite(self.depth_mm)
        depth = self.depth_mm[..., None]
        points = np.concatenate([self.rig.core_camera.rays() * depth, depth], axis=-1)
        with np.errstate(invalid="ignore"):
            return np.abs(self.core_from_world.inverse().apply(points)[..., 1]) <= reach_mm

    def region_masks(self, reach_mm: float = WITHIN_MM) -> Mapping[str, NDArray[np.bool_]]:
        """Return the mask (H, W) of every region of the scene, and of "all" of them together."""
        near = self.near_mask(reach_mm)
        masks = {name: np.isin(self.label, labels) & near for name, labels in REGIONS.items()}
        masks = {name: region for name, region in masks.items() if region.any()}
        everything = near if self.core_from_world is None else np.zeros_like(near)
        return {**masks, "all": np.any([*masks.values()], axis=0) if masks else everything}


@dataclass(frozen=True, slots=True, eq=False)
class TruthFile:
    """Truth of a capture's frames: one that is valid for all frames, or one per frame."""

    path: Path
    truths: tuple[Truth, ...]

    def for_frame(self, frame: str) -> Truth:
        """Return the truth of a frame; if there are several, the frame's name is its number from 0.

        Raises
        ------
        InputError
            When there is no truth of such a frame.
        """
        if len(self.truths) == 1:
            return self.truths[0]
        if not frame.isdecimal() or int(frame) >= len(self.truths):
            raise InputError(
                f"{self.path}: no truth of frame {frame}; it has 000 to {len(self.truths) - 1:03d}"
            )
        return self.truths[int(frame)]


def read_truth(path: Path, scene: str | None = None) -> TruthFile:
    """Read the truth written by ``beltscape simulate``, or in the layout by camera (``*_depth_cam0.npz``).

    Parameters
    ----------
    path
        The truth's folder, or the npz file of depths in it, with rig.json beside it; or a float32 TIFF of depths.
    scene
        Name of the scene, for a folder with several.

    Raises
    ------
    InputError
        When a file is missing or incomplete.
    """
    file = _depth_file(path, scene)
    if file.suffix.lower() in (".tif", ".tiff"):
        return TruthFile(file, (_read_bare(file),))
    try:
        with file.open("rb") as stream, np.load(stream) as arrays:
            own = {name: arrays[name] for name in _WANTED if name in arrays.files}
    except DAMAGED as error:
        raise InputError(f"{file}: not a truth's npz file; give truth/<scene>_depth.npz") from error
    depth = own.get("depth_mm", own.get("z_pinhole"))
    label = own.get("label", own.get("label_pinhole"))
    if depth is None or label is None:
        raise InputError(f"{file}: no depth_mm and label in it; give truth/<scene>_depth.npz")
    rig, pose = _rig(file.parent)
    if depth.shape[-2:] != rig.core_camera.size_px[::-1]:
        raise InputError(
            f"{file}: {depth.shape[-1]}×{depth.shape[-2]} px, but rig.json's core has "
            f"{rig.core_camera.size_px[0]}×{rig.core_camera.size_px[1]}; give the truth of one capture"
        )
    depths, labels = (np.atleast_3d(a.T).T if a.ndim == 2 else a for a in (depth, label))
    views = own.get("views")
    return TruthFile(
        file,
        tuple(
            _truth(rig, pose, z.astype(np.float64), what.astype(np.uint8), views)
            for z, what in zip(depths, labels, strict=True)
        ),
    )


def _read_bare(file: Path) -> Truth:
    """Return the truth of a TIFF of depths, with the rig.json beside it or, without one, on a grid of its own."""
    depth = read_float_tiff(file).astype(np.float64)
    label = np.zeros(depth.shape, np.uint8)
    if (file.parent / "rig.json").is_file():
        rig = read_rig(file.parent / "rig.json")
        if depth.shape != rig.core_camera.size_px[::-1]:
            width, height = rig.core_camera.size_px
            raise InputError(
                f"{file}: {depth.shape[1]}×{depth.shape[0]} px, but the core of the rig.json beside it has "
                f"{width}×{height}; give the truth of one rig"
            )
        return Truth(rig, None, depth, label, occluded_mask(rig, depth, load_on_processor()))
    height, width = depth.shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    camera = Camera(_UNKNOWN, (width, height), np.full(2, float(width)), middle, np.zeros(5))
    rig = Rig(_UNKNOWN, {_UNKNOWN: camera}, {_UNKNOWN: Pose.identity()})
    return Truth(rig, None, depth, label, np.zeros(depth.shape, bool))


_UNKNOWN = "unknown"
"""Name of the core camera of a truth without a rig: only depths on the same grid are compared with it."""
_WANTED = ("depth_mm", "label", "views", "z_pinhole", "label_pinhole")


def _truth(
    rig: Rig,
    pose: Pose,
    depth: NDArray[np.float64],
    label: NDArray[np.uint8],
    views: NDArray[np.uint8] | None,
) -> Truth:
    occluded = (
        occluded_mask(rig, depth, load_on_processor()) if views is None else np.isfinite(depth) & (views == 0)
    )
    return Truth(rig, pose, depth, label, occluded)


def _depth_file(path: Path, scene: str | None) -> Path:
    if path.is_file():
        return path
    if not path.is_dir():
        raise InputError(f"{path}: no such truth; give the folder truth/ of a simulated capture")
    names = (
        (f"{scene}_depth.npz", f"{scene}_depth_cam0.npz") if scene else ("*_depth.npz", "*_depth_cam0.npz")
    )
    found = sorted(file for name in names for file in path.glob(name))
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(
            f"{path}: no {' or '.join(names)} in it; give the folder truth/ of a simulated capture"
        )
    raise InputError(f"{path}: {len(found)} scenes in it; give one of {', '.join(f.name for f in found)}")


def _rig(folder: Path) -> tuple[Rig, Pose]:
    document = read_json(folder / "rig.json")
    if is_mapping(document) and "image_size" in document:
        return _rig_by_camera(folder / "rig.json", document)
    return read_rig(folder / "rig.json"), read_core_from_world(folder)


def read_core_from_world(folder: Path) -> Pose:
    """Return the pose of the world in the core's frame from a truth folder; InputError where it is not there."""
    station = read_json(folder / "station.json")
    try:
        entry = station["core_from_world"]
        return Pose.of(entry["rotation"], entry["translation_mm"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder / 'station.json'}: no core_from_world; simulate the scene again"
        ) from error


def _rig_by_camera(path: Path, document: Mapping[str, Any]) -> tuple[Rig, Pose]:
    """Parse rig.json of other renderers: K, dist, R, t (world → camera), R_rel, t_rel (core → camera)."""
    cameras: dict[str, Camera] = {}
    poses: dict[str, Pose] = {}
    try:
        size = (int(document["image_size"][0]), int(document["image_size"][1]))
        for name, entry in document["cameras"].items():
            matrix = np.array(entry["K"], np.float64)
            focal, center = np.diag(matrix)[:2].copy(), matrix[:2, 2].copy()
            cameras[name] = Camera(name, size, focal, center, np.array(entry["dist"], np.float64))
            poses[name] = Pose.of(entry["R_rel"], entry["t_rel"])
        core = next(iter(cameras))
        world = document["cameras"][core]
        return Rig(core, cameras, poses), Pose.of(world["R"], world["t"])
    except (KeyError, TypeError, IndexError, StopIteration, ValueError, AttributeError) as error:
        raise InputError(f"{path}: not a truth's rig.json ({describe_cause(error)})") from error


_TRUE_SIGMA_MM = 0.02
"""σ of the empty belt's true depth: that of a measured empty belt, so that it adds nothing of its own."""


def find_true_belt(scene: SimulatedScene) -> Belt:
    """Return the empty belt of a scene's plant, whatever lies on it in the scene."""
    plant = SimulatedScene(scene.scenario.model_copy(update={"kind": "belt_empty"}))
    depth = trace_core_view(plant.world_at(0), plant.station).depth_mm
    seen = np.isfinite(depth)
    sigma = np.where(seen, _TRUE_SIGMA_MM, np.nan).astype(np.float32)
    empty = DepthMap(depth.astype(np.float32), sigma, seen.astype(np.uint8), seen.astype(np.float32))
    return find_belt(empty, plant.station.rig.core_camera)
