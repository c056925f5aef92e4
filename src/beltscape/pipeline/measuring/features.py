"""Dimensions of the calibration module in a reconstructed frame, with their files and report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import BeltscapeError, InputError, MeasureError
from beltscape.core.frames import Image, to_grey
from beltscape.files.atomic import ensure_output_folder, write_text
from beltscape.files.images import read_image
from beltscape.files.json_text import write_json
from beltscape.files.reconstruction import FrameResult, read_frame
from beltscape.measure.features.measure import measure_module
from beltscape.measure.features.result import MeasuredModule
from beltscape.pipeline.measuring.solids import make_solids_document
from beltscape.report.measuring.features import render_features_page
from beltscape.stereo.pointcloud import undistort_image
from beltscape.target.module import read_module


def measure_features_of_frame(
    folder: Path, module: Path, image: Path | None = None
) -> tuple[FrameResult, MeasuredModule]:
    """Measure the dimensions of the module in a frame folder of beltscape reconstruct.

    ``image`` is a further, distorted image of the same still scene by the core camera with the projector off.

    Raises
    ------
    InputError, MeasureError
        With one line that names the fault and the fix.
    """
    nominal, frame = read_module(module), read_frame(folder)
    plain = None if image is None else _read_plain_image(image, frame)
    pattern = None if frame.image is None else to_grey(frame.image)
    try:
        return frame, measure_module(frame.depth, frame.rig, nominal, pattern=pattern, plain=plain)
    except MeasureError as error:
        raise MeasureError(f"{folder}: {error}") from error


def _read_plain_image(path: Path, frame: FrameResult) -> NDArray[np.float32]:
    """Return a distorted image resampled to the depth map's grid, (H, W) float32."""
    taken: Image = read_image(path)
    try:
        return to_grey(undistort_image(taken, frame.rig.core_camera))
    except BeltscapeError as error:
        raise InputError(f"{path}: {error}; give an image of the core camera {frame.rig.core}") from error


def make_features_document(measured: MeasuredModule) -> Mapping[str, Any]:
    """Return the result of ``measure features --json``."""
    pose = measured.core_from_module
    return {
        "module": measured.module.name,
        "features": [
            {
                "name": q.name,
                "quantity": q.quantity,
                "nominal_mm": q.nominal_mm,
                "measured_mm": q.measured_mm,
                "sigma_mm": q.sigma_mm,
                "points": q.points,
            }
            for q in measured.quantities
        ],
        "pose": {
            "core_from_module": {"rotation": pose.rotation, "translation_mm": pose.translation_mm},
            "agreement": measured.agreement,
        },
        "solids": make_solids_document(measured),
        "warnings": list(measured.warnings),
    }


def write_features(out: Path, frame: FrameResult, measured: MeasuredModule) -> None:
    """Write features.json, features.csv and report.html."""
    ensure_output_folder(out)
    write_json(out / "features.json", make_features_document(measured))
    write_text(out / "features.csv", format_features_csv(measured))
    write_text(
        out / "report.html", render_features_page(frame.depth, frame.rig.core_camera, frame.image, measured)
    )


def format_features_csv(measured: MeasuredModule) -> str:
    """Return a CSV with one row per quantity; values that were not measured are empty."""
    rows = ["name,quantity,nominal_mm,measured_mm,error_mm,sigma_mm,points"]
    for q in measured.quantities:
        error = q.measured_mm - q.nominal_mm
        values = ["" if np.isnan(v) else f"{v:.5f}" for v in (q.measured_mm, error, q.sigma_mm)]
        rows.append(
            ",".join([f'"{q.name}"' if "," in q.name else q.name, q.quantity, f"{q.nominal_mm:g}", *values])
        )
        rows[-1] += f",{q.points}"
    return "\n".join(rows) + "\n"
