"""Measurement of the material flow in a capture of the moving belt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.errors import ReconstructionError, SettingsError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.health.images.belt_images import BeltImageMonitor
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.measure.flow.fusion.picture import BeltPicture
from beltscape.measure.flow.meter import FlowMeter, FramePlacement
from beltscape.measure.flow.records.density import Density
from beltscape.measure.flow.settings import Direction, FlowSettings
from beltscape.pipeline.measuring.flow.chain import (
    FlowChain,
    compute_depth_range,
    read_reference,
    widen_to_belt,
)
from beltscape.pipeline.measuring.flow.checks import require_consistent_motion, warn_of_motion_conflicts
from beltscape.pipeline.measuring.flow.instants import Instant, list_instants
from beltscape.pipeline.reconstructing.checked_matcher import make_sequence_matcher
from beltscape.pipeline.reconstructing.monitored_matcher import MonitoredMatcher
from beltscape.pipeline.reconstructing.reconstruction import open_capture
from beltscape.pipeline.reconstructing.search_range import find_capture_depth_range
from beltscape.sources.folder import FolderSource, scale_rig_to_capture
from beltscape.stereo.multiview.settings import PRESETS, MultiviewSettings


@dataclass(frozen=True, slots=True, eq=False)
class Flow:
    """The flow measured in a capture of the moving belt."""

    records: list[FlowRecord]
    steps: list[FramePlacement]
    """Belt position of each frame."""
    meter: FlowMeter
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
) -> Flow:
    """Reconstruct a capture of the moving belt frame by frame and measure the flow.

    Without ``encoder`` the belt's motion is measured from the material, and the times come from the capture's own
    encoder.csv or from ``frames_per_s``. Depth is searched up to ``load_mm`` over the empty belt, by default in the
    range that a few frames show. The rig is scaled to images that are binned or reduced.

    Raises
    ------
    InputError, SettingsError, MeasureError, ReconstructionError
        With one line that names the fault and the fix; also if most frame pairs contradict the given
        direction or the encoder.
    """
    if preset not in PRESETS:
        raise SettingsError(f"preset {preset}: unknown; use --preset {', '.join(PRESETS)}")
    rig = scale_rig_to_capture(rig, capture, reporter)
    source = open_capture(capture, rig, reporter)
    instants = list_instants(source, encoder, frames_per_s, reporter)
    ground = read_reference(empty, rig, None if settings is None else settings.cell_mm, reporter)
    near_far = (
        widen_to_belt(ground, find_capture_depth_range(source, rig, reporter))
        if load_mm is None
        else compute_depth_range(ground, load_mm)
    )
    picture, steps = BeltPicture(ground), list[FramePlacement]()
    meter = FlowMeter(ground, settings, density=density, watch_belt=picture.add, watch_step=steps.append)
    matcher = make_sequence_matcher(rig, source.cameras, near_far, MultiviewSettings.preset(preset))
    health = HealthSettings()
    monitored = MonitoredMatcher(matcher, ImageMonitor(rig, health))
    chain = FlowChain(monitored, meter, images=BeltImageMonitor(rig, ground, health))
    direction = None if settings is None else settings.direction
    began, records = perf_counter(), list[FlowRecord]()
    for done, instant in enumerate(instants, 1):
        frames = _frame_set(source, instant)
        records += chain.push(frames, reporter, whole=set(source.cameras) <= set(frames.images)).records
        require_consistent_motion(meter, direction, encoder, done=False)
        reporter.step("measuring flow", done, len(instants))
    if not chain.done:
        raise chain.failure or ReconstructionError(f"{source.folder}: no frame in it")
    records += chain.finish()
    spent = (perf_counter() - began) / max(len(instants), 1)
    require_consistent_motion(meter, direction, encoder, done=True)
    warn_of_motion_conflicts(meter, encoder, reporter)
    _warn_of_gaps(records, reporter)
    return Flow(records, steps, meter, picture, spent, encoder is not None, direction)


def _frame_set(source: FolderSource, instant: Instant) -> FrameSet:
    """Return the images of an instant, possibly none, with its time and encoder reading."""
    images, exposures_us = source.images(instant.frame), source.exposures_us(instant.frame)
    return FrameSet(instant.frame, images, instant.time_ns, instant.position_mm, exposures_us)


def _warn_of_gaps(records: Sequence[FlowRecord], reporter: Reporter) -> None:
    """Warn of the frames of which nothing was counted."""
    lost = [record.frame for record in records if record.quality == "missing"]
    if lost:
        reporter.warn(
            f"frames of which nothing was counted: {', '.join(lost[:6])}{' …' if len(lost) > 6 else ''}"
        )
