"""Report of a calibration: the summary first, then scores, rig, depth, views and network."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.covariance import DepthSigma, RigCovariance, list_parameter_columns
from beltscape.calibration.assessment.coverage import describe_place, describe_tolerance
from beltscape.calibration.assessment.fit_quality import FitQuality
from beltscape.calibration.assessment.next_best_view import NextBestView
from beltscape.calibration.assessment.score import RigErrors, Score
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.network.association import Misclosure
from beltscape.calibration.result import Calibration
from beltscape.core.frames import Image
from beltscape.files.rig_limits import find_corner_radius_px
from beltscape.report.calibration_plots import (
    coverage_chart,
    depth_sigma_chart,
    make_need_section,
    residual_chart,
)
from beltscape.report.drawing.pictures import Panel, to_rgb
from beltscape.report.drawing.scene import Scene, make_rig_scene
from beltscape.report.page import InteractiveScene, Item, Lines, Pictures, Section, Table, Tile, Tiles, render
from beltscape.target.board import Board, outline_corners


def make_next_view_scene(
    adjustment: BundleAdjustmentResult, board: Board, following: NextBestView
) -> InteractiveScene:
    """Return the rig with the recommended pose of the board."""
    outline = following.core_from_board.apply(_outline_board(adjustment, board))
    middle = float(np.median(np.linalg.norm(adjustment.geometry.board_translation_mm, axis=1)))
    return InteractiveScene(
        make_rig_scene(adjustment.rig, length_mm=0.3 * middle, boards_mm={"next": outline}),
        "The recommended pose of the board.",
    )


def _outline_board(adjustment: BundleAdjustmentResult, board: Board) -> NDArray[np.float64]:
    """Return the closed outline (n, 3) of the board's corners in its own frame."""
    return adjustment.geometry.points_mm[outline_corners(board)]


def make_board_scene(adjustment: BundleAdjustmentResult, board: Board) -> Scene:
    """Return the rig with the outline of the board in every frame."""
    geometry, outline = adjustment.geometry, _outline_board(adjustment, board)
    boards = {
        frame: outline @ rotation.T + translation
        for frame, rotation, translation in zip(
            adjustment.frames, geometry.board_rotation, geometry.board_translation_mm, strict=True
        )
    }
    middle = float(np.median(np.linalg.norm(geometry.board_translation_mm, axis=1)))
    return make_rig_scene(adjustment.rig, length_mm=0.3 * middle, boards_mm=boards)


CLOSURE = ("error °", "error mm", "χ² / dof")


def calibration_page(calibration: Calibration, rejected_images: Sequence[tuple[str, Image]]) -> str:
    """Return report.html of a calibration, with the captions and images of rejected views."""
    adjustment, hierarchy, board = calibration.adjustment, calibration.hierarchy, calibration.board
    sections = [
        _quality_section(calibration),
        _rig_section(calibration),
        _depth_section(calibration),
        _next_section(adjustment, board, calibration.next_best_view),
        *_view_sections(adjustment, calibration.rig_errors),
        make_need_section(calibration.coverage),
        _network_section(hierarchy),
        *_make_notes_section(calibration.notes),
        _make_left_out_section(hierarchy, rejected_images, calibration.discards.describe()),
    ]
    return render("Calibration", _describe_verdict(calibration), sections, warnings=calibration.warnings)


def _quality_section(calibration: Calibration) -> Section:
    tolerance = describe_tolerance(calibration.coverage)
    return Section(
        "Quality",
        f"Board: {calibration.board.describe()}; {_describe_shape(calibration.adjustment)}.",
        [
            _make_tiles(calibration.score, calibration.depth_sigma[1]),
            *([Lines([tolerance])] if tolerance else []),
            _make_score_table(calibration.held_out, calibration.training),
            _make_fit_table(calibration.fit),
        ],
    )


def _rig_section(calibration: Calibration) -> Section:
    scene = make_board_scene(calibration.adjustment, calibration.board)
    return Section(
        "The rig",
        "Cameras as calibrated, with the outline of the board in every frame.",
        [
            InteractiveScene(scene, "Core camera in orange, auxiliaries in blue."),
            _make_camera_table(calibration.hierarchy, calibration.adjustment, calibration.covariance),
            _make_lens_table(calibration),
        ],
    )


def _describe_verdict(calibration: Calibration) -> str:
    rig, board, score, fit = calibration.rig, calibration.board, calibration.score, calibration.fit
    views = (
        "the views that the rig was calibrated with (too few for two halves)"
        if calibration.held_out is None
        else "views that the rig was not calibrated with"
    )
    doubt = "" if fit.is_sound else f"The fit is in doubt: {'; '.join(fit.findings)}. "
    return (
        f"{doubt}{len(rig.cameras)} cameras about {rig.core}. On {views}, the reprojection error "
        f"is {score.rms_px:.3f} px RMS, {score.median_px:.3f} px in the median, {_describe_squares(board, score)}."
    )


def _describe_squares(board: Board, score: Score) -> str:
    if not score.has_squares:
        return "and no square was seen by two cameras"
    return (
        f"and a {board.square_mm:g} mm square measures {board.square_mm + score.square_bias_mm:.3f} ± "
        f"{score.square_rms_mm:.3f} mm"
    )


def _depth_section(calibration: Calibration) -> Section:
    inflation = calibration.covariance.inflation
    medians = ", ".join(f"{np.nanmedian(each.sigma_mm):.3f} mm" for each in calibration.depth_sigma_by_views)
    alike = (
        f" By clusters of views, which takes no corners of a view as independent, the medians are {medians}: "
        "far larger ones mean that errors within the views are alike (blur, light, the lens model)."
    )
    caption = "Over the core camera's view; empty where fewer than two cameras see the point."
    raised = (
        f" The views scatter {inflation:.1f} times more than the noise of the corners explains (a board that bends, "
        "a lens that the model does not describe); σ includes this factor."
    )
    return Section(
        "Standard deviation of depth",
        "One standard deviation of a triangulated depth from calibration alone, where the nearest, the middle and "
        "the farthest boards were. It is largest where few cameras see a point, all from one direction, or "
        "where the board never was. Matching adds to it. Heights over the belt are affected less, since most of the "
        "error is common to belt and load." + (raised if inflation > 1 else "") + alike,
        [
            *([Lines([worst])] if (worst := calibration.worst_depth) else []),
            depth_sigma_chart(calibration.depth_sigma, caption),
        ],
    )


def _next_section(
    adjustment: BundleAdjustmentResult, board: Board, following: NextBestView | None
) -> Section:
    if following is None:
        return Section("Next view", "Two cameras would see the board in no pose.", [])
    return Section("Next view", following.describe(), [make_next_view_scene(adjustment, board, following)])


def _view_sections(adjustment: BundleAdjustmentResult, rig_errors: RigErrors) -> list[Section]:
    coverage = coverage_chart(adjustment.rig, rig_errors, "Corners by camera.")
    return [
        Section(
            "Coverage",
            "Where the board was seen in each image. In empty corners the distortion is not determined.",
            [coverage],
        ),
        Section(
            "Residuals",
            "Arrows from projected to detected corners, magnified. A pattern means that the model does not fit; "
            "an even scatter is noise.",
            [residual_chart(adjustment.rig, rig_errors)],
        ),
    ]


def _network_section(hierarchy: HierarchyResult) -> Section:
    return Section(
        "The network",
        "Every pair that shares views, calibrated alone, with its misclosure against the path through the core; "
        "every triangle of cameras with its misclosure (Eq. 16). χ² per degree of freedom is about "
        "1 where noise explains it.",
        [_make_pair_table(hierarchy), *_make_triangle_tables(hierarchy)],
    )


def _make_notes_section(notes: Sequence[str]) -> list[Section]:
    """Return the notes as a section; empty without any."""
    intro = "What looked like a fault before the joint adjustment and is none, and other remarks."
    return [Section("Notes", intro, [Lines(notes)])] if notes else []


def _make_left_out_section(
    hierarchy: HierarchyResult, images: Sequence[tuple[str, Image]], left_out: str
) -> Section:
    rejected = _list_rejected(hierarchy)
    pictures = [Pictures([Panel(to_rgb(image), why) for why, image in images], columns=2)] if images else []
    intro = f"{left_out[0].upper()}{left_out[1:]}."
    if not rejected:
        return Section("Left out", intro, [])
    reason = " Rejected views fit far worse than the rest: blur, a finger on the board, a moving board."
    return Section("Left out", intro + reason, [Lines(rejected), *pictures])


def _make_tiles(score: Score, depth: DepthSigma) -> Tiles:
    return Tiles(
        [
            Tile("reprojection error, RMS", f"{score.rms_px:.3f}", "px", f"median {score.median_px:.3f} px"),
            Tile(
                "square edge, RMS error",
                _format_mm(score.square_rms_mm, ".3f"),
                "mm",
                f"bias {_format_mm(score.square_bias_mm, '+z.4f')} mm",
            ),
            Tile(
                "depth σ from calibration",
                f"{np.nanmedian(depth.sigma_mm):.3f}",
                "mm",
                f"median at {depth.depth_mm:.0f} mm; worst {_describe_worst(depth)}",
            ),
            Tile("evidence", f"{score.corners}", "corners", f"{score.views} views in {score.frames} frames"),
        ]
    )


def _describe_worst(depth: DepthSigma) -> str:
    """Return the largest σ and where it is."""
    row, column = np.unravel_index(np.nanargmax(depth.sigma_mm), depth.sigma_mm.shape)
    rows, columns = depth.sigma_mm.shape
    place = describe_place(np.array([[float(column), float(row)]]), (columns, rows))
    return f"{depth.sigma_mm[row, column]:.3f} mm {place} of the view"


def _make_score_table(held_out: Score | None, training: Score) -> Table:
    rows = [("held out", held_out), ("training", training)]
    return Table(
        ["", "RMS px", "median px", "square bias mm", "square RMS mm", "planarity RMS mm", "views", "corners"],
        [
            [name, f"{s.rms_px:.4f}", f"{s.median_px:.4f}", _format_mm(s.square_bias_mm, "+z.4f"),
             _format_mm(s.square_rms_mm, ".4f"), _format_mm(s.planarity_rms_mm, ".4f"), f"{s.views}", f"{s.corners}"]
            for name, s in rows if s is not None
        ],
        "Held out: each half of the frames scored with the rig from the other half. Training scores are optimistic.",
    )  # fmt: skip


def _format_mm(length_mm: float, form: str) -> str:
    """Return a length; a dash where no two cameras saw what it is of."""
    return format(length_mm, form) if np.isfinite(length_mm) else "–"


def _make_fit_table(fit: FitQuality) -> Table:
    rows = [
        [
            name,
            f"{own.rms_px:.4f}",
            f"{own.sigma_px:.4f}",
            f"{own.corner_noise_px:.4f}",
            f"{own.chi2_per_dof:.1f}",
        ]
        for name, own in fit.cameras.items()
    ]
    return Table(
        ["camera", "RMS px", "σ of residuals px", "noise of corners px", "χ² / dof"],
        rows,
        "Residuals compared with the noise of the corners, which is estimated from neighbouring corners: about 1 if "
        "noise explains them, far more if the model, a camera's pose or the board is wrong.",
    )


def _describe_shape(adjustment: BundleAdjustmentResult) -> str:
    if not np.any(adjustment.shape_mm):
        return "flat and regular as drawn, within the accuracy of the views"
    off = np.sqrt((adjustment.shape_mm**2).mean(axis=0))
    return (
        f"its corners deviate from the drawing by {off[2]:.3f} mm out of plane and {np.hypot(*off[:2]):.3f} mm in "
        "plane (RMS), which was measured and is corrected"
    )


def _make_camera_table(
    hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult, covariance: RigCovariance
) -> Table:
    rows: list[list[str]] = []
    sigma = np.sqrt(np.diag(covariance.matrix))
    sigmas = [
        sigma[list_parameter_columns(adjustment.rig, index)] for index in range(len(adjustment.rig.cameras))
    ]
    for (name, c), s, noise in zip(adjustment.rig.cameras.items(), sigmas, adjustment.sigma_px, strict=True):
        camera = hierarchy.monocular[name]
        rows.append(
            [
                name + (" (core)" if name == hierarchy.rig.core else ""),
                f"{len(camera.cam_from_board)}", f"{noise:.3f}",
                f"{c.focal_px[0]:.2f} ± {s[0]:.2f}", f"{c.focal_px[1]:.2f} ± {s[1]:.2f}",
                f"{c.center_px[0]:.2f} ± {s[2]:.2f}", f"{c.center_px[1]:.2f} ± {s[3]:.2f}",
                f"{np.linalg.norm(adjustment.rig.cam_from_core[name].center_mm):.2f}",
                " → ".join(hierarchy.network.paths[name]),
            ]
        )  # fmt: skip
    names = ["camera", "views", "noise px", "fx px", "fy px", "cx px", "cy px", "from core mm", "path"]
    return Table(names, rows, "After the joint adjustment, with one standard deviation each.")


CANDIDATES = ("brown", "fisheye", "tilted", "rational")
"""Lens models that are compared, in the order of the table of lenses."""


def _make_lens_table(calibration: Calibration) -> Table:
    """Return each camera's lens: the models compared, and how far it is known and corners reach."""
    choices = {choice.camera: choice for choice in calibration.hierarchy.lens_choices}
    used, observed = calibration.adjustment.used, calibration.adjustment.bundle.observations
    rows: list[list[str]] = []
    for index, (name, camera) in enumerate(calibration.rig.cameras.items()):
        corners = observed.pixels[used & (observed.camera == index)]
        reach_px = np.linalg.norm(corners - camera.center_px, axis=1).max(initial=0.0)
        held_out = choices[name].held_out_px if name in choices else {}
        limit_px = camera.valid_radius_px
        rows.append(
            [
                name, camera.model, *(_format_error(held_out.get(model)) for model in CANDIDATES),
                "whole image" if limit_px is None else f"{limit_px:.0f}", f"{reach_px:.0f}",
                f"{find_corner_radius_px(camera):.0f}",
                ", ".join(calibration.hierarchy.monocular[name].fixed) or "none",
            ]
        )  # fmt: skip
    names = ["camera", "lens", *CANDIDATES, "valid to px", "corners to px", "image to px", "fixed"]
    return Table(
        names, rows,
        "Lenses: RMS in px on held-out views of the models that were compared, none where brown is the default; "
        "distances from the principal point up to which the lens is used, corners were seen, and the image reaches.",
    )  # fmt: skip


def _format_error(rms_px: float | None) -> str:
    if rms_px is None:
        return "–"
    return f"{rms_px:.3f}" if np.isfinite(rms_px) else "does not fit"


def _make_pair_table(hierarchy: HierarchyResult) -> Item:
    errors = {frozenset(e.pair): e for e in hierarchy.network.path_errors}
    rows: list[list[str]] = []
    for pair in hierarchy.network.pairs:
        error = errors.get(frozenset((pair.first, pair.second)))
        rows.append(
            [
                f"{pair.first} – {pair.second}", f"{len(pair.frames)}", f"{pair.corners}", f"{pair.rms_px:.3f}",
                f"{np.linalg.norm(pair.second_from_first.translation_mm):.2f}",
                f"{pair.second_from_first.angle_deg:.3f}", *(_format_closure(error) if error else ["–"] * 3),
            ]
        )  # fmt: skip
    names = ["pair", "frames", "corners", "RMS px", "baseline mm", "angle °", *CLOSURE]
    return Table(names, rows, "Pairs.")


def _make_triangle_tables(hierarchy: HierarchyResult) -> list[Table]:
    rows = [[" – ".join(error.cameras), *_format_closure(error)] for error in hierarchy.network.loop_errors]
    return [Table(["triangle", *CLOSURE], rows, "Triangles.")] if rows else []


def _format_closure(error: Misclosure) -> list[str]:
    return [f"{error.rotation_deg:.4f}", f"{error.translation_mm:.3f}", f"{error.chi2_per_dof:.1f}"]


def _list_rejected(hierarchy: HierarchyResult) -> list[str]:
    lines = [
        f"{name}, frame {frame}: {why}"
        for name, camera in hierarchy.monocular.items()
        for frame, why in camera.rejected.items()
    ]
    return lines + [
        f"{pair.first} – {pair.second}, frame {frame}: {why}"
        for pair in hierarchy.network.pairs
        for frame, why in pair.rejected.items()
    ]
