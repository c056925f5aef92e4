"""Scenes with exact ground truth for the benchmarks: the rendered captures, the demo, and a full-size capture."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

import beltscape
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.evaluate.truth import occluded_mask, resample_depth, resample_mask
from beltscape.files.images import read_image
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.files.tiff import read_float_tiff
from beltscape.kernels import load

REGION_MM = 240.0
VOLUME_MM = 200.0
LABELS = {"belt_empty": (1,), "module": tuple(range(10, 19)), "belt_loaded": (2,)}
FULL = "BELTSCAPE_BENCH_FULL"
"""Environment variable that enables the capture at the sensor's full size."""


@dataclass(frozen=True)
class Scene:
    """One frame of a rig with its truth."""

    name: str
    rig: Rig
    frame: FrameSet
    true_depth_mm: np.ndarray
    region: np.ndarray
    """(H, W) bool: the scene's main surface, where the projector illuminates it."""
    occluded: np.ndarray
    """(H, W) bool: pixels of any illuminated surface that are occluded in every auxiliary."""
    true_volume_mm3: float | None = None
    along_mm: tuple[float, float] = (-VOLUME_MM, VOLUME_MM)

    @property
    def size(self) -> str:
        """Image size as text."""
        return "{}×{}".format(*self.rig.core_camera.size_px)

    def with_rig(self, rig: Rig) -> Scene:
        """Return the frame with a calibrated rig, and the truth on that rig's core grid."""
        halvings = round(np.log2(rig.core_camera.size_px[0] / self.rig.core_camera.size_px[0]))
        calibrated = scale_rig(rig, 0.5**halvings)
        return replace(
            self,
            rig=calibrated,
            true_depth_mm=resample_depth(calibrated, self.rig, self.true_depth_mm),
            region=resample_mask(calibrated, self.rig, self.region),
            occluded=resample_mask(calibrated, self.rig, self.occluded),
        )


def rendered_scenes(folder: Path) -> list[Scene]:
    """Return the rendered captures at full and half size."""
    return [read_rendered(folder, name, halvings) for halvings in (1, 0) for name in LABELS]


def read_rendered(folder: Path, name: str, halvings: int, capture: str | None = None) -> Scene:
    """Read a rendered scene; ``capture`` is another capture of the same scene, such as one without speckle."""
    truth = json.loads((folder / "truth" / "rig.json").read_text())
    whole = parse_true_rig(truth)
    rig = scale_rig(whole, 0.5**halvings)
    arrays = np.load(folder / "truth" / f"{name}_depth_cam0.npz")
    depth, labels = arrays["z_pinhole"].astype(np.float64), arrays["label_pinhole"]
    occluded = occluded_mask(whole, depth, load())
    if halvings:
        depth, labels, occluded = _halve_truth(depth, labels, occluded, 2**halvings)
    core = truth["cameras"]["cam0"]
    world_from_core = Pose.of(core["R"], core["t"]).inverse()
    lit = _lit_mask(rig, depth, world_from_core)
    axis = world_from_core.rotation @ [0, 0, 1]
    center = world_from_core.translation_mm
    origin_y = float((center - axis * center[2] / axis[2])[1])
    images = {
        c: _halve(read_image(folder / (capture or name) / c / "000.png"), halvings) for c in rig.cameras
    }
    volume = folder / "truth" / f"{name}_volume.json"
    return Scene(
        capture or name, rig, FrameSet("000", images), depth, np.isin(labels, LABELS[name]) & lit, occluded & lit,
        json.loads(volume.read_text())["volume_mm3"] if volume.is_file() else None,
        (-VOLUME_MM - origin_y, VOLUME_MM - origin_y),
    )  # fmt: skip


def _lit_mask(rig: Rig, depth_mm: np.ndarray, world_from_core: Pose) -> np.ndarray:
    points = np.concatenate([rig.core_camera.rays() * depth_mm[..., None], depth_mm[..., None]], axis=-1)
    return np.abs(world_from_core.apply(points)[..., 1]) <= REGION_MM


def _halve_truth(
    depth: np.ndarray, labels: np.ndarray, occluded: np.ndarray, step: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the truth at half size: means of blocks on one surface; occluded if the whole block is."""
    shape = (depth.shape[0] // step, step, depth.shape[1] // step, step)
    blocks = depth.reshape(shape)
    depth = np.where(np.ptp(blocks, axis=(1, 3)) < 4, 1 / (1 / blocks).mean(axis=(1, 3)), np.nan)
    return depth, labels[::step, ::step], np.asarray(occluded.reshape(shape).all(axis=(1, 3)))


def read_true_rig(rendered: Path) -> Rig:
    """Return the true rig of a folder of rendered captures."""
    return parse_true_rig(json.loads((rendered / "truth" / "rig.json").read_text("utf-8")))


def parse_true_rig(truth: dict) -> Rig:
    cameras, poses = {}, {}
    for name, entry in truth["cameras"].items():
        cameras[name] = parse_true_camera(name, entry, truth["image_size"])
        poses[name] = Pose.of(entry["R_rel"], entry["t_rel"])
    return Rig("cam0", cameras, poses)


def parse_true_camera(name: str, entry: dict, size_px: Sequence[int]) -> Camera:
    """Return a camera of the truth; one without ``dist`` has no distortion."""
    matrix, (width, height) = np.array(entry["K"]), size_px
    distortion = np.array(entry.get("dist", np.zeros(5)))
    return Camera(name, (width, height), np.diag(matrix)[:2].copy(), matrix[:2, 2].copy(), distortion)


def _halve(image: np.ndarray, halvings: int) -> np.ndarray:
    factor = 0.5**halvings
    return (
        image if not halvings else cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    )


def demo_scenes() -> list[Scene]:
    """Return the scenes of the capture that ships with the demo."""
    data = Path(beltscape.__file__).parent / "data" / "demo"
    rig = read_rig(data / "truth" / "rig.json")
    volumes = read_json(data / "truth" / "volume.json")
    pose = volumes["belt_from_core"]
    belt_from_core = Pose.of(pose["rotation"], pose["translation_mm"])
    scenes = []
    for name in LABELS:
        depth = read_float_tiff(data / "truth" / f"{name}_depth.tiff").astype(np.float64)
        lit = _lit_mask(rig, depth, belt_from_core)
        images = {c: read_image(data / name / c / "000.png") for c in rig.cameras}
        volume = _true_volume(volumes["scenes"].get(name))
        occluded = occluded_mask(rig, depth, load()) & lit
        scenes.append(Scene(name, rig, FrameSet("000", images), depth, lit, occluded, volume))
    return scenes


def _true_volume(entry: dict | None) -> float | None:
    if entry is None:
        return None
    edges = entry["first_y_mm"] + np.arange(len(entry["area_mm2"]) + 1)
    low, high = np.interp([-VOLUME_MM, VOLUME_MM], edges, np.concatenate([[0], np.cumsum(entry["area_mm2"])]))
    return float(high - low)


def full_size_scene(cache: Path) -> Scene | None:
    """Return a loaded belt at the sensor's full size, simulated once (minutes); None unless `FULL` is set."""
    if not os.environ.get(FULL):
        return None
    folder = cache / "belt_loaded_full_31"
    truth = folder / "truth"
    if not (truth / "belt_loaded_depth.npz").is_file():
        command = ["simulate", "belt_loaded", "--size", "full", "--seed", "31", "--out", str(folder)]
        subprocess.run([sys.executable, "-m", "beltscape", *command], check=True)
    rig = read_rig(truth / "rig.json")
    pose = read_json(truth / "station.json")["core_from_world"]
    with np.load(truth / "belt_loaded_depth.npz") as arrays:
        depth, label, views = arrays["depth_mm"].astype(np.float64), arrays["label"], arrays["views"]
    lit = _lit_mask(rig, depth, Pose.of(pose["rotation"], pose["translation_mm"]).inverse())
    images = {c: read_image(folder / c / "000.png") for c in rig.cameras}
    occluded = lit & (views == 0) & np.isfinite(depth)
    return Scene("belt_loaded", rig, FrameSet("000", images), depth, lit & (label == 2), occluded)
