"""The measurement of one piece, on one worker, from its images to its entries of the ledger.

The worker gets the project as bytes: its settings, rig and empty belt. Densities and products are left out: they
change masses only, which are computed where the pieces are joined.
"""

from __future__ import annotations

import atexit
import hashlib
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path

from beltscape import __version__
from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.ledger import BeltRecord
from beltscape.core.progress import RecordingReporter, Reporter, Silent
from beltscape.files.belt_json import write_belt
from beltscape.files.images import decode_image
from beltscape.files.rig_json import read_rig
from beltscape.kernels import gpu_failures
from beltscape.measure.belt.settings import NOTHING_GIVEN, GivenBelt
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementContext, MeasurementRun
from beltscape.pipeline.live.measuring_parts import build_context
from beltscape.pipeline.live.project import CaptureSettings, Project, RunSettings
from beltscape.pipeline.measuring.belt import hash_empty_belt, read_empty_belt
from beltscape.reprocessing.pieces import Piece, PieceResult, PieceTimes, PlacedFrame
from beltscape.reprocessing.recordings.recording import FrameReader
from beltscape.sources.folder import choose_image_size, scale_rig_to_images

_RIG_FILE, _BELT_FILE = "rig.json", "belt.json"


@dataclass(frozen=True, slots=True)
class Parcel:
    """The settings of a project, and the files that they name."""

    settings: RunSettings
    """With paths relative to the folder into which the files are unpacked."""
    files: tuple[tuple[str, bytes], ...]
    """Name → content."""
    empty_sha256: str
    """Digest of what the empty belt was fitted to."""

    @property
    def digest(self) -> str:
        """Return the SHA-256 of all that decides the volumes: settings, rig, empty belt and the program's version.

        A fit's last bits depend on the kind of processor; so the digest is of what the empty belt was fitted to, and
        a run goes on on another machine.
        """
        parts = [__version__.encode(), self.settings.model_dump_json().encode()]
        digests = [hashlib.sha256(part).digest() for part in parts]
        digests += [
            bytes.fromhex(self.empty_sha256) if name == _BELT_FILE else hashlib.sha256(content).digest()
            for name, content in self.files
        ]
        return hashlib.sha256(b"".join(digests)).hexdigest()


def pack_project(project: Project[RunSettings], reporter: Reporter) -> Parcel:
    """Return the parcel of a project; InputError if one of its files cannot be read."""
    settings = project.settings
    empty = project.resolve(settings.empty)
    files = {
        _RIG_FILE: project.resolve(settings.rig).read_bytes(),
        _BELT_FILE: _read_belt_file(empty, settings.belt, reporter),
    }
    own = RunSettings(
        name=settings.name,
        rig=Path(_RIG_FILE),
        empty=Path(_BELT_FILE),
        capture=CaptureSettings(folder=Path("recording")),
        matching=settings.matching.model_copy(update={"threads": 0}),
        flow=settings.flow,
        health=settings.health,
    )
    digest = hash_empty_belt(empty)
    if settings.belt != NOTHING_GIVEN:
        digest = hashlib.sha256(f"{digest} {settings.belt.model_dump_json()}".encode()).hexdigest()
    return Parcel(own, tuple(sorted(files.items())), digest)


def unpack_project(parcel: Parcel) -> Project[RunSettings]:
    """Return the project of a parcel, unpacked once into a temporary folder of this process."""
    folder = _unpack(parcel.files)
    return Project(folder / "project.toml", parcel.settings)


@lru_cache(maxsize=2)
def _unpack(files: tuple[tuple[str, bytes], ...]) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="beltscape-worker-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name, content in files:
        (folder / name).write_bytes(content)
    return folder


def _read_belt_file(empty: Path, given: GivenBelt, reporter: Reporter) -> bytes:
    """Return the belt.json of an empty belt, which may be a frame or a whole reconstruction, with what is given."""
    if empty.is_file() and given == NOTHING_GIVEN:
        return empty.read_bytes()
    belt, camera = read_empty_belt(empty, reporter, given)
    with tempfile.TemporaryDirectory() as folder:
        write_belt(Path(folder) / _BELT_FILE, belt, camera)
        return (Path(folder) / _BELT_FILE).read_bytes()


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
        state = _begin_ledger(piece, context, direction)
        # which frames of a belt at rest are matched depends on those before, which the pieces do not share
        run = MeasurementRun(context, state, piece.cameras, lambda: 0, reporter, matches_all=True)
        entries = _measure(run, reader.read(), reporter)
        found = 0 if run.meter is None else run.meter.direction
        if piece.previous_mm is None or found in (0, direction):
            break
    total_s = time.perf_counter() - began
    times = PieceTimes(setup_s, reader.read_s, reader.decode_s, total_s, reader.read_bytes, len(piece.frames))
    if gpu_failures.text:
        reporter.warn(f"the GPU is no longer used, the processor takes over: {gpu_failures.text}")
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
