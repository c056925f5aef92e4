"""The trigger instants of a capture: which frames there are, when they were taken and where the belt was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.files.encoder_csv import BeltReading, read_encoder
from beltscape.files.paths import summarise_names
from beltscape.sources.folder import FolderSource


@dataclass(frozen=True, slots=True)
class Instant:
    """One trigger instant of a capture."""

    frame: str
    time_ns: int | None
    position_mm: float | None
    """Encoder reading; None without an encoder."""


def list_instants(
    source: FolderSource, encoder: Path | None, frames_per_s: float | None, reporter: Reporter
) -> list[Instant]:
    """Return all instants in order: one per encoder row, or one per frame of the capture.

    Raises
    ------
    InputError
        When the encoder's rows name none of the capture's frames.
    """
    frames, folder = source.frames, str(source.folder)
    if encoder is not None:
        return pair_readings(read_encoder(encoder), frames, str(encoder), folder, reporter)
    own = source.folder / "encoder.csv"
    if frames_per_s is None and own.is_file():
        reporter.warn(f"{own}: only its times are used; --encoder takes the belt's positions from it too")
        return drop_positions(pair_readings(read_encoder(own), frames, str(own), folder, reporter))
    if frames_per_s is None:
        reporter.warn(
            "the times of the frames are unknown: flows per hour are left empty; give --encoder or --frames-per-s"
        )
        return [Instant(frame, None, None) for frame in frames]
    return time_frames(frames, frames_per_s)


def pair_readings(
    readings: Sequence[BeltReading], frames: Sequence[str], table: str, capture: str, reporter: Reporter
) -> list[Instant]:
    """Return one instant per reading in the order of time; frames without a reading are named and left out.

    ``table`` and ``capture`` name the encoder.csv and the capture in messages.

    Raises
    ------
    InputError
        When the readings name none of the frames.
    """
    with_reading, with_image = {reading.frame for reading in readings}, set(frames)
    without = [frame for frame in frames if frame not in with_reading]
    if len(without) == len(frames):
        raise InputError(
            f"{table}: none of its frames ({readings[0].frame}, …) is in the capture ({frames[0]}, …); "
            "give the encoder.csv of this capture"
        )
    if without:
        reporter.warn(f"{table}: no row for frame {summarise_names(without)}; going on without")
    absent = [reading.frame for reading in readings if reading.frame not in with_image]
    if absent:
        shown = summarise_names(absent)
        reporter.warn(
            f"{capture}: no image of frame {shown}; their belt is measured in the others, or bridged"
        )
    return [
        Instant(reading.frame, reading.time_ns, reading.belt_position_mm)
        for reading in sorted(readings, key=lambda one: one.time_ns)
    ]


def drop_positions(instants: Sequence[Instant]) -> list[Instant]:
    """Return the instants without the encoder's positions."""
    return [Instant(instant.frame, instant.time_ns, None) for instant in instants]


def time_frames(frames: Sequence[str], frames_per_s: float) -> list[Instant]:
    """Return the instants of frames at a constant rate: their names are trigger numbers if all are numbers."""
    are_numbers = all(frame.isascii() and frame.isdigit() for frame in frames)
    numbers = [int(frame) for frame in frames] if are_numbers else list(range(len(frames)))
    return [
        Instant(frame, round(number / frames_per_s * 1e9), None)
        for frame, number in zip(frames, numbers, strict=True)
    ]
