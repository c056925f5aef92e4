"""Scenes with exact truth for the benchmarks."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import beltscape
from beltscape.core.camera import Camera
from beltscape.core.frames import FrameSet
from beltscape.core.pose import Pose
from beltscape.core.rig import Rig
from beltscape.files.depth_tiff import read_float_tiff
from beltscape.files.images import read_image
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.stereo.search import scaled_rig

REGION_MM = 240.0
VOLUME_MM = 200.0
LABELS = {"belt_empty": (1,), "module": tuple(range(10, 19)), "belt_loaded": (2,)}


@dataclass(frozen=True)
class Scene:
    """One frame of a rig and what is known about it."""

    name: str
    rig: Rig
    frame: FrameSet
    true_depth_mm: np.ndarray
    region: np.ndarray
    true_volume_mm3: float | None
    along_mm: tuple[float, float]

    @property
    def size(self) -> str:
        """Image size in words."""
        return "{}×{}".format(*self.rig.core_camera.size_px)


def rendered_scenes(folder: Path) -> list[Scene]:
    """The rendered captures at their own size, and halved."""
    return [_rendered(folder, name, halvings) for halvings in (1, 0) for name in LABELS]


def _rendered(folder: Path, name: str, halvings: int) -> Scene:
    truth = json.loads((folder / "truth" / "rig.json").read_text())
    rig = scaled_rig(true_rig(truth), halvings)
    arrays = np.load(folder / "truth" / f"{name}_depth_cam0.npz")
    step = 2**halvings
    depth, labels = arrays["z_pinhole"].astype(np.float64), arrays["label_pinhole"]
    if halvings:  # a halved pixel lies between four: their mean, where they are one surface
        blocks = depth.reshape(depth.shape[0] // step, step, depth.shape[1] // step, step)
        depth = np.where(np.ptp(blocks, axis=(1, 3)) < 4, 1 / (1 / blocks).mean(axis=(1, 3)), np.nan)
        labels = labels[::step, ::step]
    core = truth["cameras"]["cam0"]
    world_from_core = Pose.of(core["R"], core["t"]).inverse()
    rays = rig.core_camera.rays()
    points = world_from_core.apply(np.concatenate([rays * depth[..., None], depth[..., None]], axis=-1))
    axis = world_from_core.rotation @ [0, 0, 1]
    center = world_from_core.translation_mm
    origin_y = float((center - axis * center[2] / axis[2])[1])
    images = {c: _halved(read_image(folder / name / c / "000.png"), halvings) for c in rig.cameras}
    volume = folder / "truth" / f"{name}_volume.json"
    return Scene(
        name, rig, FrameSet("000", images), depth,
        np.isin(labels, LABELS[name]) & (np.abs(points[..., 1]) <= REGION_MM),
        json.loads(volume.read_text())["volume_mm3"] if volume.is_file() else None,
        (-VOLUME_MM - origin_y, VOLUME_MM - origin_y),
    )  # fmt: skip


def true_rig(truth: dict) -> Rig:
    cameras, poses = {}, {}
    for name, entry in truth["cameras"].items():
        matrix = np.array(entry["K"])
        size = (truth["image_size"][0], truth["image_size"][1])
        cameras[name] = Camera(
            name, size, np.diag(matrix)[:2].copy(), matrix[:2, 2].copy(), np.array(entry["dist"])
        )
        poses[name] = Pose.of(entry["R_rel"], entry["t_rel"])
    return Rig("cam0", cameras, poses)


def _halved(image: np.ndarray, halvings: int) -> np.ndarray:
    factor = 0.5**halvings
    return (
        image if not halvings else cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    )


def demo_scenes() -> list[Scene]:
    """The capture that ships with the demo."""
    data = Path(beltscape.__file__).parent / "data" / "demo"
    rig = read_rig(data / "truth" / "rig.json")
    volumes = read_json(data / "truth" / "volume.json")
    pose = volumes["belt_from_core"]
    belt_from_core = Pose.of(pose["rotation"], pose["translation_mm"])
    scenes = []
    for name in LABELS:
        depth = read_float_tiff(data / "truth" / f"{name}_depth.tiff").astype(np.float64)
        points = np.concatenate([rig.core_camera.rays() * depth[..., None], depth[..., None]], axis=-1)
        images = {c: read_image(data / name / c / "000.png") for c in rig.cameras}
        scenes.append(
            Scene(
                name, rig, FrameSet("000", images), depth,
                np.abs(belt_from_core.apply(points)[..., 1]) <= REGION_MM,
                _true_volume(volumes["scenes"].get(name)), (-VOLUME_MM, VOLUME_MM),
            )
        )  # fmt: skip
    return scenes


def _true_volume(entry: dict | None) -> float | None:
    if entry is None:
        return None
    edges = entry["first_y_mm"] + np.arange(len(entry["area_mm2"]) + 1)
    low, high = np.interp([-VOLUME_MM, VOLUME_MM], edges, np.concatenate([[0], np.cumsum(entry["area_mm2"])]))
    return float(high - low)
