"""Comparison of run.sh's results with the simulator's truth: ``compare.py FOLDER``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from beltscape.core.geometry.pose import Pose
from beltscape.evaluate.depth_scores import score_rig_against_truth
from beltscape.files.json_text import read_json
from beltscape.files.reconstruction import read_frame
from beltscape.files.rig_json import read_rig
from beltscape.kernels import load


def pose(document: dict) -> Pose:
    """A pose as the JSON files have it."""
    return Pose(np.array(document["rotation"]), np.array(document["translation_mm"]))


def true_volume_mm3(out: Path, volume: dict) -> float:
    """The true load over the very box that was measured: a box of the belt frame as found, the truth in the world."""
    core_from_world = pose(read_json(out / "loaded/truth/station.json")["core_from_world"])
    belt_from_world = pose(volume["belt"]["belt_from_core"]) @ core_from_world
    with np.load(out / "loaded/truth/belt_loaded_load.npz") as truth:
        x, y, height = truth["x_mm"], truth["y_mm"], truth["height_mm"]
    cells = np.stack([*np.meshgrid(x, y), np.zeros_like(height)], axis=-1)
    at = belt_from_world.apply(cells.reshape(-1, 3)).reshape(cells.shape)
    (left, right), (first, last) = volume["across_mm"], volume["along_mm"]
    inside = (at[..., 0] >= left) & (at[..., 0] <= right) & (at[..., 1] >= first) & (at[..., 1] <= last)
    return float(height[inside].sum()) * (x[1] - x[0]) * (y[1] - y[0])


def depth_error_mm(out: Path) -> tuple[float, float, float]:
    """Median and 95th percentile of the depth's absolute error on the lit, loaded belt; share of it measured."""
    frame = read_frame(out / "depth_loaded/000")
    with np.load(out / "loaded/truth/belt_loaded_depth.npz") as truth:
        lit, true_mm = truth["lit"], truth["depth_mm"]
    # one grid is the found lens's, the other the true one's: nearest pixel
    lens = read_rig(out / "loaded/truth/rig.json").core_camera
    at = np.rint(frame.rig.core_camera.rays() * lens.focal_px + lens.center_px).astype(int)
    column, row = (np.clip(at[..., i], 0, true_mm.shape[1 - i] - 1) for i in (0, 1))
    error = np.abs(frame.depth.depth_mm - true_mm[row, column])[lit[row, column]]
    median, high = np.nanquantile(error, [0.5, 0.95])
    return float(median), float(high), float(np.isfinite(error).mean())


def main() -> None:
    """Print the comparison."""
    out = Path(sys.argv[1])
    found, true = read_rig(out / "rig/rig.json"), read_rig(out / "calibration/truth/rig.json")
    rig = score_rig_against_truth(found, true, load())
    print(f"rig     depth {rig.depth_rms_mm:.4f} mm RMS of triangulated points")
    print(
        f"        worst centre {max(rig.center_mm.values()):.4f} mm, rotation {max(rig.rotation_deg.values()):.5f}°"
    )
    median, high, measured = depth_error_mm(out)
    print(
        f"depth   error {median:.3f} mm median, {high:.3f} mm 95 %; {100 * measured:.1f} % of the lit measured"
    )
    volume = read_json(out / "volume/volume.json")
    litres, sigma = volume["volume_mm3"] / 1e6, volume["sigma_mm3"] / 1e6
    truth = true_volume_mm3(out, volume) / 1e6
    error = 100 * (litres / truth - 1)
    print(f"volume  {litres:.4f} l, σ {sigma:.4f} l; true {truth:.4f} l, error {error:+.2f} %")


if __name__ == "__main__":
    main()
