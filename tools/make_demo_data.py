"""Makes the demo capture from rendered captures with exact truth: half their size, grey, at most 10 MB.

    python tools/make_demo_data.py RENDERED_FOLDER

Area averaging of 2×2 pixels halves the intrinsics exactly: c' = (c + 0.5) / 2 - 0.5, f' = f / 2.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beltscape.core.frames import to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.images import read_image
from beltscape.files.json_text import write_json
from beltscape.files.rig_json import write_rig
from beltscape.files.tiff import write_float_tiff

OUT = Path(__file__).parents[1] / "src" / "beltscape" / "data" / "demo"
SCENES = ("belt_empty", "belt_loaded", "module")
CALIBRATION_FRAMES = [i for i in range(24) if i % 3 != 2]


def main(rendered: Path) -> None:
    """Write the demo's images, board and truth."""
    if OUT.exists():
        shutil.rmtree(OUT)
    truth = json.loads((rendered / "truth" / "rig.json").read_text())
    rig = true_rig(truth)
    for camera in rig.cameras:
        for frame in CALIBRATION_FRAMES:
            # a little compression costs the corners nothing: the noise is larger
            halve(rendered / "calibration" / camera / f"{frame:03d}.png", OUT / "calibration", ".jpg", camera)
        for scene in SCENES:
            halve(rendered / scene / camera / "000.png", OUT / scene, ".png", camera)
    shutil.copy(rendered / "board.toml", OUT / "board.toml")
    shutil.copy(rendered / "module.toml", OUT / "module.toml")
    write_rig(OUT / "truth" / "rig.json", rig)
    for scene in SCENES:
        depth = true_depth(np.load(rendered / "truth" / f"{scene}_depth_cam0.npz"))
        write_float_tiff(OUT / "truth" / f"{scene}_depth.tiff", depth, compressed=True)
    write_volumes(rendered / "truth", truth)


def halve(source: Path, folder: Path, extension: str, camera: str) -> None:
    """One image, averaged 2×2, grey."""
    image = to_grey(read_image(source))
    small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    target = folder / camera / (source.stem + extension)
    target.parent.mkdir(parents=True, exist_ok=True)
    options = [cv2.IMWRITE_JPEG_QUALITY, 92] if extension == ".jpg" else [cv2.IMWRITE_PNG_COMPRESSION, 9]
    cv2.imwrite(str(target), np.rint(small).astype(np.uint8), options)


def true_rig(truth: dict) -> Rig:
    """The true rig for the halved images, in the form of rig.json."""
    cameras, poses = {}, {}
    for name, entry in truth["cameras"].items():
        matrix = np.array(entry["K_quarter"])
        width, height = (size // 2 for size in truth["image_size"])
        focal, center = np.diag(matrix)[:2].copy(), matrix[:2, 2].copy()
        cameras[name] = Camera(name, (width, height), focal, center, np.array(entry["dist"]))
        poses[name] = Pose.of(entry["R_rel"], entry["t_rel"])
    poses["cam0"] = Pose.identity()
    return Rig("cam0", cameras, poses)


def true_depth(arrays: Any) -> np.ndarray:
    """Depth on the halved pinhole grid: the mean of 2×2 inverse depths; NaN where they lie on two surfaces."""
    depth = arrays["z_pinhole"].astype(np.float64)
    depth[arrays["label_pinhole"] == 0] = np.nan
    blocks = depth.reshape(depth.shape[0] // 2, 2, depth.shape[1] // 2, 2)
    with np.errstate(invalid="ignore"):
        mean = 1 / (1 / blocks).mean(axis=(1, 3))
        mean[np.ptp(blocks, axis=(1, 3)) > 4.0] = np.nan
    return np.round(mean * 128) / 128  # 8 µm steps compress well


def write_volumes(truth_folder: Path, truth: dict) -> None:
    """True heights over the empty belt as volume per mm of belt, and the belt frame they are to be met in."""
    core = truth["cameras"]["cam0"]
    core_from_world = Pose.of(core["R"], core["t"])
    axis_mm = core_from_world.inverse().rotation @ [0.0, 0.0, 1.0]
    center = core_from_world.center_mm
    origin = center - axis_mm * center[2] / axis_mm[2]  # where the optical axis meets the belt's flat centre
    world_from_belt = Pose(np.eye(3), origin)
    section = np.array(json.loads((truth_folder / "belt.json").read_text())["cross_section"])
    volumes = {
        scene: areas(np.load(truth_folder / f"{scene}_heightfield_world.npz"), section)
        for scene in ("belt_loaded", "module")
    }
    belt_from_core = (core_from_world @ world_from_belt).inverse()
    write_json(
        OUT / "truth" / "volume.json",
        {
            "definition": "area_mm2[k]: cross-section of the load over the empty belt, whole width, "
            "averaged over 1 mm of belt from y_mm = first_y_mm + k on, in the belt frame",
            "belt_from_core": {
                "rotation": belt_from_core.rotation,
                "translation_mm": belt_from_core.translation_mm,
            },
            "scenes": {
                scene: {"first_y_mm": float(y[0] - origin[1]), "area_mm2": np.round(area, 2)}
                for scene, (y, area) in volumes.items()
            },
        },
    )


def areas(field: Any, section: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower edges y (mm, world) of 1 mm slices of belt, and the load's cross-section in each, mm²."""
    step = float(field["step"])
    x = field["x0"] + step * np.arange(field["z"].shape[1])
    y = field["y0"] + step * np.arange(field["z"].shape[0]) - step / 2
    load = np.maximum(field["z"] - np.interp(x, *section.T), 0)
    return y, load.sum(axis=1) * step


if __name__ == "__main__":
    main(Path(sys.argv[1]))
