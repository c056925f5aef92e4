"""The re-processing of all recordings of a source: found, cut, measured on the workers, joined into one ledger."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.files.atomic import write_text
from beltscape.files.json_text import write_json
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.live import zero
from beltscape.pipeline.live.measuring_parts import build_context, describe_provenance
from beltscape.pipeline.live.project import Project, RunSettings
from beltscape.reprocessing.history import (
    Change,
    JoinedLedger,
    decode_result,
    encode_result,
    join_pieces,
    read_product_changes,
)
from beltscape.reprocessing.manifest import Manifest, WorkSpan
from beltscape.reprocessing.measuring import Parcel, measure_piece, pack_project
from beltscape.reprocessing.pieces import PIECE_FRAMES, Piece, compute_overlap, cut_into_pieces
from beltscape.reprocessing.recordings.discovery import find_recordings
from beltscape.reprocessing.recordings.recording import Recording, Unreadable
from beltscape.reprocessing.throughput import Throughput
from beltscape.sinks.historian.reading import HISTORY
from beltscape.workers.options import WorkerOptions
from beltscape.workers.tasks import run_tasks

RESULT = "reprocessing.json"
REPORT = "report.html"


@dataclass(frozen=True, slots=True)
class Failure:
    """A piece that could not be measured; the next run tries it again."""

    piece: Piece
    reason: str


@dataclass(frozen=True, slots=True)
class FoundRecordings:
    """The recordings found, and their pieces."""

    recordings: Sequence[Recording]
    unreadable: Sequence[Unreadable]
    pieces: Sequence[Piece]


def reprocess(
    source: str,
    project: Project[RunSettings],
    store: Path,
    options: WorkerOptions,
    reporter: Reporter,
    piece_frames: int = PIECE_FRAMES,
) -> dict[str, Any]:
    """Measure all recordings of ``source`` by ``project`` into ``store``; return the result of ``--json``.

    What an earlier run into the same store has measured is not measured again. Records and totals are the same with
    any number of workers, and whatever was interrupted.

    Raises
    ------
    InputError, SettingsError, MeasureError, OutputError
        With one line that names the fault and the fix.
    """
    parcel = pack_project(project, reporter)
    found = _find(source, project, piece_frames, reporter)
    with closing(Manifest(store, parcel.digest)) as manifest:
        throughput = Throughput(store, len(found.pieces))
        failures = _measure_missing(found.pieces, manifest, parcel, options, throughput, reporter)
        changes = read_product_changes(project, reporter)
        state = _digest_result(found, failures, project, changes)
        earlier = _read_earlier(store, manifest, state)
        if earlier is not None:
            return {**earlier, "measured_now": 0, "changed": False}
        manifest.remove_others(piece.key for piece in found.pieces)
        ledger = join_pieces(found.pieces, manifest, project, changes, store / HISTORY, reporter)
        document = _describe(found, failures, ledger, throughput)
        # workers, which import this module, draw no report
        from beltscape.reprocessing.report import render_report

        write_json(store / RESULT, document)
        write_text(store / REPORT, render_report(document, ledger, manifest.list_spans()))
        manifest.write_about("joined", state)
    return {**document, "changed": True}


def _find(
    source: str, project: Project[RunSettings], piece_frames: int, reporter: Reporter
) -> FoundRecordings:
    """Return the recordings of a source and their pieces; InputError where there is none."""
    settings = project.settings
    if (
        settings.encoder.kind in ("capture", "file")
        and settings.capture is not None
        and settings.encoder.path
    ):
        raise InputError(
            f"{project.path}: [encoder] path = {settings.encoder.path!r} belongs to one capture; every recording has "
            "its own encoder.csv: remove path"
        )
    zero_path = project.resolve(settings.data) / zero.FILE
    if zero_path.is_file():
        reporter.warn(
            f"{zero_path}: the zero that was set in the plant is not used; name a belt.json with it as empty = … "
            "(beltscape measure zero)"
        )
    rig = read_rig(project.resolve(settings.rig))
    reference = build_context(project, rig, reporter).empty_belt
    recordings, unreadable = find_recordings(
        source,
        {name: camera.size_px for name, camera in rig.cameras.items()},
        rig.core,
        with_positions=settings.encoder.kind not in ("none", "constant"),
        frames_per_s=None if settings.capture is None else settings.capture.frames_per_s,
        reporter=reporter,
    )
    for one in unreadable:
        reporter.warn(f"{one.name}: {one.reason}")
    pieces = cut_into_pieces(recordings, compute_overlap(reference, settings.flow), piece_frames)
    return FoundRecordings(recordings, unreadable, pieces)


def _measure_missing(
    pieces: Sequence[Piece],
    manifest: Manifest,
    parcel: Parcel,
    options: WorkerOptions,
    throughput: Throughput,
    reporter: Reporter,
) -> list[Failure]:
    """Measure the pieces that are not done; return those that failed."""
    done = manifest.list_keys()
    missing = [piece for piece in pieces if piece.key not in done]
    throughput.begin(missing)
    failures: list[Failure] = []
    stage = "measuring pieces"
    reporter.step(stage, len(pieces) - len(missing), len(pieces))
    ends = run_tasks(_measure_encoded, parcel, missing, options, _name_piece)
    with closing(ends):
        for end in ends:
            piece = missing[end.number]
            if end.value is None:
                failures.append(Failure(piece, end.failure))
                reporter.warn(f"{_name_piece(piece)}: {end.failure}; it is tried again by the next run")
            else:
                span = WorkSpan(end.worker, end.begin_s, end.seconds)
                manifest.add(piece.key, piece.recording, end.value, span)
                throughput.add(piece, decode_result(end.value).times, span)
            reporter.step(stage, throughput.done + len(failures) + len(pieces) - len(missing), len(pieces))
    throughput.end()
    return sorted(failures, key=lambda failure: failure.piece.number)


def _measure_encoded(parcel: Parcel, piece: Piece) -> bytes:
    """Return a piece's result as bytes, as the manifest keeps it."""
    return encode_result(measure_piece(parcel, piece))


def _name_piece(piece: Piece) -> str:
    first, last = (piece.own[index].frame.frame for index in (0, -1))
    return f"{piece.recording} frames {first} to {last}"


def _digest_result(
    found: FoundRecordings,
    failures: Sequence[Failure],
    project: Project[RunSettings],
    changes: Sequence[Change],
) -> str:
    """Return a digest of everything that the joined ledger depends on."""
    settings = project.settings
    content = [
        [piece.key for piece in found.pieces],
        [failure.piece.key for failure in failures],
        [[one.name, one.reason] for one in found.unreadable],
        describe_provenance(project),
        settings.model_dump(mode="json", include={"density", "products", "production", "history"}),
        changes,
    ]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def _read_earlier(store: Path, manifest: Manifest, state: str) -> dict[str, Any] | None:
    """Return the result of an earlier run that nothing has changed since; None otherwise."""
    files = [store / RESULT, store / REPORT, store / HISTORY]
    if manifest.read_about("joined") != state or not all(path.exists() for path in files):
        return None
    return json.loads((store / RESULT).read_text(encoding="utf-8"))


def _describe(
    found: FoundRecordings, failures: Sequence[Failure], ledger: JoinedLedger, throughput: Throughput
) -> dict[str, Any]:
    """Return the result as plain values."""
    return {
        "recordings": len(found.recordings),
        "frames": sum(len(recording.frames) for recording in found.recordings),
        "pieces": len(found.pieces),
        "measured_now": throughput.done,
        "failed": [{"piece": _name_piece(one.piece), "reason": one.reason} for one in failures],
        "unreadable": [{"name": one.name, "reason": one.reason} for one in found.unreadable],
        "totals": ledger.totals,
        "standings": ledger.lengths_mm,
        "seams": [{"recording": one.recording, "difference_mm": one.difference_mm} for one in ledger.seams],
        "findings": ledger.findings,
        "work": throughput.describe(),
        "history": HISTORY,
        "report": REPORT,
    }
