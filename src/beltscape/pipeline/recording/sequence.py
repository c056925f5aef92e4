"""A sequence of all frame sets, with the belt's positions: material on the moving belt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from beltscape.core.progress import Reporter
from beltscape.pipeline.recording.feed import FrameFeed
from beltscape.sinks.recording.capture_writer import CaptureWriter

_PATIENCE_S = 30.0
"""As for single shots."""


@dataclass(frozen=True, slots=True)
class Sequence:
    """A recorded sequence."""

    frames: int
    incomplete: int
    """Frame sets without the image of some camera."""
    without_position: int
    """Frame sets without the encoder's position."""
    dropped: int
    """Frame sets that the disk was too slow for."""


def record_sequence(
    feed: FrameFeed,
    cameras: tuple[str, ...],
    is_finished: Callable[[int], bool],
    writer: CaptureWriter,
    reporter: Reporter,
) -> Sequence:
    """Write every frame set until ``is_finished``, which is given the number of frame sets written.

    The first frame set is one of all cameras. Frame sets are numbered as they were triggered: a dropped one leaves
    a gap in the names.

    Raises
    ------
    InputError
        if no images come.
    OSError
        if an image cannot be written.
    """
    written = incomplete = without_position = 0
    for frames in feed.iterate(_PATIENCE_S):
        if is_finished(written):
            break
        if frames is None:
            continue
        missing = [name for name in cameras if name not in frames.images]
        if missing and not written:
            continue  # cameras start one after another
        numbered = replace(frames, frame=f"{written + feed.dropped:05d}")
        if not writer.can_append(numbered):
            reporter.warn(
                f"{numbered.frame}: the encoder ran back or its time did not grow; the frame is left out"
            )
            continue
        writer.write(numbered)
        written += 1
        incomplete += bool(missing)
        without_position += frames.position_mm is None
        reporter.step("recording", written, max(written, 1))
    if feed.dropped:
        reporter.warn(
            f"{feed.dropped} frame sets were dropped: the disk is too slow; record as TIFF, or on an SSD"
        )
    if without_position and written:
        reporter.warn(f"{without_position} of {written} frame sets have no belt position; check [encoder]")
    return Sequence(written, incomplete, without_position, feed.dropped)
