"""Two reconstructed frames → volume, height map, profiles, report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.rig import Rig
from beltscape.files.atomic import output_folder, write_text
from beltscape.files.depth_tiff import write_float_tiff
from beltscape.files.json_text import write_json
from beltscape.files.reconstruction import read_frame
from beltscape.measure.settings import VolumeSettings
from beltscape.measure.volume import Volume, measure_volume
from beltscape.report.volume import volume_page


def volume_of_frames(
    loaded: Path,
    empty: Path,
    settings: VolumeSettings,
    *,
    across_mm: tuple[float, float] | None,
    along_mm: tuple[float, float] | None,
) -> Volume:
    """Volume between two frame folders of beltscape reconstruct.

    Raises
    ------
    InputError, MeasureError
        With one line that names what is wrong and the mend.
    """
    full, bare = read_frame(loaded), read_frame(empty)
    if not _same_view(full.rig, bare.rig):
        raise InputError(
            f"{loaded} and {empty}: reconstructed with different rigs; reconstruct both with the same rig.json"
        )
    return measure_volume(
        full.depth, bare.depth, full.rig.core_camera, settings, across_mm=across_mm, along_mm=along_mm
    )


def _same_view(first: Rig, second: Rig) -> bool:
    a, b = first.core_camera, second.core_camera
    return (
        first.core == second.core
        and a.size_px == b.size_px
        and np.allclose(a.focal_px, b.focal_px, rtol=1e-9)
        and np.allclose(a.center_px, b.center_px, atol=1e-6)
    )


def volume_document(volume: Volume) -> Mapping[str, Any]:
    """What ``measure volume --json`` answers."""
    belt = volume.belt
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
    }


def write_volume(out: Path, volume: Volume) -> None:
    """volume.json, load.tiff and load_sigma.tiff (mm, with the grid in volume.json), profiles.csv, report.html."""
    output_folder(out)
    load = volume.load
    write_float_tiff(out / "load.tiff", load.height_mm.astype(np.float32))
    write_float_tiff(out / "load_sigma.tiff", load.sigma_mm.astype(np.float32))
    grid = {"origin_mm": load.origin_mm, "cell_mm": load.cell_mm, "rows": "along y", "columns": "along x"}
    write_json(out / "volume.json", {**volume_document(volume), "load_grid": grid})
    write_text(out / "profiles.csv", profiles_csv(volume))
    write_text(out / "report.html", volume_page(volume, warnings=()))


def profiles_csv(volume: Volume) -> str:
    """One row per point of every cross-section: ``y_mm,x_mm,height_mm``."""
    rows = ["y_mm,x_mm,height_mm"]
    for profile in volume.profiles:
        for x, height in zip(profile.x_mm, profile.height_mm, strict=True):
            rows.append(f"{profile.y_mm:.3f},{x:.3f},{height:.4f}")
    return "\n".join(rows) + "\n"
