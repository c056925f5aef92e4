"""Measurement of the lumps in a reconstructed frame or on the fused belt of a flow, with their files and report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import Image
from beltscape.core.height_map import HeightMap
from beltscape.core.progress import Reporter, Silent
from beltscape.files.atomic import ensure_output_folder, write_text
from beltscape.files.fused_belt import holds_fused_belt, read_fused_belt
from beltscape.files.images import write_image
from beltscape.files.json_text import write_json
from beltscape.files.ply import image_from_cloud
from beltscape.files.reconstruction import FrameResult, read_frame
from beltscape.measure.lumps.fused_belt import measure_belt_lumps
from beltscape.measure.lumps.lumps import BIAS, FUSED_BELT, Lumps, SizeDistribution, measure_lumps
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.pipeline.measuring.belt import read_empty_belt, require_same_camera
from beltscape.report.measuring.lumps import render_lumps_page

_SHARES = ("d10", "d50", "d80", "d90")
_COLUMNS = (
    "number",
    "x_mm",
    "y_mm",
    "z_mm",
    "size_mm",
    "sigma_mm",
    "width_mm",
    "length_mm",
    "area_mm2",
    "height_mm",
    "volume_mm3",
    "hidden",
    "occluded",
    "cut",
)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLumps:
    """The lumps of a frame or of a fused belt."""

    lumps: Lumps
    surface: DepthMap | HeightMap
    """On which they were measured."""
    frame: FrameResult | None = None
    """None: of a fused belt."""
    picture: Image | None = None
    """(H, W, 3) RGB on the core's grid, from the frame's cloud; None without a cloud."""


def measure_lumps_of_folder(
    loaded: Path, settings: LumpSettings, *, empty: Path | None, reporter: Reporter | None = None
) -> MeasuredLumps:
    """Measure the lumps of a frame folder of beltscape reconstruct, or of a flow of beltscape measure flow.

    Lumps of a frame lie above the ``empty`` belt if it is given: a frame folder, a whole reconstruction of the empty
    belt, or its belt.json. A flow's heights are over it already.

    Raises
    ------
    InputError, MeasureError
        With one line that names the fault and the fix.
    """
    if holds_fused_belt(loaded):
        return _measure_lumps_of_flow(loaded, settings, empty, reporter or Silent())
    frame = read_frame(loaded)
    camera = frame.rig.core_camera
    belt = None
    if empty is not None:
        belt, other = read_empty_belt(empty, reporter or Silent())
        require_same_camera(loaded, camera, empty, other)
    lumps = measure_lumps(frame.depth, camera, settings, belt)
    picture = image_from_cloud(frame.folder / "cloud.ply", frame.depth.measured)
    return MeasuredLumps(lumps, frame.depth, frame, picture)


_COARSE = 1.5
"""Edge of the fused belt's cells, in pixels, from which on a finer belt is advised: with cells of three pixels 29 %
of the rocks of a simulated heap are found, of two 52 %, of one 73 %."""


def _measure_lumps_of_flow(
    folder: Path, settings: LumpSettings, empty: Path | None, reporter: Reporter
) -> MeasuredLumps:
    if empty is not None:
        raise InputError(
            f"--empty {empty}: the heights of {folder} are over the empty belt already; leave it out"
        )
    fused = read_fused_belt(folder)
    cell, finest = fused.heights.cell_mm, fused.finest_cell_mm
    if finest and cell > _COARSE * finest:
        reporter.warn(
            f"{folder}: its cells of {cell:.1f} mm hide lumps below {settings.smallest_px * cell:.0f} mm; measure "
            f"the flow with --belt-cell {finest:.2g}"
        )
    lumps = measure_belt_lumps(fused.heights, fused.measured, settings, fused.counted_mm)
    return MeasuredLumps(lumps, fused.heights)


def make_lumps_document(lumps: Lumps) -> Mapping[str, Any]:
    """Return the result of ``measure lumps --json``."""
    alarm = lumps.oversize
    return {
        "frame": lumps.frame,
        "lumps": [asdict(lump) for lump in lumps.lumps],
        "smallest_mm": lumps.smallest_mm,
        "cell_mm": lumps.cell_mm,
        "fines_share": lumps.fines_share,
        "distribution": _make_distribution_document(lumps.all),
        "distribution_fully_visible": _make_distribution_document(lumps.whole),
        "bias": BIAS,
        "oversize": None
        if alarm is None
        else {
            "limit_mm": alarm.limit_mm,
            "oversize": alarm.alarm,
            "probability": alarm.probability,
            "lumps": [{"number": number, "probability": chance} for number, chance in alarm.lumps],
        },
    }


def _make_distribution_document(sizes: SizeDistribution) -> dict[str, Any]:
    values = zip(_SHARES, sizes.d_mm, sizes.d_sigma_mm, strict=True)
    return {
        "count": sizes.count,
        **{f"{name}{end}": value for name, d, s in values for end, value in (("_mm", d), ("_sigma_mm", s))},
        "sieves_mm": sizes.sieves_mm,
        "passing": sizes.passing,
    }


def write_lumps(out: Path, measured: MeasuredLumps) -> None:
    """Write lumps.json, lumps.csv, sieve.csv, labels.png (16 bit, on the surface's grid) and report.html."""
    ensure_output_folder(out)
    write_image(out / "labels.png", measured.lumps.labels)
    write_json(out / "lumps.json", make_lumps_document(measured.lumps))
    write_text(out / "lumps.csv", format_lumps_csv(measured.lumps))
    write_text(out / "sieve.csv", format_sieve_csv(measured.lumps))
    write_text(out / "report.html", render_lumps_page(measured.lumps, measured.surface, measured.picture))


def format_lumps_csv(lumps: Lumps) -> str:
    """Return a CSV with one row per lump; on a fused belt ``s_mm``, the position along it, is in the place of y."""
    on_belt = lumps.frame == FUSED_BELT
    rows: list[str] = [",".join("s_mm" if on_belt and name == "y_mm" else name for name in _COLUMNS)]
    for lump in lumps.lumps:
        x, y, z = lump.center_mm
        values = {**asdict(lump), "x_mm": x, "y_mm": y, "z_mm": z}
        rows.append(",".join(_format_cell(values[name]) for name in _COLUMNS))
    return "\n".join(rows) + "\n"


def _format_cell(value: float | int | bool) -> str:
    return (
        f"{value:.4g}"
        if isinstance(value, float) and abs(value) < 1
        else f"{value:.2f}"
        if isinstance(value, float)
        else str(int(value))
    )


def format_sieve_csv(lumps: Lumps) -> str:
    """Return the CSV ``sieve_mm,passing,passing_fully_visible``: shares of the mass, 0..1; empty without lumps."""
    rows = ["sieve_mm,passing,passing_fully_visible"]
    for sieve, share, whole in zip(lumps.all.sieves_mm, lumps.all.passing, lumps.whole.passing, strict=True):
        parts = (f"{value:.4f}" if np.isfinite(value) else "" for value in (share, whole))
        rows.append(f"{sieve:g}," + ",".join(parts))
    return "\n".join(rows) + "\n"
