"""The measurement of one piece, on one worker, from its images to its entries of the ledger."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import RecordingReporter, Reporter, Silent
from beltscape.files.rasters.images import decode_image
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.live.measurement.ledger import LedgerState
from beltscape.pipeline.live.measurement.measurement_run import MeasurementContext, MeasurementRun
from beltscape.pipeline.live.measuring_parts import build_context
from beltscape.pipeline.live.project import Project, RunSettings
from beltscape.reprocessing.parcel import Parcel, unpack_project
from beltscape.reprocessing.pieces import Piece, PlacedFrame
from beltscape.reprocessing.recordings.reading import FrameReader
from beltscape.reprocessing.results import PieceResult, PieceTimes
from beltscape.sources.folder import choose_image_size, scale_rig_to_images

_BEFORE, _AFTER = "before:", "after:"
"""Prefixes of the names of frames that are not a piece's own: two recordings may use the same names, and no file's
name begins so on every system."""


def measure_piece(parcel: Parcel, piece: Piece) -> PieceResult:
    """Return the entries of a piece's own frames; the same piece gives the same entries on any worker.

    Raises
    ------
    BeltscapeError
        With one line that names the fault, if the piece cannot be measured at all.
    """
    began = time.perf_counter()
    reporter, project = RecordingReporter(Silent()), unpack_project(parcel)
    rig = _scale_rig(project, piece, reporter)
    for direction in (1, -1):
        context = build_context(project, rig, reporter)
        reader = _PieceReader(piece, rig, reporter)
        setup_s = time.perf_counter() - began
        run = MeasurementRun(
            context, _begin_ledger(piece, context, direction), piece.cameras, lambda: 0, reporter
        )
        entries = _measure(run, reader.read(), reporter)
        found = 0 if run.meter is None else run.meter.direction
        if piece.previous_mm is None or found in (0, direction):
            break
    total_s = time.perf_counter() - began
    times = PieceTimes(setup_s, reader.read_s, reader.decode_s, total_s, reader.read_bytes, len(piece.frames))
    return PieceResult(tuple(_select_own(entries)), tuple(reporter.warnings), times)


def _scale_rig(project: Project[RunSettings], piece: Piece, reporter: Reporter) -> Rig:
    """Return the rig at the size of the piece's images, as `replay` scales it to its capture."""
    rig = read_rig(project.resolve(project.settings.rig))
    found = {
        name: choose_image_size(_read_sizes(piece, name), camera.size_px)
        for name, camera in rig.cameras.items()
    }
    sizes_px = {name: size for name, size in found.items() if size is not None}
    return scale_rig_to_images(rig, sizes_px, piece.recording, reporter)


def _read_sizes(piece: Piece, camera: str) -> Iterator[tuple[int, int]]:
    """Yield the (width, height) of a camera's images that can be read."""
    for placed in piece.own:
        path = placed.frame.files.get(camera)
        if path is not None:
            with suppress(InputError):
                image = decode_image(placed.place.read(path), placed.place.describe(path))
                yield image.shape[1], image.shape[0]


def _begin_ledger(piece: Piece, context: MeasurementContext, direction: int) -> LedgerState:
    """Return the ledger of a piece: it begins with the view of the first frame, or where the one before ended."""
    if piece.previous_mm is None:
        return LedgerState(1, 1, None)
    return LedgerState(1, 1, piece.previous_mm + max(-direction * y for y in context.empty_belt.window_mm))


class _PieceReader:
    """Reads the frames of a piece, which may lie in several places; those beside its own have other names."""

    def __init__(self, piece: Piece, rig: Rig, reporter: Reporter) -> None:
        self._piece, self._reporter = piece, reporter
        self._sizes_px = {name: rig.cameras[name].size_px for name in piece.cameras if name in rig.cameras}
        self.read_bytes, self.read_s, self.decode_s = 0, 0.0, 0.0

    def read(self) -> Iterator[FrameSet]:
        piece = self._piece
        yield from self._read_part(piece.lead_in, _BEFORE)
        yield from self._read_part(piece.own, "")
        yield from self._read_part(piece.lead_out, _AFTER)

    def _read_part(self, frames: Sequence[PlacedFrame], prefix: str) -> Iterator[FrameSet]:
        for place, group in groupby(frames, key=lambda one: one.place):
            reader = FrameReader(place, self._sizes_px, self._reporter)
            for frame_set in reader.read([one.frame for one in group]):
                yield replace(frame_set, frame=prefix + frame_set.frame)
            self.read_bytes += reader.read_bytes
            self.read_s += reader.read_s
            self.decode_s += reader.decode_s


def _measure(run: MeasurementRun, frames: Iterator[FrameSet], reporter: Reporter) -> list[BeltRecord]:
    """Return the entries of all frames; a frame that fails restarts the measurement, as in the live system."""
    entries: list[BeltRecord] = []
    for frame_set in frames:
        try:
            entries += run.push(frame_set).entries
        except Exception as error:
            reporter.warn(
                f"frame {frame_set.frame}: {type(error).__name__}: {error}; measuring restarts after it"
            )
            run.reset()
    return entries + run.finish().entries


def _select_own(entries: Sequence[BeltRecord]) -> Iterator[BeltRecord]:
    """Yield the entries of the own frames, each with the gap before it."""
    gap = None
    for entry in entries:
        if entry.strip is None:
            gap = entry
            continue
        if not entry.strip.frame.startswith((_BEFORE, _AFTER)):
            yield from (gap, entry) if gap is not None else (entry,)
        gap = None
