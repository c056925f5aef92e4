"""The evaluation of a material test's file: runs from the plant's history or from results of `measure flow`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.files.json_text import hash_file
from beltscape.files.toml_text import read_toml, validate
from beltscape.metrology.certificate import APPLIES
from beltscape.metrology.document import make_test_document
from beltscape.metrology.material_test import MaterialTest, evaluate_material_test
from beltscape.metrology.observations import (
    ObservedRuns,
    ReferenceKind,
    ReferenceRun,
    ReferenceStandard,
    Sample,
    ZeroTest,
    evaluate_zero,
)
from beltscape.metrology.settings import (
    MaterialTestSettings,
    ReferenceRunSettings,
    ZeroTestSettings,
)
from beltscape.pipeline.certifying.stretches import MeasuredStretch, read_stretch
from beltscape.pipeline.live.measuring_parts import describe_provenance
from beltscape.pipeline.live.project import Project, RunSettings
from beltscape.report.metrology.pictures import LoadPicture, read_load_picture

_TURN_TOLERANCE = 0.02
"""Largest relative difference of the zero's belt from whole revolutions. Chosen: belts are given to a percent."""


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedTest:
    """A material test with its document and its pictures."""

    test: MaterialTest
    document: Mapping[str, Any]
    """With what it applies to, under ``applies``."""
    pictures: tuple[LoadPicture, ...]


def read_test_settings(path: Path) -> MaterialTestSettings:
    """Return the settings of a material test's file; InputError with one line where they do not fit."""
    return validate(path, MaterialTestSettings, _write_times(read_toml(path)))


def _write_times(value: Any) -> Any:
    """Return a value of TOML with its times as texts; those without an offset stay without one, and are refused."""
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, dict):
        return {key: _write_times(one) for key, one in value.items()}  # pyrefly: ignore
    if isinstance(value, list):
        return [_write_times(one) for one in value]  # pyrefly: ignore
    return value


def evaluate_test_file(path: Path, project: Project[RunSettings], reporter: Reporter) -> EvaluatedTest:
    """Return the evaluation of a material test of a project's plant.

    Raises
    ------
    InputError, MeasureError
        One line that names the file, the run and the fix.
    """
    return evaluate_test(read_test_settings(path), path, project, reporter)


def evaluate_test(
    settings: MaterialTestSettings, path: Path, project: Project[RunSettings], reporter: Reporter
) -> EvaluatedTest:
    """Return the evaluation of settings; ``path`` is their file, for its folder and for messages."""
    data, present = project.resolve(project.settings.data), describe_provenance(project)
    stretches: list[MeasuredStretch] = []
    for number, run in enumerate(settings.runs, 1):
        where = f"{path}: [[runs]] {number} ({run.load})"
        stretches.append(read_stretch(run, path.parent, data, where))
        _require_present(stretches[-1], present, where)
        _warn_of_stretch(stretches[-1], where, reporter)
        reporter.step("reading runs", number, len(settings.runs))
    runs = tuple(_make_run(run, one) for run, one in zip(settings.runs, stretches, strict=True))
    observed = ObservedRuns(
        runs,
        _list_references(settings),
        None if settings.zero is None else _read_zero(settings, settings.zero, path, project, present),
        _list_samples(settings),
        tuple(one.to_effect() for one in settings.effects),
        settings.confidence,
    )
    test = evaluate_material_test(observed)
    pictures = tuple(_list_pictures(settings, path.parent, reporter))
    document = make_test_document(test, settings, [_describe_source(one) for one in stretches])
    return EvaluatedTest(test, {**document, "applies": _join_applies(stretches, present)}, pictures)


def _make_run(settings: ReferenceRunSettings, stretch: MeasuredStretch) -> ReferenceRun:
    kind: ReferenceKind = "volume" if settings.mass_kg is None else "mass"
    return ReferenceRun(
        load=settings.load,
        kind=kind,
        reference=settings.mass_kg or settings.volume_m3 or math.nan,
        volume_m3=stretch.volume_m3,
        length_m=stretch.length_m,
        own_sigma_m3=stretch.own_sigma_m3,
        level=_find_level(stretch),
        recorded_kg=stretch.recorded_kg if kind == "mass" else math.nan,
        label=settings.ticket,
    )


def _find_level(stretch: MeasuredStretch) -> float:
    """Return what tells loads apart: the mean flow, or without times the mean cross-section in mm²."""
    if math.isfinite(stretch.level_m3_h):
        return stretch.level_m3_h
    return stretch.volume_m3 / stretch.length_m * 1e6


def _require_present(stretch: MeasuredStretch, present: Mapping[str, str], where: str) -> None:
    """Raise InputError unless a run was measured by what the plant measures by now."""
    changed = [part for part in APPLIES if stretch.provenance.get(part, present[part]) != present[part]]
    if changed:
        raise InputError(
            f"{where}: was measured with another {', '.join(changed)} than the project has now; a certificate would "
            "not apply to it: repeat the run, or give the project of then"
        )


def _warn_of_stretch(stretch: MeasuredStretch, where: str, reporter: Reporter) -> None:
    for end in stretch.loaded_ends:
        reporter.warn(f"{where}: material lay on the belt at its {end}; begin and end a run on empty belt")
    if stretch.degraded_share > 0:
        reporter.warn(
            f"{where}: {100 * stretch.degraded_share:.1f} % of its belt was measured with less certainty"
        )


def _list_references(settings: MaterialTestSettings) -> dict[ReferenceKind, ReferenceStandard]:
    return {
        "mass": settings.reference.to_reference(),
        "volume": settings.volume_reference.to_reference(),
    }


def _list_samples(
    settings: MaterialTestSettings,
) -> dict[Literal["density", "dry_density", "moisture"], Sample]:
    samples: dict[Literal["density", "dry_density", "moisture"], Sample] = {}
    if settings.density is not None:
        samples["density"] = settings.density.to_sample()
    if settings.dry_density is not None:
        samples["dry_density"] = settings.dry_density.to_sample()
    if settings.moisture is not None:
        samples["moisture"] = settings.moisture.to_sample()
    return samples


def _read_zero(
    settings: MaterialTestSettings,
    zero: ZeroTestSettings,
    path: Path,
    project: Project[RunSettings],
    present: Mapping[str, str],
) -> ZeroTest:
    """Return the zero by revolutions of the empty belt; InputError if its stretch holds no whole ones."""
    where = f"{path}: [zero]"
    stretch = read_stretch(zero, path.parent, project.resolve(project.settings.data), where)
    _require_present(stretch, present, where)
    length_m = settings.belt_length_m or project.settings.health.belt.belt_length_m
    if length_m is None:
        raise InputError(f"{path}: belt_length_m is missing; [zero] needs the length of the endless belt")
    revolutions = stretch.length_m / length_m
    if abs(revolutions / zero.revolutions - 1) > _TURN_TOLERANCE:
        raise InputError(
            f"{where}: {stretch.length_m:.1f} m passed, which is {revolutions:.2f} revolutions of {length_m:g} m, "
            f"not {zero.revolutions}; correct begin and end, revolutions or belt_length_m"
        )
    own = math.sqrt(float(stretch.pieces[:, 3].sum())) / (1000 * stretch.length_m)
    return evaluate_zero(stretch.split(zero.revolutions), own)


def _describe_source(stretch: MeasuredStretch) -> dict[str, Any]:
    return {
        "source": stretch.source,
        "since_ms": None if stretch.since_ns is None else stretch.since_ns // 1_000_000,
        "until_ms": None if stretch.until_ns is None else stretch.until_ns // 1_000_000,
        "degraded_percent": 100 * stretch.degraded_share,
    }


def _join_applies(stretches: Sequence[MeasuredStretch], present: Mapping[str, str]) -> dict[str, str]:
    """Return what a certificate applies to: the parts of the provenance that every run recorded."""
    return {part: present[part] for part in APPLIES if all(part in one.provenance for one in stretches)}


def _list_pictures(settings: MaterialTestSettings, folder: Path, reporter: Reporter) -> Sequence[LoadPicture]:
    """Return a picture of each load: of its first run that has one."""
    found: dict[str, LoadPicture] = {}
    for run in settings.runs:
        given = folder / run.picture if run.picture is not None else None
        source = given or (None if run.flow is None else folder / run.flow / "belt.tiff")
        if run.load in found or source is None:
            continue
        try:
            found[run.load] = read_load_picture(source, run.load, hash_file(source))
        except (InputError, OSError) as error:
            reporter.warn(f"{source}: no picture of the load {run.load} ({error})")
    return list(found.values())
