"""A moving capture, a rig and the empty belt → what passed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.errors import InputError, ReconstructionError, SettingsError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.core.scaling import scale_rig
from beltscape.files.capture import read_capture
from beltscape.files.rasters.images import read_image
from beltscape.files.tables.encoder_csv import Reading, read_encoder
from beltscape.measure.flow.fusion.picture import BeltPicture
from beltscape.measure.flow.meter import FlowMeter, Step
from beltscape.measure.flow.records.density import Density
from beltscape.measure.flow.settings import Direction, FlowSettings
from beltscape.pipeline.measuring.flow_chain import FlowChain, depth_range_over, read_reference, widen_to_belt
from beltscape.pipeline.measuring.flow_checks import demand_consistent, warn_of_conflicts
from beltscape.pipeline.reconstructing.checked_matcher import sequence_matcher
from beltscape.pipeline.reconstructing.reconstruction import depth_range, open_capture
from beltscape.sources.folder import FolderSource
from beltscape.stereo.multiview.settings import PRESETS, MultiviewSettings


@dataclass(frozen=True, slots=True)
class Instant:
    """One trigger instant of a capture."""

    frame: str
    time_ns: int | None
    position_mm: float | None
    """The encoder's; None without one."""


@dataclass(frozen=True, slots=True, eq=False)
class Flow:
    """What was measured of a moving capture."""

    records: list[FlowRecord]
    steps: list[Step]
    """How each frame was placed."""
    meter: FlowMeter
    """As it stands after the last frame."""
    picture: BeltPicture
    """The fused belt from end to end."""
    seconds_per_frame: float
    """Of reconstruction and measuring together."""
    by_encoder: bool
    """Whether an encoder was given."""
    told: Direction | None
    """The direction that was given; None: found from the material."""


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
    """Reconstruct a moving capture frame by frame and measure what passes.

    Without ``encoder`` the belt's motion is taken from the material; the times are then the capture's own
    encoder.csv's, where it has one, or follow from ``frames_per_s``. Depth is looked for up to ``load_mm`` over the
    empty belt, or else where a few frames show any. Images may be smaller or larger than the rig's
    by one factor: the rig is scaled.

    Raises
    ------
    InputError, SettingsError, MeasureError, ReconstructionError
        With one line that names what is wrong and the fix: also where most frame pairs contradict the told
        direction or the encoder.
    """
    if preset not in PRESETS:
        raise SettingsError(f"preset {preset}: unknown; use --preset {', '.join(PRESETS)}")
    rig = scale_rig_to_capture(rig, capture, reporter)
    source = open_capture(capture, rig, reporter)
    instants = list_instants(source, encoder, frames_per_s, reporter)
    ground = read_reference(empty, rig, None if settings is None else settings.cell_mm, reporter)
    near_far = (
        widen_to_belt(ground, depth_range(source, rig, reporter))
        if load_mm is None
        else depth_range_over(ground, load_mm)
    )
    picture, steps = BeltPicture(ground), list[Step]()
    meter = FlowMeter(ground, settings, density=density, watch_belt=picture.add, watch_step=steps.append)
    matcher = sequence_matcher(rig, source.cameras, near_far, MultiviewSettings.preset(preset))
    chain = FlowChain(matcher, meter)
    told = None if settings is None else settings.direction
    began, records = perf_counter(), list[FlowRecord]()
    for done, instant in enumerate(instants, 1):
        frames = _frames(source, instant)
        records += chain.push(frames, reporter, whole=set(source.cameras) <= set(frames.images)).records
        demand_consistent(meter, told, encoder, done=False)
        reporter.step("measuring flow", done, len(instants))
    if not chain.done:
        raise chain.failure or ReconstructionError(f"{source.folder}: no frame in it")
    records += chain.finish()
    spent = (perf_counter() - began) / max(len(instants), 1)
    demand_consistent(meter, told, encoder, done=True)
    warn_of_conflicts(meter, encoder, reporter)
    _warn_of_gaps(records, reporter)
    return Flow(records, steps, meter, picture, spent, encoder is not None, told)


def scale_rig_to_capture(rig: Rig, capture: Path, reporter: Reporter) -> Rig:
    """The rig with its images as large as the capture's; another shape is left for the source to complain of."""
    files = read_capture(capture).files.get(rig.core)
    if not files:
        return rig
    height, width = read_image(next(iter(files.values()))).shape[:2]
    own = rig.core_camera.size_px
    factor = width / own[0]
    if (width, height) == own or abs(own[1] * factor - height) > 1:
        return rig
    reporter.warn(
        f"{capture}: images of {width}×{height} px, the rig's are {own[0]}×{own[1]}; the rig is scaled by {factor:g}"
    )
    return scale_rig(rig, factor)


def list_instants(
    source: FolderSource, encoder: Path | None, frames_per_s: float | None, reporter: Reporter
) -> list[Instant]:
    """All instants in order: every row of the encoder, or every frame of the capture.

    Raises
    ------
    InputError
        When the encoder's rows name none of the capture's frames.
    """
    if encoder is not None:
        readings = read_encoder(encoder)
        return _told(readings, source, encoder, reporter, positions=True)
    own = source.folder / "encoder.csv"
    if frames_per_s is None and own.is_file():
        reporter.warn(f"{own}: only its times are used; --encoder takes the belt's positions from it too")
        return _told(read_encoder(own), source, own, reporter, positions=False)
    if frames_per_s is None:
        reporter.warn(
            "nothing tells when the frames were taken: flows per hour are left empty; give --encoder, --frames-per-s"
        )
        return [Instant(frame, None, None) for frame in source.frames]
    numbers = _numbers(source.frames)
    return [
        Instant(frame, round(number / frames_per_s * 1e9), None)
        for frame, number in zip(source.frames, numbers, strict=True)
    ]


def _told(
    readings: Sequence[Reading], source: FolderSource, path: Path, reporter: Reporter, *, positions: bool
) -> list[Instant]:
    known = {reading.frame for reading in readings}
    without = [frame for frame in source.frames if frame not in known]
    if len(without) == len(source.frames):
        raise InputError(
            f"{path}: none of its frames ({readings[0].frame}, …) is in the capture ({source.frames[0]}, …); "
            "give the encoder.csv of this capture"
        )
    if without:
        shown = ", ".join(without[:4]) + (f" and {len(without) - 4} more" if len(without) > 4 else "")
        reporter.warn(f"{path}: no row for frame {shown}; going on without")
    lost = [reading.frame for reading in readings if reading.frame not in source.frames]
    if lost:
        shown = ", ".join(lost[:4]) + (f" and {len(lost) - 4} more" if len(lost) > 4 else "")
        reporter.warn(
            f"{source.folder}: no image of frame {shown}; their belt is measured in the others, or bridged"
        )
    return [
        Instant(reading.frame, reading.time_ns, reading.belt_position_mm if positions else None)
        for reading in sorted(readings, key=lambda one: one.time_ns)
    ]


def _numbers(frames: Sequence[str]) -> list[int]:
    """Numbers of the frames in the trigger's count: their names' own where all are numbers, else their order."""
    if all(frame.isascii() and frame.isdigit() for frame in frames):
        return [int(frame) for frame in frames]
    return list(range(len(frames)))


def _frames(source: FolderSource, instant: Instant) -> FrameSet:
    """The images of an instant, none where there are none, with its time and the encoder's reading."""
    return FrameSet(instant.frame, source.images(instant.frame), instant.time_ns, instant.position_mm)


def _warn_of_gaps(records: Sequence[FlowRecord], reporter: Reporter) -> None:
    """Name the frames of which nothing was counted."""
    lost = [record.frame for record in records if record.quality == "missing"]
    if lost:
        reporter.warn(
            f"frames of which nothing was counted: {', '.join(lost[:6])}{' …' if len(lost) > 6 else ''}"
        )
