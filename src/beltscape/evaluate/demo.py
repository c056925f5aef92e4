"""The demo: runs the whole chain on the shipped rendered capture and compares every result with the truth.

Its report shows pictures and figures of the whole chain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.result import Calibration
from beltscape.core.depth import DepthMap
from beltscape.core.frames import Image
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter, Silent
from beltscape.evaluate.depth_scores import DepthScore, RigScore, score_depth, score_rig_against_truth
from beltscape.evaluate.paper.pictures import ERROR_MM, SCENE_NAMES
from beltscape.evaluate.truth import WITHIN_MM
from beltscape.files.capture import DEMO_FOLDER
from beltscape.files.images import read_image
from beltscape.files.json_text import read_json
from beltscape.files.ply import read_cloud
from beltscape.files.reconstruction import read_frame
from beltscape.files.rig_json import read_rig
from beltscape.files.tiff import read_float_tiff
from beltscape.kernels import load_on_processor
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.volume import Volume
from beltscape.pipeline.calibrating.calibration import calibrate
from beltscape.pipeline.calibrating.calibration_files import write_calibration
from beltscape.pipeline.measuring.volume import measure_volume_of_frames, write_volume
from beltscape.pipeline.reconstructing.reconstruction import open_capture, reconstruct_capture
from beltscape.pipeline.reconstructing.rectification import rectify, rectify_capture
from beltscape.report.control_pictures import make_rectification_panels
from beltscape.report.drawing.depth_picture import make_depth_panel, make_error_panel, make_sigma_panel
from beltscape.report.drawing.legend import NEAR_TO_FAR, Scale
from beltscape.report.drawing.pictures import Panel, to_rgb
from beltscape.report.drawing.scene import Scene, make_rig_scene
from beltscape.report.measuring.volume import format_litres, make_height_chart, make_profiles_chart
from beltscape.report.page import InteractiveScene, Pictures, Section, Table, Tile, Tiles, render
from beltscape.stereo.pointcloud import undistort_image
from beltscape.target.board import read_board

DATA = DEMO_FOLDER
"""The shipped capture, with its truth."""
SCENES = ("belt_empty", "belt_loaded", "module")
METHODS = ("multiview", "pairwise", "binocular")
MAIN = METHODS[0]
"""The method whose depth is shown and measured."""
ALONG_MM = (-200.0, 200.0)
"""Stretch of belt whose volume is compared, in the true belt frame."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneResult:
    """A scene reconstructed by every method, with its scores."""

    folder: Path
    depth_map: DepthMap
    """Depth map of the main method."""
    core_image: Image
    """Core camera's image on the depth map's grid."""
    depth: Mapping[str, DepthScore]
    """Scores by method."""
    true_mm: NDArray[np.float64]
    """(H, W) true depth, mm, in the evaluated region; NaN elsewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class VolumeResult:
    """A measured volume and the true one of the same box."""

    volume: Volume
    true_mm3: float

    @property
    def error(self) -> float:
        """Relative error."""
        return self.volume.volume_mm3 / self.true_mm3 - 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Demo:
    """All results of the demo."""

    out: Path
    calibration: Calibration
    rig: RigScore
    rectified: Sequence[Panel]
    """Four per pair: core and auxiliary before, core and auxiliary after."""
    scenes: Mapping[str, SceneResult]
    volumes: Mapping[str, VolumeResult]
    warnings: tuple[str, ...]


def run_demo(out: Path, reporter: Reporter) -> Demo:
    """Calibrate, rectify, reconstruct and measure with the same functions as the commands."""
    truth = read_rig(DATA / "truth" / "rig.json")
    calibration = calibrate(DATA / "calibration", read_board(DATA / "board.toml"), "cam0", reporter)
    write_calibration(out / "calibration", calibration)
    rig = calibration.rig
    near_far, _ = rectify_capture(DATA / "belt_loaded", rig, out / "rectified", reporter)
    scenes = {scene: _evaluate_scene(scene, rig, truth, out, reporter) for scene in SCENES}
    volumes = {scene: _evaluate_volume(scene, out, reporter) for scene in SCENES if scene != "belt_empty"}
    return Demo(
        out, calibration, score_rig_against_truth(rig, truth, load_on_processor()),
        _make_rectified_panels(rig, near_far), scenes, volumes, calibration.warnings,
    )  # fmt: skip


def _make_rectified_panels(rig: Rig, near_far: tuple[float, float]) -> Sequence[Panel]:
    """Return the pictures of the loaded belt's pairs before and after rectification."""
    source = open_capture(DATA / "belt_loaded", rig, Silent())
    frame_set, pairs, consistency, _ = next(rectify(source, rig, near_far, Silent()))
    return make_rectification_panels(rig, frame_set, pairs, consistency)


def _evaluate_scene(scene: str, rig: Rig, truth: Rig, out: Path, reporter: Reporter) -> SceneResult:
    true_mm = _resample_truth(rig, truth, read_float_tiff(DATA / "truth" / f"{scene}_depth.tiff"))
    region = _lit_mask(true_mm, rig)
    depths: dict[str, DepthMap] = {}
    for method in METHODS:
        folder = out / (scene if method == MAIN else f"{scene}_{method}")
        reconstruct_capture(DATA / scene, rig, folder, reporter, method=method)
        depths[method] = read_frame(folder / "000").depth
    image = undistort_image(read_image(DATA / scene / rig.core / "000.png"), rig.core_camera)
    return SceneResult(
        folder=out / scene / "000",
        depth_map=depths[MAIN],
        core_image=image,
        depth={method: score_depth(depth, true_mm, region) for method, depth in depths.items()},
        true_mm=np.where(region, true_mm, np.nan),
    )


def _resample_truth(rig: Rig, truth: Rig, true_mm: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the true depth on the grid of the calibrated core camera, by nearest pixel to keep depth steps."""
    true_camera = truth.core_camera
    pixels = rig.core_camera.rays() * true_camera.focal_px + true_camera.center_px
    u, v = np.rint(pixels).astype(int).transpose(2, 0, 1)
    height, width = true_mm.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    sampled = true_mm[v.clip(0, height - 1), u.clip(0, width - 1)].astype(np.float64)
    return np.where(inside, sampled, np.nan)


def _true_belt_from_core() -> Pose:
    entry = read_json(DATA / "truth" / "volume.json")["belt_from_core"]
    return Pose.of(entry["rotation"], entry["translation_mm"])


def _lit_mask(true_mm: NDArray[np.float64], rig: Rig) -> NDArray[np.bool_]:
    points = np.concatenate([rig.core_camera.rays() * true_mm[..., None], true_mm[..., None]], axis=-1)
    along = _true_belt_from_core().apply(points)[..., 1]
    return np.abs(along) <= WITHIN_MM


def _evaluate_volume(scene: str, out: Path, reporter: Reporter) -> VolumeResult:
    truth = read_json(DATA / "truth" / "volume.json")["scenes"][scene]
    volume = measure_volume_of_frames(
        out / scene / "000", out / "belt_empty" / "000", VolumeSettings(), across_mm=None, along_mm=ALONG_MM
    )
    write_volume(out / f"volume_{scene}", volume)
    reporter.step(f"measuring {scene}", 1, 1)
    edges = truth["first_y_mm"] + np.arange(len(truth["area_mm2"]) + 1)
    cumulated = np.concatenate([[0.0], np.cumsum(truth["area_mm2"])])
    low, high = np.interp(ALONG_MM, edges, cumulated)
    return VolumeResult(volume, float(high - low))


def make_demo_document(demo: Demo) -> Mapping[str, Any]:
    """Return the demo's results as plain values for JSON."""
    held_out = demo.calibration.held_out
    return {
        "report": demo.out / "report.html",
        "held_out": held_out.document() if held_out else None,
        "rig_against_truth": asdict(demo.rig),
        "depth_against_truth": {
            scene: {method: asdict(score) for method, score in result.depth.items()}
            for scene, result in demo.scenes.items()
        },
        "volume_against_truth": {
            scene: {
                "volume_mm3": result.volume.volume_mm3,
                "sigma_mm3": result.volume.sigma_mm3,
                "true_mm3": result.true_mm3,
                "coverage": result.volume.coverage,
            }
            for scene, result in demo.volumes.items()
        },
    }


CLOUD_POINTS = 30_000
"""Number of points that a browser redraws smoothly while the view is rotated; chosen."""


def render_demo_page(demo: Demo) -> str:
    """Return report.html of the demo."""
    loaded, module = demo.volumes["belt_loaded"], demo.volumes["module"]
    summary = (
        f"{len(demo.calibration.rig.cameras)} cameras, calibrated from {demo.calibration.training.views} board "
        "views, measure "
        f"{format_litres(loaded.volume.volume_mm3)} ± {format_litres(loaded.volume.sigma_mm3)} litres of rock "
        "on 0.4 m of belt; "
        f"the truth is {format_litres(loaded.true_mm3)}."
    )
    sections = [
        Section(
            "In numbers",
            "Every figure is compared with the truth, which is known exactly because the images are rendered.",
            [_tiles(demo)],
        ),
        Section(
            "Rig and point cloud",
            "Cameras as calibrated, and the loaded belt as points in the core camera's frame.",
            [InteractiveScene(_scene(demo), "Core camera in orange, auxiliaries in blue."), _rig_table(demo)],
        ),
        Section(
            "Epipolar rectification",
            "About the core camera, each auxiliary in turn; corresponding points lie on lines of one colour.",
            [Pictures(demo.rectified, "Before and after, one row per pair.", columns=4)],
        ),
        Section(
            "Depth against truth",
            "Share of all true pixels measured within 1 and 0.25 mm; "
            "median away from edges; gross: off by more than 5 mm; pixels on a true depth step are left out. "
            f"Evaluated within {WITHIN_MM:.0f} mm of the rig's centre along the belt. Multiview matches all "
            "auxiliaries at once; pairwise, the paper's method, is the mean over all core–auxiliary pairs, "
            "binocular one pair alone.",
            [_depth_table(demo), *(_scene_figure(demo, scene) for scene in demo.scenes)],
        ),
        Section(
            "Volume",
            f"Loaded belt: {format_litres(loaded.volume.volume_mm3)} ± "
            f"{format_litres(loaded.volume.sigma_mm3)} l measured, "
            f"{format_litres(loaded.true_mm3)} l true. Module: {format_litres(module.volume.volume_mm3)} ± "
            f"{format_litres(module.volume.sigma_mm3)} l measured, {format_litres(module.true_mm3)} l true.",
            [
                _volume_table(demo),
                make_height_chart(loaded.volume),
                make_profiles_chart(loaded.volume),
            ],
        ),
    ]
    return render("Demo: from images to litres", summary, sections, warnings=demo.warnings)


def _tiles(demo: Demo) -> Tiles:
    held_out = demo.calibration.held_out or demo.calibration.training
    loaded, rig = demo.volumes["belt_loaded"], demo.rig
    tiles = [
        Tile("reprojection, held out", f"{held_out.rms_px:.3f}", "px", f"median {held_out.median_px:.3f} px"),
        Tile("depth error of the rig", f"{rig.depth_rms_mm:.3f}", "mm RMS", f"max {rig.depth_max_mm:.3f} mm"),
    ]
    for label, scene in (("empty belt", "belt_empty"), ("rocks", "belt_loaded")):
        score = demo.scenes[scene].depth[MAIN]
        note = f"{score.within_1mm:.1%} within 1 mm"
        tiles.append(Tile(f"{label}, median error", f"{score.interior_median_mm:.3f}", "mm", note))
    share = loaded.volume.sigma_mm3 / loaded.true_mm3
    return Tiles([*tiles, Tile("volume error", f"{100 * loaded.error:+.1f}", "%", f"one σ is {share:.1%}")])


def _rig_table(demo: Demo) -> Table:
    rig = demo.calibration.rig
    return Table(
        ["camera", "from core mm", "centre off by mm", "rotation off by °"],
        [
            [name, f"{np.linalg.norm(rig.cam_from_core[name].center_mm):.2f}",
             f"{demo.rig.center_mm[name]:.3f}", f"{demo.rig.rotation_deg[name]:.4f}"]
            for name in rig.auxiliaries
        ],
        "Auxiliary cameras against the true rig.",
    )  # fmt: skip


def _scene(demo: Demo) -> Scene:
    rig: Rig = demo.calibration.rig
    cloud = read_cloud(demo.scenes["belt_loaded"].folder / "cloud.ply")
    chosen = np.random.default_rng(0).permutation(len(cloud.points_mm))[:CLOUD_POINTS]
    points = cloud.points_mm[np.sort(chosen)].astype(np.float64)
    depth = points[:, 2]
    scale = Scale(float(np.quantile(depth, 0.01)), float(np.quantile(depth, 0.99)), NEAR_TO_FAR)
    cameras = make_rig_scene(rig, length_mm=0.25 * float(np.median(depth)))
    return Scene(cameras.lines, cameras.labels, points, scale.to_rgb(depth))


def _depth_table(demo: Demo) -> Table:
    return Table(
        [
            "scene",
            "method",
            "measured",
            "< 1 mm",
            "< 0.25 mm",
            "median mm",
            "bias mm",
            "gross",
            "actual / predicted σ",
        ],
        [
            [SCENE_NAMES[scene], method, *_depth_row(result.depth[method])]
            for scene, result in demo.scenes.items()
            for method in METHODS
        ],
    )


def _depth_row(score: DepthScore) -> list[str]:
    return [
        f"{score.coverage:.1%}", f"{score.within_1mm:.1%}", f"{score.within_quarter_mm:.1%}",
        f"{score.interior_median_mm:.3f}", f"{score.interior_bias_mm:+.3f}", f"{score.gross:.1%}",
        f"{score.sigma_ratio:.2f}",
    ]  # fmt: skip


def _scene_figure(demo: Demo, scene: str) -> Pictures:
    result = demo.scenes[scene]
    depth = result.depth_map
    panels = [
        Panel(to_rgb(result.core_image), "core camera, undistorted"),
        make_depth_panel(depth),
        make_sigma_panel(depth),
        make_error_panel(depth, result.true_mm, limit_mm=ERROR_MM),
    ]
    return Pictures(
        panels,
        f"{SCENE_NAMES[scene].capitalize()}: image, depth, its σ, and the error against the truth.",
        columns=2,
    )


def _volume_table(demo: Demo) -> Table:
    return Table(
        ["scene", "measured l", "σ l", "true l", "error", "error / σ", "measured share"],
        [
            [SCENE_NAMES[scene], format_litres(v.volume.volume_mm3), format_litres(v.volume.sigma_mm3),
             format_litres(v.true_mm3),
             f"{v.error:+.2%}", f"{(v.volume.volume_mm3 - v.true_mm3) / v.volume.sigma_mm3:+.1f}",
             f"{v.volume.coverage:.1%}"]
            for scene, v in demo.volumes.items()
        ],
    )  # fmt: skip
