"""Files of a calibration: rig.json, calibration.json, report.html, coverage.png."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.calibration.assessment.next_best_view import NextBestView
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.detection.detector import PrintVariant
from beltscape.calibration.network.association import Misclosure
from beltscape.calibration.result import Calibration
from beltscape.core.frames import Image
from beltscape.files.atomic import write_bytes, write_text
from beltscape.files.images import read_image
from beltscape.files.json_text import write_json
from beltscape.files.rig_json import write_rig
from beltscape.report.calibration import calibration_page
from beltscape.report.calibration_plots import coverage_picture

MAX_REJECTED = 12
"""Largest number of rejected views in the report."""


def write_calibration(out: Path, calibration: Calibration) -> None:
    """Write rig.json, calibration.json, report.html and coverage.png."""
    write_rig(out / "rig.json", calibration.rig)
    write_json(out / "calibration.json", make_calibration_document(calibration))
    page = calibration_page(calibration, _read_rejected_images(calibration))
    write_text(out / "report.html", page)
    write_bytes(out / "coverage.png", coverage_picture(calibration.coverage))


def _read_rejected_images(calibration: Calibration) -> list[tuple[str, Image]]:
    """Return (caption, image) of the rejected views for the report."""
    rejected: list[tuple[str, Image]] = []
    for name, camera in calibration.hierarchy.monocular.items():
        for frame, reason in camera.rejected.items():
            image = read_image(calibration.capture.files[name][frame])
            rejected.append((f"{name}, frame {frame}: {reason}", image))
    return rejected[:MAX_REJECTED]


def make_calibration_document(calibration: Calibration) -> Mapping[str, Any]:
    """Return calibration.json, the results of each level of the hierarchy."""
    hierarchy, adjustment = calibration.hierarchy, calibration.adjustment
    return {
        "format": "beltscape-calibration/1",
        "core": hierarchy.rig.core,
        "board": {
            **calibration.board.model_dump(),
            **({} if calibration.board.kind == "chessboard" else _make_variant_document(calibration.variant)),
            "off_drawing_rms_mm": np.sqrt((adjustment.shape_mm**2).mean(axis=0)),
        },
        "fit": calibration.fit.document(),
        "held_out": calibration.held_out.document() if calibration.held_out else None,
        "training": calibration.training.document(),
        "depth_sigma_mm": [
            {
                "depth_mm": s.depth_mm,
                "median": np.nanmedian(s.sigma_mm),
                "worst": np.nanmax(s.sigma_mm),
                "median_by_views": np.nanmedian(by_views.sigma_mm),
            }
            for s, by_views in zip(calibration.depth_sigma, calibration.depth_sigma_by_views, strict=True)
        ],
        "worst_depth": calibration.worst_depth,
        "next_pose": _make_next_view_document(calibration.next_best_view),
        "cameras": {name: _make_camera_document(calibration, name) for name in calibration.rig.cameras},
        "corners_left_out": _list_excluded_corners(adjustment),
        "pairs": [
            {
                "cameras": [pair.first, pair.second],
                "frames": len(pair.frames),
                "corners": pair.corners,
                "rms_px": pair.rms_px,
                "rotation": pair.second_from_first.rotation,
                "translation_mm": pair.second_from_first.translation_mm,
                "rejected": pair.rejected,
            }
            for pair in hierarchy.network.pairs
        ],
        "path_errors": [_make_misclosure_document(error) for error in hierarchy.network.path_errors],
        "loop_errors": [_make_misclosure_document(error) for error in hierarchy.network.loop_errors],
        "left_out": calibration.discards.document(),
        "coverage": {
            "volume": calibration.coverage.volume.name,
            "uncertain": calibration.coverage.share(calibration.coverage.is_uncertain),
            "unusable": calibration.coverage.share(calibration.coverage.is_unusable),
        },
        "notes": calibration.notes,
        "warnings": calibration.warnings,
    }


def _make_camera_document(calibration: Calibration, name: str) -> Mapping[str, Any]:
    camera, adjustment = calibration.hierarchy.monocular[name], calibration.adjustment
    final, index = calibration.rig.cameras[name], list(calibration.rig.cameras).index(name)
    covariance = calibration.covariance
    sigma = np.sqrt(np.diag(covariance.matrix))
    of_camera = adjustment.bundle.observations.camera == index
    return {
        "images": calibration.detections.images[name],
        "board_seen": len(calibration.detections.views[name]),
        "views_used": len(camera.cam_from_board),
        "focal_px": final.focal_px,
        "center_px": final.center_px,
        "model": final.model,
        "model_choice": _make_choice_document(calibration, name),
        "distortion": final.distortion,
        "valid_radius_px": final.valid_radius_px,
        "sigma": {
            parameter.removeprefix(f"{name}."): float(value)
            for parameter, value in zip(covariance.parameters, sigma, strict=True)
            if parameter.startswith(f"{name}.")
        },
        "held": camera.fixed,
        "intrinsics": _describe_origin(calibration, name),
        "noise_px": adjustment.sigma_px[index],
        "corners": int(of_camera.sum()),
        "corners_left_out": int((of_camera & ~adjustment.used).sum()),
        "intrinsics_from_own_views": name in adjustment.own_view_cameras,
        "monocular": {
            "rms_px": camera.rms_px,
            "focal_px": camera.camera.focal_px,
            "center_px": camera.camera.center_px,
            "distortion": camera.camera.distortion,
            "sigma": camera.sigma,
        },
        "rejected": camera.rejected,
        "path_from_core": calibration.hierarchy.network.paths[name],
    }


def _describe_origin(calibration: Calibration, name: str) -> str:
    """Return where a camera's intrinsics come from: its views, a file, or its views with a file as prior."""
    if name not in calibration.given:
        return "estimated"
    return "given" if calibration.hierarchy.monocular[name].prior is None else "prior"


def _make_choice_document(calibration: Calibration, name: str) -> Mapping[str, Any] | None:
    """Return why the camera has its lens model; None if it was given, or is the default one."""
    choices = {choice.camera: choice for choice in calibration.hierarchy.lens_choices}
    choice = choices.get(name)
    if choice is None or not choice.reason:
        return None
    return {"reason": choice.reason, "held_out_px": choice.held_out_px}


def _make_next_view_document(pose: NextBestView | None) -> Mapping[str, Any] | None:
    if pose is None:
        return None
    return {
        "enough": pose.is_sufficient,
        "words": pose.describe(),
        "seen_by": pose.seen_by,
        "sigma_now_mm": pose.sigma_now_mm,
        "sigma_then_mm": pose.sigma_then_mm,
        "core_from_board": {
            "rotation": pose.core_from_board.rotation,
            "translation_mm": pose.core_from_board.translation_mm,
        },
    }


def _make_misclosure_document(error: Misclosure) -> Mapping[str, Any]:
    return {
        "cameras": error.cameras,
        "rotation_deg": error.rotation_deg,
        "translation_mm": error.translation_mm,
        "chi2_per_dof": error.chi2_per_dof,
        "p_value": error.p_value,
    }


def _list_excluded_corners(adjustment: BundleAdjustmentResult) -> list[Mapping[str, Any]]:
    """Return the corners that the final adjustment left out, with their errors."""
    o, names = adjustment.bundle.observations, list(adjustment.rig.cameras)
    off = np.linalg.norm(adjustment.bundle.compute_errors_px(adjustment.geometry), axis=1)
    return [
        {
            "camera": names[o.camera[i]],
            "frame": adjustment.frames[o.frame[i]],
            "corner": int(o.point[i]),
            "error_px": float(off[i]),
        }
        for i in np.flatnonzero(~adjustment.used)
    ]


def _make_variant_document(variant: PrintVariant) -> dict[str, bool]:
    return {"legacy": variant.legacy, "inverted": variant.inverted}
