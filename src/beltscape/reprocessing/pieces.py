"""The cut of recordings into pieces that can be measured independently, with overlaps at their ends; their results.

A piece counts its *own* frames. The record of a frame is the belt that became new since the frame before, up to the
upstream end of the view; so two pieces agree on where one ends and the next begins, if the second measures the last
frame of the first, too. The frames before the own ones (the lead-in) tell the belt's motion and what lies downstream;
those after them (the lead-out) show the own belt until it has left the view. Neither is counted. The cut depends on
the recordings alone, never on the number of workers.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

from beltscape.core.ledger import BeltRecord
from beltscape.files.encoder_csv import LONGEST_ROLL_BACK_MM
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.settings import FlowSettings
from beltscape.reprocessing.recordings.recording import Place, RecordedFrame, Recording

PIECE_FRAMES = 600
"""Largest number of own frames of a piece: with 40 frames of overlap 6 % are measured twice, and what a dead worker
loses is some minutes."""
_LEAD_IN_FRAMES = 16
"""Number of frames of a lead-in without an encoder: the meter holds back eight until it knows the motion."""
_LEAD_OUT_FRAMES = 48
"""Number of frames of a lead-out without an encoder: the belt leaves the view within it from a quarter of the view's
length a second at 12 frames a second on."""
_MOST_LEAD_FRAMES = 120
"""Longest lead-in or lead-out; a belt that stands for longer is not waited for."""
_LONGEST_PAUSE_S = 2.0
"""Longest time between two recordings that are measured as one: the recorder goes on with the next frame."""


@dataclass(frozen=True, slots=True)
class Overlap:
    """Lengths of belt by which the frames beside the own ones reach."""

    lead_in_mm: float
    lead_out_mm: float


@dataclass(frozen=True, slots=True)
class PlacedFrame:
    """A frame with the place where its files are."""

    place: Place
    frame: RecordedFrame


@dataclass(frozen=True, slots=True)
class Piece:
    """Frames that are measured together, of which the own ones are counted."""

    number: int
    recording: str
    """Name of the recording of its own frames."""
    cameras: tuple[str, ...]
    """The cameras that this recording has."""
    lead_in: tuple[PlacedFrame, ...]
    own: tuple[PlacedFrame, ...]
    lead_out: tuple[PlacedFrame, ...]
    is_continuation: bool
    """Whether its belt continues that of the piece before."""
    previous_mm: float | None
    """Encoder reading of the last frame of the recording before, if the encoder went on without frames; else None."""
    start_wall_ns: int | None
    """System clock at time 0 of the frames' clock; None: not known."""
    key: str
    """SHA-256 of everything in it, the contents of its files included."""

    @property
    def frames(self) -> tuple[PlacedFrame, ...]:
        """Return all frames in order."""
        return (*self.lead_in, *self.own, *self.lead_out)


def compute_overlap(reference: EmptyBeltReference, settings: FlowSettings) -> Overlap:
    """Return the lengths of belt that lead-in and lead-out need, from the view and the filling of holes."""
    view_mm = reference.seen_mm[1] - reference.seen_mm[0]
    filling_mm = settings.block_mm + settings.margin_mm
    return Overlap(view_mm + filling_mm, view_mm + 2 * filling_mm)


def cut_into_pieces(
    recordings: Sequence[Recording], overlap: Overlap, piece_frames: int = PIECE_FRAMES
) -> list[Piece]:
    """Return the pieces of all recordings, in their order."""
    pieces: list[Piece] = []
    previous: Recording | None = None
    for sequence in join_recordings(recordings):
        frames = [PlacedFrame(one.place, frame) for one in sequence for frame in one.frames]
        digests = [one.digest for one in sequence for _ in one.frames]
        begin = 0
        for recording in sequence:
            for first, end in _split(begin, begin + len(recording.frames), piece_frames):
                previous_mm = None if first or previous is None else _find_previous_mm(previous, recording)
                pieces.append(
                    _make_piece(len(pieces), recording, frames, digests, (first, end), previous_mm, overlap)
                )
            begin += len(recording.frames)
        previous = sequence[-1]
    return pieces


def join_recordings(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Return the recordings in groups whose frames follow each other without a pause on one clock and one encoder."""
    groups: list[list[Recording]] = []
    for recording in recordings:
        if groups and _continues(groups[-1][-1], recording):
            groups[-1].append(recording)
        else:
            groups.append([recording])
    return groups


def _continues(before: Recording, after: Recording) -> bool:
    last, first = before.frames[-1], after.frames[0]
    pause_s = (first.time_ns - last.time_ns) * 1e-9
    if not 0 < pause_s <= _LONGEST_PAUSE_S:
        return False
    if last.position_mm is None or first.position_mm is None:
        return last.position_mm is first.position_mm
    return first.position_mm >= last.position_mm


def _find_previous_mm(before: Recording, after: Recording) -> float | None:
    """Return the encoder's last reading before a recording; None if it was reset since, or gave none."""
    last, first = before.frames[-1].position_mm, after.frames[0].position_mm
    if last is None or first is None or last - first > LONGEST_ROLL_BACK_MM:
        return None
    return last


def _split(begin: int, end: int, most: int) -> list[tuple[int, int]]:
    """Return a range in nearly equal parts of at most ``most``."""
    count = math.ceil((end - begin) / most)
    edges = [begin + round(part * (end - begin) / count) for part in range(count + 1)]
    return list(itertools.pairwise(edges))


def _make_piece(
    number: int,
    recording: Recording,
    frames: Sequence[PlacedFrame],
    digests: Sequence[str],
    own: tuple[int, int],
    previous_mm: float | None,
    overlap: Overlap,
) -> Piece:
    first, end = own
    begin = _find_lead(frames, first, -1, overlap.lead_in_mm, _LEAD_IN_FRAMES)
    until = _find_lead(frames, end - 1, +1, overlap.lead_out_mm, _LEAD_OUT_FRAMES) + 1
    cameras = tuple(sorted({name for frame in recording.frames for name in frame.files}))
    start = recording.start_wall_ns
    content = [
        recording.name,
        sorted(set(digests[begin:until])),
        [frame.frame.frame for frame in frames[begin:until]],
        [first - begin, end - begin, previous_mm, start],
    ]
    return Piece(
        number,
        recording.name,
        cameras,
        tuple(frames[begin:first]),
        tuple(frames[first:end]),
        tuple(frames[end:until]),
        begin < first,
        previous_mm,
        None if start is None else start - recording.frames[0].time_ns,
        hashlib.sha256(json.dumps(content).encode()).hexdigest(),
    )


def _find_lead(frames: Sequence[PlacedFrame], at: int, step: int, length_mm: float, count: int) -> int:
    """Return the index of the outermost frame of a lead that begins beside the frame ``at``."""
    here, index = frames[at].frame.position_mm, at
    while 0 <= index + step < len(frames) and abs(index - at) < _MOST_LEAD_FRAMES:
        position, passed = frames[index].frame.position_mm, abs(index - at)
        distance_mm = None if here is None or position is None else abs(position - here)
        is_far = passed >= count if distance_mm is None else distance_mm >= length_mm
        if is_far and passed >= min(count, _LEAD_IN_FRAMES):
            break
        index += step
    return index


@dataclass(frozen=True, slots=True)
class PieceTimes:
    """Times of the steps of a piece."""

    setup_s: float
    """Until the first image: settings, rig, empty belt, networks."""
    read_s: float
    """Reading of files, beside the measurement."""
    decode_s: float
    """Decoding of images, beside the measurement."""
    total_s: float
    read_bytes: int
    frames: int
    """Number of frames that were measured, the leads included."""


@dataclass(frozen=True, slots=True)
class PieceResult:
    """The measurement of a piece."""

    entries: tuple[BeltRecord, ...]
    """Those of the own frames, without densities; belt positions are the encoder's, or begin anywhere without one."""
    warnings: tuple[str, ...]
    """What was found about images, cameras and encoder, each once."""
    times: PieceTimes
