"""The parts of a run that belong to one rig and one empty belt, made anew for a restart or between two records.

Among them are the monitors of the images, with what earlier runs of the same system learned.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.core.progress import Reporter
from beltscape.files.exposures_csv import FILE as EXPOSURES
from beltscape.files.json_text import hash_file
from beltscape.files.rig_json import read_rig
from beltscape.health.images.belt_images import BeltImageMonitor
from beltscape.health.images.monitor import ImageMonitor
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.belt.settings import NOTHING_GIVEN
from beltscape.measure.volume.load import compute_capacity_mm2
from beltscape.pipeline.live import learned_images, zero
from beltscape.pipeline.live.drift import DriftMonitor
from beltscape.pipeline.live.engine_components import MeasuringParts, PeriodicInspector
from beltscape.pipeline.live.learned_images import LearnedImages
from beltscape.pipeline.live.measurement_run import MeasurementContext
from beltscape.pipeline.live.project import Project, RunSettings, read_density
from beltscape.pipeline.measuring.belt import describe_measured_by, hash_empty_belt
from beltscape.pipeline.measuring.flow_chain import compute_depth_range, read_reference
from beltscape.pipeline.reconstructing.camera_checks import make_rig_writer
from beltscape.pipeline.reconstructing.checked_matcher import make_sequence_matcher
from beltscape.pipeline.reconstructing.match_ahead import LiveWorkers, MatcherFactory
from beltscape.pipeline.reconstructing.monitored_matcher import MonitoredMatcher
from beltscape.sources.folder import scale_rig_to_capture
from beltscape.workers.calls import CallMaker

TABLES = ("belt", "matching", "flow", "density", "watch", "health")
"""Tables of project.toml on which the parts depend, beside rig and empty belt."""


def describe_provenance(project: Project[RunSettings]) -> dict[str, str]:
    """Return what a run measures by: the program's version, and SHA-256 of rig, empty belt, networks and settings.

    Raises
    ------
    InputError
        If one of the files cannot be read.
    """
    settings, density = project.settings, project.settings.density
    used = {name for name in TABLES if name != "belt" or settings.belt != NOTHING_GIVEN}
    tables = settings.model_dump(mode="json", include=set[str](used))
    files = [project.resolve(path) for path in (density.table, density.products) if path is not None]
    try:
        texts = [json.dumps(tables, sort_keys=True), *(hash_file(path) for path in files)]
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read ({error.strerror})") from error
    measured_by = describe_measured_by(project.resolve(settings.rig), project.resolve(settings.empty))
    return {**measured_by, "settings": hashlib.sha256("".join(texts).encode()).hexdigest()}


def read_run_rig(project: Project[RunSettings], reporter: Reporter) -> Rig:
    """Return the project's rig at the size of the images: of the cameras, or of the recorded capture."""
    rig, capture = read_rig(project.resolve(project.settings.rig)), project.settings.capture
    return rig if capture is None else scale_rig_to_capture(rig, project.resolve(capture.folder), reporter)


def require_same_cameras(project: Project[RunSettings], rig: Rig, present: Rig) -> None:
    """Raise InputError unless a rig has the cameras that the run has open, with the same image sizes."""
    path, fix = project.resolve(project.settings.rig), "the run's cameras change by a restart only"
    if rig.core != present.core:
        raise InputError(f"{path}: its core camera is {rig.core}, the run's is {present.core}; {fix}")
    if set(rig.cameras) != set(present.cameras):
        names, others = ", ".join(rig.cameras), ", ".join(present.cameras)
        raise InputError(f"{path}: has the cameras {names}, the run has {others}; {fix}")
    for name, camera in rig.cameras.items():
        size, other = tuple(camera.size_px), tuple(present.cameras[name].size_px)
        if size != other:
            raise InputError(f"{path}: {name} has {size} px, in the run {other}; {fix}")


def make_measuring_parts(
    project: Project[RunSettings],
    rig: Rig,
    reporter: Reporter,
    data: Path,
    workers: LiveWorkers | None = None,
) -> MeasuringParts:
    """Return the parts for a rig at the size of the images; ``data`` is the folder of what is learned and set.

    ``workers`` match its frame sets side by side; None: this process matches them one after the other.

    Raises
    ------
    InputError, SettingsError, MeasureError
        With one line that names the fault and the fix.
    """
    settings, watch = project.settings, project.settings.watch
    drift = _make_drift_monitor(project, rig)
    context = build_context(project, rig, reporter, data, workers, drift)
    learned, digest, path = context.empty_belt, context.empty_belt_sha256, data / zero.FILE
    present = zero.read_zero(path, learned, digest, reporter)
    belt, camera = present.belt, context.rig.core_camera
    return MeasuringParts(
        context=context.with_empty_belt(present),
        rig=rig,
        provenance=describe_provenance(project),
        drift=drift,
        inspector=PeriodicInspector(belt, camera, watch.lumps_every_s, watch.edges_every_s),
        zero=zero.ZeroControl(learned, settings.health.belt, path, digest),
        full_area_mm2=compute_capacity_mm2(belt, float(np.deg2rad(watch.surcharge_deg))),
        stale_s=watch.stale_s,
    )


def _make_drift_monitor(project: Project[RunSettings], rig: Rig) -> DriftMonitor | None:
    watch = project.settings.watch
    if not watch.drift_every_s:
        return None
    return DriftMonitor(
        scale_to_matching(project, rig),
        hash_file(project.resolve(project.settings.rig)),
        every_s=watch.drift_every_s,
        frames=watch.drift_frames,
    )


def scale_to_matching(project: Project[RunSettings], rig: Rig) -> Rig:
    """Return the rig at the size of the images that are matched."""
    width_px, width = project.settings.matching.width_px, rig.core_camera.size_px[0]
    return rig if width_px is None or width_px >= width else scale_rig(rig, width_px / width)


def build_context(
    project: Project[RunSettings],
    rig: Rig,
    reporter: Reporter,
    data: Path | None = None,
    workers: LiveWorkers | None = None,
    drift: DriftMonitor | None = None,
) -> MeasurementContext:
    """Return rig, empty belt and matcher for the settings' image width; ``workers`` match ahead, where given.

    ``drift`` sees the tie points of sound frames.

    ``data`` is the folder for the rig with the estimated pose of a camera that moved, and for what is learned of the
    images; None: nothing is read or kept.
    """
    settings, matching = project.settings, project.settings.matching
    propose_rig = None if data is None else make_rig_writer(data, rig, reporter)
    width = rig.core_camera.size_px[0]
    if matching.width_px is not None and matching.width_px > width:
        raise InputError(
            f"{project.path}: matching.width_px = {matching.width_px}: the images are {width} px wide; give less, or "
            "leave it out for their full size"
        )
    rig = scale_to_matching(project, rig)
    empty, cell_mm = project.resolve(settings.empty), settings.flow.cell_mm
    empty_belt = read_reference(empty, rig, cell_mm, reporter, settings.belt)
    near_far = compute_depth_range(empty_belt, matching.load_mm)
    watch = None if drift is None else drift.add
    matcher = make_sequence_matcher(
        rig, tuple(rig.cameras), near_far, matching.multiview(), propose_rig, watch
    )
    digest = hash_empty_belt(project.resolve(settings.empty))
    calls = None if workers is None else workers.calls
    monitor, images, learned = make_image_monitors(project, rig, empty_belt, digest, reporter, data, calls)
    matcher = MonitoredMatcher(matcher, monitor)
    density, limits = read_density(project), settings.health.belt
    factory = MatcherFactory(rig, near_far, matching.multiview())
    submit = None if workers is None else workers.make_submit(matcher, factory, reporter)
    return MeasurementContext(
        rig,
        empty_belt,
        matcher,
        settings.flow,
        density,
        limits,
        images,
        digest,
        learned,
        submit,
        calls,
    )


Monitors = tuple[ImageMonitor, BeltImageMonitor, LearnedImages]
"""The monitor of the images by themselves, that of the images against the measured belt, and what both learn."""


def make_image_monitors(
    project: Project[RunSettings],
    rig: Rig,
    empty_belt: EmptyBeltReference,
    belt_sha256: str,
    reporter: Reporter,
    data: Path | None,
    calls: CallMaker | None = None,
) -> Monitors:
    """Return the monitors; ``data`` is the folder of what is learned, None: nothing is read or kept.

    ``calls`` compares frames beside the thread that measures.
    """
    health = project.settings.health
    if data is None or not health.learning:
        belt_images = BeltImageMonitor(rig, empty_belt, health, calls=calls)
        return ImageMonitor(rig, health), belt_images, LearnedImages()
    key = {
        "rig": hash_file(project.resolve(project.settings.rig)),
        "empty belt": belt_sha256,
        "image width": rig.core_camera.size_px[0],
        **_describe_exposure(project),
    }
    path = data / learned_images.REFERENCES_FILE
    learned = learned_images.read_references(path, key, reporter)
    if learned is not None and not set(rig.cameras) <= set(learned.reference.cameras):
        learned = None  # a camera was missing when they were learned
    keep = learned_images.make_references_keeper(path, key, reporter)
    pattern_path = data / learned_images.PATTERN_FILE
    pattern = learned_images.read_pattern(pattern_path, key, reporter)
    keep_pattern = learned_images.make_pattern_keeper(pattern_path, key, reporter)
    images = ImageMonitor(rig, health, learned, keep)
    belt_images = BeltImageMonitor(rig, empty_belt, health, pattern, keep_pattern, calls)
    return images, belt_images, LearnedImages((images, belt_images), (path, pattern_path))


def _describe_exposure(project: Project[RunSettings]) -> dict[str, Any]:
    """Return what makes the levels of images comparable beside their stated exposure times."""
    cameras, capture = project.settings.cameras, project.settings.capture
    if cameras is None:
        is_stated = capture is not None and (project.resolve(capture.folder) / EXPOSURES).is_file()
        return {"stated exposure": is_stated}
    gains = {name: cameras.gain_of(name) for name in cameras.devices}
    return {"stated exposure": bool(cameras.exposures_us), "gain": gains}
