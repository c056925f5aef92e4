"""Rendered captures with exact truth, which lie beside the repository and are absent in most checkouts."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.images import read_image

RENDERED = Path(__file__).resolve().parents[3] / "shared/data/rendered"
needs_rendered = pytest.mark.skipif(
    not RENDERED.is_dir(), reason="optional data: ../shared/data/rendered is not beside the repository"
)


def read_halved_rig() -> Rig:
    """Return the true rig at 612×512 (K_quarter)."""
    truth = json.loads((RENDERED / "truth/rig.json").read_text())
    cameras, poses = {}, {}
    for name, entry in truth["cameras"].items():
        K = np.array(entry["K_quarter"])
        cameras[name] = Camera(
            name, (612, 512), np.diag(K)[:2].copy(), K[:2, 2].copy(), np.array(entry["dist"])
        )
        poses[name] = Pose.of(entry["R_rel"], entry["t_rel"]) if name != "cam0" else Pose.identity()
    return Rig("cam0", cameras, poses)


def read_halved_frames(scene: str) -> FrameSet:
    """Return frame 000 of a 1224×1024 scene at 612×512."""
    images = {f"cam{i}": read_image(RENDERED / scene / f"cam{i}/000.png") for i in range(5)}
    return FrameSet(
        "000",
        {name: cv2.resize(image, (612, 512), interpolation=cv2.INTER_AREA) for name, image in images.items()},
    )


def read_halved_truth(scene: str) -> tuple[np.ndarray, np.ndarray]:
    """Return (512, 612) depth on the pinhole grid, mm, NaN beyond |Y| = 240 mm, and the labels."""
    truth = np.load(RENDERED / f"truth/{scene}_depth_cam0.npz")
    z, label = truth["z_pinhole"].astype(float), truth["label_pinhole"][::2, ::2]
    four = np.stack([z[::2, ::2], z[1::2, ::2], z[::2, 1::2], z[1::2, 1::2]])
    depth = np.where(np.ptp(four, axis=0) < 3, four.mean(axis=0), four[0])
    camera = json.loads((RENDERED / "truth/rig.json").read_text())["cameras"]["cam0"]
    points = np.concatenate(
        [read_halved_rig().core_camera.rays() * depth[..., None], depth[..., None]], axis=-1
    )
    world = (points - np.array(camera["t"])) @ np.array(camera["R"])
    return np.where((np.abs(world[..., 1]) <= 240) & (depth > 0), depth, np.nan), label
