"""Setting of the empty belt's zero from a reconstruction of the empty running belt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.files.atomic import write_text
from beltscape.files.belt_json import read_belt, read_zero_settings, write_belt
from beltscape.health.belt.zero_setting import ZeroSetting, zero_offset
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import make_reference
from beltscape.pipeline.measuring.belt import list_frame_names, read_intact_frame, warn_of_camera_faults


def set_zero(
    folder: Path,
    empty: Path,
    frames: Sequence[str] | None,
    limits: BeltLimits,
    reporter: Reporter,
) -> ZeroSetting:
    """Return the zero of ``empty`` (a belt.json) moved to the belt in a reconstruction's frames (default: all).

    Raises
    ------
    InputError, MeasureError
        With one line that names the fault and the fix; also if the motion exceeds the limit.
    """
    if not empty.is_file():
        raise InputError(f"{empty}: no such file; give the belt.json whose zero is to be set")
    belt, learned = read_belt(empty)
    results = [read_intact_frame(folder / name) for name in frames or list_frame_names(folder)]
    for result in results:
        warn_of_camera_faults(result, reporter)
    camera = results[0].rig.core_camera
    if camera.name != learned.name:
        raise InputError(f"{folder}: its core camera is {camera.name}, that of {empty} is {learned.name}")
    return zero_offset([result.depth for result in results], make_reference(belt, camera), limits)


def write_zero_files(out: Path, empty: Path, setting: ZeroSetting) -> Path:
    """Write the belt.json with the new zero and its report; return the report's path.

    The list ``zero_settings`` of ``empty`` is continued: each entry holds time, rise, σ and tilt.
    """
    from beltscape.report.measuring.belt import render_belt_page

    entry = {"at": datetime.now(UTC).isoformat(timespec="seconds"), **make_zero_document(setting)}
    belt = setting.reference.belt
    write_belt(out, belt, read_belt(empty)[1], [*read_zero_settings(empty), entry])
    page = out.with_suffix(".html")
    write_text(page, render_belt_page(belt))
    return page


def make_zero_document(setting: ZeroSetting) -> Mapping[str, Any]:
    """Return the result of ``measure zero --json``."""
    return {
        "offset_mm": setting.offset_mm,
        "offset_sigma_mm": setting.sigma_mm,
        "tilt_mm": setting.tilt_mm,
        "frames": setting.frames,
    }
