"""Reconstruction of a capture: a depth map and its files for every frame."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError, ReconstructionError, SettingsError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.atomic import ensure_output_folder
from beltscape.files.capture import read_capture
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.reconstruction import write_reconstruction
from beltscape.files.rig_limits import find_oddities
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.pipeline.reconstructing.camera_checks import make_rig_writer
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher
from beltscape.pipeline.reconstructing.cloud_export import export_clouds
from beltscape.pipeline.reconstructing.frame_writer import Frame, FrameWriter
from beltscape.pipeline.reconstructing.match_ahead import (
    MatcherFactory,
    choose_threads,
    match_ahead,
    open_threads,
    open_workers,
)
from beltscape.pipeline.reconstructing.pending_match import MatchPool
from beltscape.pipeline.reconstructing.search_range import check_depth_range, find_capture_depth_range
from beltscape.sources.folder import FolderSource, scale_rig_to_capture
from beltscape.stereo.pairwise.reconstructor import find_horizontal_auxiliary
from beltscape.stereo.settings import MultiviewSettings, PairwiseSettings, require_preset
from beltscape.workers.options import HERE, WorkerOptions

METHODS = ("multiview", "pairwise", "binocular")
"""Methods of `reconstruct`: all auxiliaries at once, or the paper's two methods."""


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """The reconstruction that was written."""

    auxiliaries: tuple[str, ...]
    depth_range_mm: tuple[float, float]
    frames: tuple[Mapping[str, Any], ...]
    """The frames' results as plain values for JSON."""
    regions: Path | None
    """The control picture of the projected markers and their regions; None if no markers were detected."""


def reconstruct_capture(
    capture: AnyPath,
    rig: Rig,
    out: AnyPath,
    reporter: Reporter,
    *,
    method: str = "multiview",
    pair: str | None = None,
    preset: str = "standard",
    depth_range_mm: tuple[float, float] | None = None,
    clouds: Sequence[str] = (),
    workers: WorkerOptions = HERE,
) -> Reconstruction:
    """Reconstruct every frame of a capture into ``out``: rig.json, reconstruction.json and a folder per frame.

    The projected markers of the first frame that can be measured are drawn in regions.png. ``clouds`` names the
    formats in which the clouds are written beside cloud.ply. Several ``workers`` match the frames; the checks of the
    cameras and the files are this process's, and the same with any number of workers.

    Raises
    ------
    InputError, SettingsError, ReconstructionError, OutputError
        With one line that names the fault and the fix.
    """
    capture, out = as_path(capture, "capture"), as_path(out, "out")
    wanted = select_auxiliaries(method, rig, pair)
    require_preset(preset)
    rig = scale_rig_to_capture(rig, capture, reporter)
    source = open_capture(capture, rig, reporter)
    auxiliaries = tuple(name for name in wanted if name in source.cameras)
    if not auxiliaries:
        raise InputError(
            f"{capture}: no images of {', '.join(wanted)}; --method binocular needs them (see --pair)"
        )
    ensure_output_folder(out)
    check_depth_range(depth_range_mm, source, rig, reporter)
    near_far = depth_range_mm or find_capture_depth_range(source, rig, reporter)
    at_a_time, threads = choose_threads(len(source), rig.core_camera.size_px)
    make_matcher = MatcherFactory(rig, near_far, _make_settings(method, preset, threads))
    matcher = CheckedMatcher(
        rig, auxiliaries, near_far, make_matcher, propose_rig=make_rig_writer(out, rig, reporter)
    )
    monitor = ImageMonitor(rig, HealthSettings(learning=False))
    with (
        _open_pool(source, make_matcher, workers, at_a_time, reporter) as (pool, ahead),
        FrameWriter(out, rig, (rig.core, *auxiliaries)) as writer,
    ):
        for done, frame in enumerate(reconstruct(source, matcher, monitor, reporter, pool, ahead), start=1):
            writer.add(frame)
            reporter.step("reconstructing", done, len(source))
        regions = writer.finish()
    write_reconstruction(
        out,
        {"method": method, "preset": preset if method == "multiview" else None, "depth_range_mm": near_far},
        writer.documents,
    )
    export_clouds([document["folder"] for document in writer.documents], clouds)
    return Reconstruction(auxiliaries, near_far, tuple(writer.documents), regions)


def open_capture(folder: Path, rig: Rig, reporter: Reporter) -> FolderSource:
    """Open a capture as the source of the rig's frame sets.

    Raises
    ------
    InputError
        When the capture has no images of the core camera, or of no other camera of the rig.
    """
    for line in find_oddities(rig):
        reporter.warn(line)
    capture = read_capture(folder, rig.cameras)
    if rig.core not in capture.cameras:
        raise InputError(
            f"{folder / rig.core}: no images of the core camera {rig.core}{capture.explain(rig.core)}; the capture "
            f"has {', '.join(capture.cameras)}"
        )
    if not set(capture.cameras) & set(rig.auxiliaries):
        raise InputError(
            f"{folder}: no images of an auxiliary camera of the rig ({', '.join(rig.auxiliaries)})"
            f"{capture.explain(*rig.auxiliaries)}; depth needs a second view"
        )
    return FolderSource(capture, {name: camera.size_px for name, camera in rig.cameras.items()}, reporter)


def select_auxiliaries(method: str, rig: Rig, pair: str | None) -> tuple[str, ...]:
    """Return the auxiliary cameras that a method uses.

    Raises
    ------
    SettingsError
        When there is no such method, or no such camera.
    """
    if method not in METHODS:
        raise SettingsError(f"method {method}: unknown; use --method {', '.join(METHODS)}")
    if pair is not None and (method != "binocular" or pair not in rig.auxiliaries):
        raise SettingsError(
            f"pair {pair}: --method binocular pairs {rig.core} with one of {', '.join(rig.auxiliaries)}"
        )
    return (pair or find_horizontal_auxiliary(rig),) if method == "binocular" else rig.auxiliaries


def _make_settings(method: str, preset: str, threads: int) -> MultiviewSettings | PairwiseSettings:
    if method != "multiview":
        return PairwiseSettings(threads=threads)
    return MultiviewSettings.preset(preset).model_copy(update={"threads": threads})


@contextmanager
def _open_pool(
    source: FolderSource,
    make_matcher: MatcherFactory,
    options: WorkerOptions,
    at_a_time: int,
    reporter: Reporter,
) -> Generator[tuple[MatchPool, int]]:
    """Yield threads or workers that match frames, and the number of frames to hand out at a time."""
    if options.is_here:
        with open_threads(at_a_time) as threads:
            yield threads, at_a_time
        return
    with open_workers(make_matcher, options, source.files, reporter) as workers:
        yield workers, workers.count_frames_ahead(make_matcher.rig.core_camera.size_px, len(source.cameras))


def check_images(monitor: ImageMonitor, frame_set: FrameSet, reporter: Reporter) -> tuple[Finding, ...]:
    """Return the findings about a frame's images; warn of those that are faults."""
    findings = monitor.check_images(frame_set).findings
    for finding in findings:
        if finding.is_fault:
            reporter.warn(f"frame {frame_set.frame}: {finding.text}")
    return findings


def reconstruct(
    source: FolderSource,
    matcher: CheckedMatcher,
    monitor: ImageMonitor,
    reporter: Reporter,
    pool: MatchPool,
    at_a_time: int,
) -> Iterator[Frame]:
    """Yield every frame that can be measured; warn of the others, of faulty images and of inconsistent cameras.

    The frames come in their order; ``at_a_time`` of them are handed out to the pool at a time.

    Raises
    ------
    ReconstructionError
        When not a single frame can be measured.
    """
    done, failure = 0, None
    for frame_set, pending in match_ahead(source, matcher, pool, at_a_time):
        health = check_images(monitor, frame_set, reporter)
        try:
            checked = matcher.measure(frame_set, reporter, pending=pending)
        except ReconstructionError as error:
            failure = error
            if len(source) > 1:
                reporter.warn(f"{error}; going on without this frame")
            continue
        done += 1
        for line in checked.faults:
            reporter.warn(line)
        yield Frame(frame_set, checked, health)
    if not done:
        raise failure or ReconstructionError(f"{source.folder}: no frame in it")
