"""Measurement of the volume in a loaded frame over the empty belt, with its files and report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.progress import Reporter, Silent
from beltscape.files.atomic import ensure_output_folder, write_text
from beltscape.files.json_text import write_json
from beltscape.files.reconstruction import read_frame
from beltscape.files.stl import write_stl
from beltscape.files.tiff import write_height_tiff
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.solid import build_load_mesh, build_surface_mesh
from beltscape.measure.volume.volume import Volume, measure_volume
from beltscape.pipeline.measuring.belt import read_empty_belt, require_same_camera, warn_of_camera_faults
from beltscape.report.measuring.volume import render_volume_page

LEAST_COVERAGE = 0.5
"""Below this coverage a volume is mostly interpolated, and a warning is given."""


def measure_volume_of_frames(
    loaded: Path,
    empty: Path,
    settings: VolumeSettings,
    *,
    across_mm: tuple[float, float] | None,
    along_mm: tuple[float, float] | None,
    reporter: Reporter | None = None,
) -> Volume:
    """Measure the volume between a frame folder of beltscape reconstruct and the empty belt.

    ``empty`` is a frame folder, a whole reconstruction of the empty belt, or its belt.json.

    Raises
    ------
    InputError, MeasureError
        With one line that names the fault and the fix.
    """
    reporter = reporter or Silent()
    frame = read_frame(loaded)
    warn_of_camera_faults(frame, reporter)
    belt, camera = read_empty_belt(empty, reporter)
    require_same_camera(loaded, frame.rig.core_camera, empty, camera)
    volume = measure_volume(
        frame.depth,
        belt,
        frame.rig.core_camera,
        settings,
        across_mm=across_mm,
        along_mm=along_mm,
        scale_sigma=frame.rig.scale_sigma,
    )
    _warn_of_gaps(loaded, volume, reporter)
    return volume


_MUCH_UNSEEN = 0.7
"""Share of σ from which on the belt beside the box is named: it is as much as all other causes together."""


def _warn_of_gaps(loaded: Path, volume: Volume, reporter: Reporter) -> None:
    """Warn if the box contains only a part of the belt, or little of it was measured."""
    if volume.causes.unseen_mm3 > _MUCH_UNSEEN * volume.sigma_mm3:
        low, high = volume.across_mm
        near, far = volume.along_mm
        reporter.warn(
            f"{loaded}: the load is not bounded by what was measured: the box takes {high - low:.0f} mm of the "
            f"belt's width and {far - near:.0f} mm along it; σ holds what the rest may carry; see why the frame is "
            "sparse, whether the load rises out of the view or leaves the light, or give a box with --across and "
            "--along"
        )
    if not np.isfinite(volume.fullness.level):
        low, high = volume.belt.across_mm
        reporter.warn(
            f"{loaded}: the fill level is unknown: the empty belt's shape from x {low:.0f} to {high:.0f} mm holds no "
            "load; learn it again with beltscape measure belt --width MM"
        )
    if volume.coverage < LEAST_COVERAGE:
        reporter.warn(
            f"{loaded}: only {volume.coverage:.0%} of the box was measured, the rest is interpolated; see why "
            "the frame is sparse"
        )


def make_volume_document(volume: Volume) -> Mapping[str, Any]:
    """Return the result of ``measure volume --json``."""
    belt, centre, summit = volume.belt, volume.centre, volume.summit
    return {
        "volume_mm3": volume.volume_mm3,
        "sigma_mm3": volume.sigma_mm3,
        "coverage": volume.coverage,
        "across_mm": volume.across_mm,
        "along_mm": volume.along_mm,
        "belt": {
            "belt_from_core": {
                "rotation": belt.belt_from_core.rotation,
                "translation_mm": belt.belt_from_core.translation_mm,
            },
        },
        "profiles": [
            {"y_mm": profile.y_mm, "area_mm2": profile.area_mm2, "coverage": profile.coverage}
            for profile in volume.profiles
        ],
        "sigma_from_mm3": {
            "noise": volume.causes.noise_mm3,
            "belt": volume.causes.belt_mm3,
            "holes": volume.causes.holes_mm3,
            "edges": volume.causes.edges_mm3,
            "drift": volume.causes.drift_mm3,
            "false_depths": volume.causes.false_depths_mm3,
            "scale": volume.causes.scale_mm3,
            "unseen": volume.causes.unseen_mm3,
        },
        "centre_of_gravity": centre
        and {
            "place_mm": centre.position_mm,
            "sigma_mm": centre.sigma_mm,
            "off_middle_mm": centre.off_middle_mm,
            "off_middle_sigma_mm": centre.off_middle_sigma_mm,
        },
        "fill": {
            "area_mm2": volume.fullness.area_mm2,
            "capacity_mm2": volume.fullness.capacity_mm2,
            "level": volume.fullness.level if np.isfinite(volume.fullness.level) else None,
            "whole_belt_seen": volume.fullness.whole_belt,
        },
        "highest": summit
        and {"height_mm": summit.height_mm, "sigma_mm": summit.sigma_mm, "place_mm": summit.position_mm},
    }


def write_volume(out: Path, volume: Volume) -> None:
    """Write volume.json, report.html, and the load as maps, meshes and tables.

    load.tiff and load_sigma.tiff are georeferenced in the belt frame, mm; surface.stl is the load's surface, load.stl
    the closed body between it and the belt; profiles.csv and areas.csv contain the cross-sections.
    """
    ensure_output_folder(out)
    load = volume.load
    write_height_tiff(out / "load.tiff", load)
    write_height_tiff(out / "load_sigma.tiff", load, sigma=True)
    first = (load.origin_mm[0], float(load.y_mm[-1]))
    grid = {"origin_mm": first, "cell_mm": load.cell_mm, "rows": "along -y", "columns": "along x"}
    write_json(out / "volume.json", {**make_volume_document(volume), "load_grid": grid})
    for name, mesh in (("surface.stl", build_surface_mesh(volume)), ("load.stl", build_load_mesh(volume))):
        write_stl(out / name, mesh.vertices_mm, mesh.faces)
    write_text(out / "profiles.csv", format_profiles_csv(volume))
    write_text(out / "areas.csv", format_areas_csv(volume))
    write_text(out / "report.html", render_volume_page(volume, warnings=()))


def format_areas_csv(volume: Volume) -> str:
    """Return a CSV with one row per cross-section: ``y_mm,area_mm2,coverage``."""
    rows = ["y_mm,area_mm2,coverage"]
    rows += [f"{p.y_mm:.3f},{p.area_mm2:.3f},{p.coverage:.4f}" for p in volume.profiles]
    return "\n".join(rows) + "\n"


def format_profiles_csv(volume: Volume) -> str:
    """Return a CSV with one row per point of every cross-section: ``y_mm,x_mm,height_mm``."""
    rows = ["y_mm,x_mm,height_mm"]
    for profile in volume.profiles:
        for x, height in zip(profile.x_mm, profile.height_mm, strict=True):
            rows.append(f"{profile.y_mm:.3f},{x:.3f},{height:.4f}")
    return "\n".join(rows) + "\n"
