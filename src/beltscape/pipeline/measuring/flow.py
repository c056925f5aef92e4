"""Measurement of the material flow in a capture of the moving belt, and its files.

The files of `measure flow` are flow.csv, flow.json, belt.tiff, belt_sigma.tiff, belt_measured.tiff and report.html.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.height_map import coarsen
from beltscape.core.ledger import QUALITIES, FlowRecord
from beltscape.core.progress import Reporter
from beltscape.files.atomic import write_text
from beltscape.files.flow_csv import write_flow
from beltscape.files.json_text import write_json
from beltscape.files.tiff import write_float_tiff
from beltscape.health.images.belt_images import BeltImageMonitor
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.density import Density
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from beltscape.measure.flow.motion_evidence import MotionEvidence
from beltscape.measure.flow.rows import PICTURE_CELL_MM, BeltPicture
from beltscape.measure.flow.settings import Direction, FlowSettings
from beltscape.pipeline.measuring.flow_chain import (
    FlowChain,
    compute_depth_range,
    read_reference,
    widen_to_belt,
)
from beltscape.pipeline.measuring.flow_checks import (
    describe_motion,
    require_consistent_motion,
    warn_of_motion_conflicts,
)
from beltscape.pipeline.measuring.instants import Instant, list_instants
from beltscape.pipeline.reconstructing.checked_matcher import SequenceMatcher, make_sequence_matcher
from beltscape.pipeline.reconstructing.monitored_matcher import MonitoredMatcher
from beltscape.pipeline.reconstructing.reconstruction import open_capture
from beltscape.pipeline.reconstructing.search_range import find_capture_depth_range
from beltscape.report.measuring.flow import FlowReport, render_flow_page
from beltscape.sources.folder import FolderSource, scale_rig_to_capture
from beltscape.stereo.settings import MultiviewSettings, require_preset
from beltscape.workers.calls import CallMaker


@dataclass(frozen=True, slots=True, eq=False)
class Flow:
    """The flow measured in a capture of the moving belt."""

    records: list[FlowRecord]
    steps: list[FramePlacement]
    """Belt position of each frame."""
    meter: BeltFlowMeter
    """The meter after the last frame."""
    picture: BeltPicture
    """Height map of the whole fused belt."""
    seconds_per_frame: float
    """Processing time of reconstruction and measurement together."""
    by_encoder: bool
    """Whether an encoder was given."""
    given_direction: Direction | None
    """The direction given by the user; None: measured from the material."""


def measure_flow_of_capture(
    capture: Path,
    rig: Rig,
    empty: Path,
    reporter: Reporter,
    *,
    encoder: Path | None = None,
    frames_per_s: float | None = None,
    density: Density | None = None,
    settings: FlowSettings | None = None,
    preset: str = "standard",
    load_mm: float | None = None,
    belt_cell_mm: float | None = None,
    calls: CallMaker | None = None,
) -> Flow:
    """Reconstruct a capture of the moving belt frame by frame and measure the flow.

    Without ``encoder`` the belt's motion is measured from the material, and the times come from the capture's own
    encoder.csv or from ``frames_per_s``. Depth is searched up to ``load_mm`` over the empty belt, by default in the
    range that a few frames show. The rig is scaled to images that are binned or reduced.
    ``belt_cell_mm`` is the edge of a cell of the picture, by default a pixel, or up to 4 mm of a long belt.
    ``calls`` fills the holes of finished blocks of belt; None: each at once.

    Raises
    ------
    InputError, SettingsError, MeasureError, ReconstructionError
        With one line that names the fault and the fix; also if most frame pairs contradict the given
        direction or the encoder.
    """
    require_preset(preset)
    rig = scale_rig_to_capture(rig, capture, reporter)
    source = open_capture(capture, rig, reporter)
    instants = list_instants(source, encoder, frames_per_s, reporter)
    ground = read_reference(empty, rig, None if settings is None else settings.cell_mm, reporter)
    near_far = _find_depth_range(ground, source, rig, load_mm, reporter)
    picture, steps = BeltPicture(ground, belt_cell_mm), list[FramePlacement]()
    meter = BeltFlowMeter(
        ground, settings, density=density, watch_belt=picture.add, watch_step=steps.append,
        scale_sigma=rig.scale_sigma, calls=calls,
    )  # fmt: skip
    matcher = make_sequence_matcher(rig, source.cameras, near_far, MultiviewSettings.preset(preset))
    chain = _make_chain(rig, ground, matcher, meter)
    direction = None if settings is None else settings.direction
    began, records = perf_counter(), list[FlowRecord]()
    for done, instant in enumerate(instants, 1):
        frames = _read_frame_set(source, instant)
        records += chain.push(frames, reporter, whole=set(source.cameras) <= set(frames.images)).records
        require_consistent_motion(meter, direction, encoder, done=False)
        reporter.step("measuring flow", done, len(instants))
    if not chain.done:
        raise chain.failure or ReconstructionError(f"{source.folder}: no frame in it")
    records += chain.finish()
    spent = (perf_counter() - began) / max(len(instants), 1)
    require_consistent_motion(meter, direction, encoder, done=True)
    warn_of_motion_conflicts(meter, encoder, reporter)
    _warn_of_missing(records, picture, reporter)
    return Flow(records, steps, meter, picture, spent, encoder is not None, direction)


def _find_depth_range(
    ground: EmptyBeltReference, source: FolderSource, rig: Rig, load_mm: float | None, reporter: Reporter
) -> tuple[float, float]:
    """Return the depths to search: up to the load's given height, by default what a few frames show."""
    if load_mm is not None:
        return compute_depth_range(ground, load_mm)
    return widen_to_belt(ground, find_capture_depth_range(source, rig, reporter))


def _make_chain(
    rig: Rig, ground: EmptyBeltReference, matcher: SequenceMatcher, meter: BeltFlowMeter
) -> FlowChain:
    """Return the chain from images to records, with the checks of images and belt."""
    health = HealthSettings()
    monitored = MonitoredMatcher(matcher, ImageMonitor(rig, health))
    return FlowChain(monitored, meter, images=BeltImageMonitor(rig, ground, health))


def _read_frame_set(source: FolderSource, instant: Instant) -> FrameSet:
    """Return the images of an instant, possibly none, with its time and encoder reading."""
    images, exposures_us = source.images(instant.frame), source.exposures_us(instant.frame)
    return FrameSet(instant.frame, images, instant.time_ns, instant.position_mm, exposures_us)


def _warn_of_missing(records: Sequence[FlowRecord], picture: BeltPicture, reporter: Reporter) -> None:
    """Warn of the frames of which nothing was counted, and of a belt too long for the picture."""
    if picture.is_shortened:
        reporter.warn(
            "the fused belt holds the end of the run only; measure shorter runs, or give a larger --belt-cell"
        )
    lost = [record.frame for record in records if record.quality == "missing"]
    if lost:
        reporter.warn(
            f"frames of which nothing was counted: {', '.join(lost[:6])}{' …' if len(lost) > 6 else ''}"
        )


_DIRECTIONS = {1: "+y", -1: "-y", 0: None}


def write_flow_result(
    out: Path,
    flow: Flow,
    density: Density,
    warnings: Sequence[str],
    measured_by: Mapping[str, str] | None = None,
) -> Mapping[str, Any]:
    """Write all files into ``out``; return the result of ``--json``. ``measured_by``: hashes of what it rests on."""
    document = {**make_flow_document(flow, density), "provenance": dict(measured_by or {})}
    belt, share = flow.picture.height_map()
    write_flow(out / "flow.csv", flow.records)
    planes = {"belt": belt.height_mm, "belt_sigma": belt.sigma_mm, "belt_measured": share}
    for name, plane in planes.items():
        write_float_tiff(out / f"{name}.tiff", plane.astype(np.float32))
    pose = flow.meter.reference.belt.belt_from_core
    grid = {
        "origin_mm": belt.origin_mm,
        "cell_mm": belt.cell_mm,
        "rows": "belt coordinate s",
        "columns": "x",
        "belt_from_core": {"rotation": pose.rotation, "translation_mm": pose.translation_mm},
    }
    write_json(out / "flow.json", {**document, "belt_grid": grid})
    shown, share = coarsen(belt, share, PICTURE_CELL_MM)
    page = FlowReport(flow.records, flow.steps, flow.meter.totals, document, shown, share)
    write_text(out / "report.html", render_flow_page(page, warnings=warnings))
    return {**document, "flow": out / "flow.csv", "belt": out / "belt.tiff", "report": out / "report.html"}


def make_flow_document(flow: Flow, density: Density) -> dict[str, Any]:
    """Return all results of a flow as plain values for JSON."""
    meter, records = flow.meter, flow.records
    totals, scale = meter.totals, meter.scale
    counts = Counter(record.quality for record in records)
    return {
        "frame_count": len(records),
        "direction": _DIRECTIONS[meter.direction],
        "direction_told": flow.given_direction,
        "motion_evidence": {
            "statement": describe_motion(meter, flow.given_direction),
            **_describe_evidence(meter.evidence),
        },
        "motion_from": "encoder and material" if flow.by_encoder else "material",
        "totals": _describe_totals(flow),
        "first_strip": _describe_strip(records, totals.first_strip_mm),
        "last_strip": _describe_strip(records, totals.last_strip_mm),
        "quality": {name: counts.get(name, 0) for name in QUALITIES},
        "encoder": {
            "compared": scale.compared,
            "ratio": scale.ratio if scale.compared else None,
            "sigma": scale.sigma if scale.compared else None,
            "scatter_mm": scale.scatter_mm if scale.compared > 1 else None,
            "conflicts": meter.evidence.conflicting,
        },
        "fusion": _describe_fusion(flow),
        "density": {"product": density.name or None, "entries": len(density.time_ns)},
        "cell_mm": meter.reference.cell_mm,
        "window_mm": meter.reference.window_mm,
        "seconds_per_frame": flow.seconds_per_frame,
        "drift_across": _compute_drift(flow),
        "places": [
            {
                "frame": step.frame,
                "position_mm": step.place.position_mm,
                "sigma_mm": step.place.sigma_mm,
                "from": step.place.source,
                "encoder_mm": step.place.encoder_mm,
                "score": None if step.shift is None else step.shift.score,
            }
            for step in flow.steps
        ],
        "strips": [
            {
                "frame": record.frame,
                "start_mm": record.strip_mm[0],
                "end_mm": record.strip_mm[1],
                "volume_mm3": record.volume_mm3,
                "sigma_mm3": record.sigma_mm3,
                "common_sigma_mm3": record.common_sigma_mm3,
                "quality": record.quality,
            }
            for record in records
        ],
    }


def _describe_totals(flow: Flow) -> dict[str, Any]:
    """Return the totals of the run as plain values."""
    totals = flow.meter.totals
    seconds, mean = _compute_mean_flow(flow.records)
    return {
        "volume_mm3": totals.volume_mm3,
        "sigma_mm3": totals.sigma_mm3,
        "mass_t": _replace_nan(totals.mass_kg * 1e-3),
        "mass_sigma_t": _replace_nan(totals.mass_sigma_kg * 1e-3),
        "length_mm": totals.length_mm,
        "seen_mm": totals.seen_mm,
        "bridged_mm": totals.bridged_mm,
        "not_counted_mm": totals.unseen_mm,
        "coverage": totals.share,
        "seconds": _replace_nan(seconds),
        "mean_volume_flow_m3_h": _replace_nan(mean),
    }


def _describe_fusion(flow: Flow) -> dict[str, Any]:
    """Return coverage and noise of single frames and of the fused belt."""
    totals, scatter = flow.meter.totals, flow.meter.scatter
    return {
        "single_coverage": totals.single_share,
        "coverage": totals.share,
        "single_noise_mm": scatter.single_noise_mm,
        "fused_noise_mm": scatter.fused_noise_mm,
        "claimed_noise_mm": float(np.sqrt(scatter.claimed_mm2 / scatter.cells)) if scatter.cells else None,
        "left_out": scatter.outliers / max(scatter.outliers + scatter.cells, 1),
    }


def _replace_nan(value: float) -> float | None:
    """Return ``value``, None for NaN."""
    return float(value) if np.isfinite(value) else None


def _describe_evidence(evidence: MotionEvidence) -> dict[str, Any]:
    """Return the counts of frame pairs by the motion that the material showed."""
    return {
        "pairs_towards_plus_y": evidence.plus,
        "pairs_towards_minus_y": evidence.minus,
        "encoder_pairs": evidence.compared,
        "encoder_agrees": evidence.agreeing,
        "encoder_opposite": evidence.opposite,
        "material_still": evidence.still,
        "encoder_nearly_still": evidence.encoder_still,
        "encoder_other_length": evidence.other_scale,
    }


def _compute_drift(flow: Flow) -> float | None:
    """Return the material's motion across the belt frame per mm along it; None if it was not measured."""
    shifts = [step.shift for step in flow.steps if step.shift is not None and abs(step.shift.along_mm) > 1]
    return float(np.median([shift.across_mm / shift.along_mm for shift in shifts])) if shifts else None


def _compute_mean_flow(records: Sequence[FlowRecord]) -> tuple[float, float]:
    """Return the seconds from the first to the last frame, and the mean volume flow between them in m³/h."""
    timed = [record for record in records if record.time_ns is not None]
    if len(timed) < 2 or timed[0].time_ns is None or timed[-1].time_ns is None:
        return float("nan"), float("nan")
    seconds = (timed[-1].time_ns - timed[0].time_ns) * 1e-9
    return seconds, sum(record.volume_mm3 for record in timed[1:]) * 3600e-9 / seconds


def _describe_strip(
    records: Sequence[FlowRecord], strip_mm: tuple[float, float] | None
) -> dict[str, Any] | None:
    if strip_mm is None:
        return None
    frame = next((record.frame for record in records if record.strip_mm == strip_mm), None)
    return {"frame": frame, "start_mm": strip_mm[0], "end_mm": strip_mm[1]}
