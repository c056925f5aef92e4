"""The report of the demo: pictures and figures of the whole chain, each compared with the truth."""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.demo import MAIN, METHODS, Demo
from beltscape.evaluate.paper.pages.formatting import ERROR_MM, SCENES
from beltscape.evaluate.scores.depth import DepthScore
from beltscape.evaluate.truth.simulated import WITHIN_MM
from beltscape.files.meshes.ply_points import read_cloud
from beltscape.report.drawing.depth_picture import make_depth_panel, make_error_panel, make_sigma_panel
from beltscape.report.drawing.legend import NEAR_TO_FAR, Scale
from beltscape.report.drawing.pictures import Panel, to_rgb
from beltscape.report.drawing.scene import Scene, make_rig_scene
from beltscape.report.measuring.volume import format_litres, make_height_chart, make_profiles_chart
from beltscape.report.page import InteractiveScene, Pictures, Section, Table, Tile, Tiles, render

CLOUD_POINTS = 30_000
"""Number of points that a browser redraws smoothly while the view is rotated; chosen."""


def render_demo_page(demo: Demo) -> str:
    """Return report.html of the demo."""
    loaded, module = demo.volumes["belt_loaded"], demo.volumes["module"]
    summary = (
        f"Five cameras, calibrated from {demo.calibration.training.views} board views, measure "
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
            [SCENES[scene], method, *_depth_row(result.depth[method])]
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
        f"{SCENES[scene].capitalize()}: image, depth, its σ, and the error against the truth.",
        columns=2,
    )


def _volume_table(demo: Demo) -> Table:
    return Table(
        ["scene", "measured l", "σ l", "true l", "error", "error / σ", "measured share"],
        [
            [SCENES[scene], format_litres(v.volume.volume_mm3), format_litres(v.volume.sigma_mm3),
             format_litres(v.true_mm3),
             f"{v.error:+.2%}", f"{(v.volume.volume_mm3 - v.true_mm3) / v.volume.sigma_mm3:+.1f}",
             f"{v.volume.coverage:.1%}"]
            for scene, v in demo.volumes.items()
        ],
    )  # fmt: skip
