"""Reconstruction of a capture: a depth map and its files for every frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.errors import InputError, ReconstructionError, SettingsError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.capture import read_capture
from beltscape.files.folders.atomic import ensure_output_folder
from beltscape.files.folders.paths import AnyPath, as_path
from beltscape.files.reconstruction import write_frame, write_reconstruction
from beltscape.files.rig_json import write_rig
from beltscape.files.rig_limits import LEAST_DEPTH_MM, find_oddities
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.pipeline.reconstructing.checked_matcher import CheckedDepth, CheckedMatcher
from beltscape.pipeline.reconstructing.cloud_export import export_clouds
from beltscape.pipeline.reconstructing.regions import write_regions
from beltscape.pipeline.reconstructing.rig_proposal import make_rig_writer
from beltscape.pipeline.reconstructing.search_range import check_depth_range
from beltscape.report.drawing.depth_picture import draw_depth_map
from beltscape.sources.folder import FolderSource
from beltscape.stereo.consistency.check import check_consistency
from beltscape.stereo.consistency.diagnosis.diagnosis import diagnose_cameras
from beltscape.stereo.consistency.diagnosis.low_coverage import diagnose_low_coverage
from beltscape.stereo.consistency.rig_consistency import make_consistency_document
from beltscape.stereo.multiview.initialisation.depth_range import compute_search_range, find_depth_range
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.settings import PRESETS, MultiviewSettings
from beltscape.stereo.pairwise.reconstructor import PairwiseReconstructor, find_horizontal_auxiliary
from beltscape.stereo.pairwise.settings import PairwiseSettings
from beltscape.stereo.pointcloud.cloud import CloudBuilder

METHODS = ("multiview", "pairwise", "binocular")
"""Methods of `reconstruct`: all auxiliaries at once, or the paper's two methods."""
RANGE_FRAMES = 5
"""Number of frames of a sequence in which the depth range is searched."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One reconstructed frame."""

    frame_set: FrameSet
    checked: CheckedDepth
    health: tuple[Finding, ...] = ()
    """The findings about its images."""


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
) -> Reconstruction:
    """Reconstruct every frame of a capture into ``out``: rig.json, reconstruction.json and a folder per frame.

    The projected markers of the first frame that can be measured are drawn in regions.png. ``clouds`` names the
    formats in which the clouds are written beside cloud.ply.

    Raises
    ------
    InputError, SettingsError, ReconstructionError, OutputError
        With one line that names the fault and the fix.
    """
    capture, out = as_path(capture, "capture"), as_path(out, "out")
    wanted = select_auxiliaries(method, rig, pair)
    if preset not in PRESETS:
        raise SettingsError(f"preset {preset}: unknown; use --preset {', '.join(PRESETS)}")
    source = open_capture(capture, rig, reporter)
    auxiliaries = tuple(name for name in wanted if name in source.cameras)
    if not auxiliaries:
        raise InputError(
            f"{capture}: no images of {', '.join(wanted)}; --method binocular needs them (see --pair)"
        )
    ensure_output_folder(out)
    check_depth_range(depth_range_mm, source, rig, reporter)
    near_far = depth_range_mm or find_capture_depth_range(source, rig, reporter)
    matcher = _make_matcher(method, preset, rig, near_far, auxiliaries, make_rig_writer(out, rig, reporter))
    documents: list[Mapping[str, Any]] = []
    regions: Path | None = None
    builder = CloudBuilder(rig.core_camera)
    monitor = ImageMonitor(rig, HealthSettings(learning=False))
    for frame in reconstruct(source, matcher, monitor, reporter):
        if not documents:
            write_rig(out / "rig.json", rig)
            regions = write_regions(out / "regions.png", frame.frame_set, rig, (rig.core, *auxiliaries))
        documents.append(_write(out / frame.frame_set.frame, frame, builder))
        reporter.step("reconstructing", len(documents), len(source))
    write_reconstruction(
        out,
        {"method": method, "preset": preset if method == "multiview" else None, "depth_range_mm": near_far},
        documents,
    )
    export_clouds([document["folder"] for document in documents], clouds)
    return Reconstruction(auxiliaries, near_far, tuple(documents), regions)


def _write(folder: Path, frame: Frame, builder: CloudBuilder) -> Mapping[str, Any]:
    checked, image = frame.checked, frame.frame_set.images[builder.camera.name]
    depth = checked.depth
    write_frame(folder, depth, builder.build(depth, image), draw_depth_map(depth), builder.undistort(image))
    measured = depth.measured.any()
    return {
        "frame": frame.frame_set.frame,
        "folder": folder,
        "coverage": depth.coverage,
        "median_depth_mm": float(np.nanmedian(depth.depth_mm)) if measured else float("nan"),
        "median_sigma_mm": float(np.nanmedian(depth.sigma_mm)) if measured else float("nan"),
        "auxiliaries": checked.auxiliaries,
        "systematic_mm": depth.systematic_mm,
        "doubts": checked.faults,
        "consistency": checked.consistency and make_consistency_document(checked.consistency),
        "health": [_make_finding_document(finding) for finding in frame.health],
    }


def _make_finding_document(finding: Finding) -> Mapping[str, Any]:
    return {
        "check": finding.check,
        "camera": finding.subject,
        "value": finding.value,
        "sigma": finding.sigma,
        "limit": finding.limit,
        "unit": finding.unit,
        "effect": finding.effect,
        "text": finding.text,
    }


def open_capture(folder: Path, rig: Rig, reporter: Reporter) -> FolderSource:
    """Open a capture as the source of the rig's frame sets.

    Raises
    ------
    InputError
        When the capture has no images of the core camera, or of no other camera of the rig.
    """
    for line in find_oddities(rig):
        reporter.warn(line)
    capture = read_capture(folder)
    if rig.core not in capture.cameras:
        raise InputError(
            f"{folder / rig.core}: no images of the core camera {rig.core}; the capture has "
            f"{', '.join(capture.cameras)}"
        )
    if not set(capture.cameras) & set(rig.auxiliaries):
        raise InputError(
            f"{folder}: no images of an auxiliary camera of the rig ({', '.join(rig.auxiliaries)}); "
            "depth needs a second view"
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


def find_capture_depth_range(source: FolderSource, rig: Rig, reporter: Reporter) -> tuple[float, float]:
    """Return the near and far depth (mm) of the surfaces in a few frames spread over the capture."""
    chosen = {
        source.frames[int(i)] for i in np.unique(np.linspace(0, len(source) - 1, RANGE_FRAMES).astype(int))
    }
    ranges: list[tuple[float, float]] = []
    failure: ReconstructionError | None = None
    for frame_set in source.select_frames(chosen):
        try:
            ranges.append(find_depth_range(rig, frame_set, reporter))
        except ReconstructionError as error:
            failure = error
    if not ranges:
        _raise_diagnosis(source, rig, min(chosen))
        raise failure or ReconstructionError(f"{source.folder}: no frame in it")
    near, far = min(near for near, _ in ranges), max(far for _, far in ranges)
    if far < LEAST_DEPTH_MM:
        raise ReconstructionError(
            f"{source.folder}: surfaces found {near:.3g} to {far:.3g} mm before {rig.core}; the rig seems to be in "
            "metres: multiply its translations by 1000"
        )
    return near, far


def _raise_diagnosis(source: FolderSource, rig: Rig, frame: str) -> None:
    """Raise a ReconstructionError with the most likely reason why a frame shows no surface."""
    for frame_set in source.select_frames({frame}):
        if rig.core in frame_set.images and len(frame_set.images) > 1:
            raise ReconstructionError(_diagnose_missing_surface(frame_set, rig))


def _diagnose_missing_surface(frame_set: FrameSet, rig: Rig) -> str:
    """Return the most likely reason why a frame shows no surface."""
    consistency = check_consistency(frame_set, rig, None)
    names = tuple(each.camera for each in consistency.cameras)
    faults = diagnose_cameras(frame_set, rig, consistency)
    if faults:
        return f"frame {frame_set.frame}: {'; '.join(fault.text for fault in faults)}"
    return diagnose_low_coverage(frame_set, rig, consistency, compute_search_range(rig, names), 0.0)[0]


def _make_matcher(
    method: str,
    preset: str,
    rig: Rig,
    near_far: tuple[float, float],
    auxiliaries: tuple[str, ...],
    propose_rig: Callable[[Rig], None],
) -> CheckedMatcher:
    def make_matcher(names: tuple[str, ...]) -> PairwiseReconstructor | MultiviewReconstructor:
        if method != "multiview":
            return PairwiseReconstructor(rig, near_far, PairwiseSettings(), auxiliaries=names)
        return MultiviewReconstructor(rig, near_far, MultiviewSettings.preset(preset), auxiliaries=names)

    return CheckedMatcher(rig, auxiliaries, near_far, make_matcher, propose_rig=propose_rig)


def check_images(monitor: ImageMonitor, frame_set: FrameSet, reporter: Reporter) -> tuple[Finding, ...]:
    """Return the findings about a frame's images; warn of those that are faults."""
    findings = monitor.check_images(frame_set).findings
    for finding in findings:
        if finding.is_fault:
            reporter.warn(f"frame {frame_set.frame}: {finding.text}")
    return findings


def reconstruct(
    source: FolderSource, matcher: CheckedMatcher, monitor: ImageMonitor, reporter: Reporter
) -> Iterator[Frame]:
    """Yield every frame that can be measured; warn of the others, of faulty images and of inconsistent cameras.

    Raises
    ------
    ReconstructionError
        When not a single frame can be measured.
    """
    done, failure = 0, None
    for frame_set in source:
        health = check_images(monitor, frame_set, reporter)
        try:
            checked = matcher.measure(frame_set, reporter)
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
