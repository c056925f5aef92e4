"""The joined ledger as a history of its own, which pages, exports and comparisons read like a plant's."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from beltscape.core.belt.ledger_entries import STANDINGS, BeltRecord
from beltscape.core.progress import Reporter
from beltscape.files.folders.atomic import output_error
from beltscape.pipeline.live.measuring_parts import describe_provenance
from beltscape.pipeline.live.project import Project, RunSettings, read_density
from beltscape.reprocessing.history.entries_file import decode_result
from beltscape.reprocessing.history.joining import LedgerJoiner, Seam
from beltscape.reprocessing.history.products import Change, make_tag_finder
from beltscape.reprocessing.manifest import Manifest
from beltscape.reprocessing.pieces import Piece
from beltscape.sinks.historian.historian import Historian

_AT_ONCE = 2000
"""Records in one transaction: some MB."""
_MOST_FINDINGS = 200
"""Different findings that are kept; a damaged disk can give one for every image."""


@dataclass(frozen=True, slots=True)
class JoinedLedger:
    """Sums of the joined ledger."""

    totals: dict[str, Any]
    lengths_mm: dict[str, float]
    """Length of belt by standing."""
    seams: Sequence[Seam]
    findings: list[str]
    """What the pieces' measurements found, with the recording, each once."""
    folder: Path


def join_pieces(
    pieces: Sequence[Piece],
    manifest: Manifest,
    project: Project[RunSettings],
    changes: Sequence[Change],
    folder: Path,
    reporter: Reporter,
) -> JoinedLedger:
    """Write the ledger of all pieces into ``folder``, which is replaced only when it is complete.

    ``changes`` are those of the product in the plant.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    joiner = LedgerJoiner(read_density(project), make_tag_finder(project, changes))
    findings: dict[str, None] = {}
    with closing(Historian(part, project.settings.history)) as historian:
        joiner.run = historian.begin_run(describe_provenance(project))
        records = _join(pieces, manifest, joiner, findings, reporter)
        while batch := list(islice(records, _AT_ONCE)):
            historian.write(batch)
        totals = historian.totals
    try:
        shutil.rmtree(folder, ignore_errors=True)
        part.replace(folder)
    except OSError as error:
        raise output_error(folder, error) from error
    lengths = {name: getattr(totals, f"{name}_mm") for name in STANDINGS}
    return JoinedLedger(asdict(totals), lengths, joiner.seams, list(findings)[:_MOST_FINDINGS], folder)


def _join(
    pieces: Sequence[Piece],
    manifest: Manifest,
    joiner: LedgerJoiner,
    findings: dict[str, None],
    reporter: Reporter,
) -> Iterator[BeltRecord]:
    """Yield the records of all pieces in order."""
    results = manifest.read_results(piece.key for piece in pieces)
    for done, (piece, encoded) in enumerate(zip(pieces, results, strict=True), 1):
        result = None if encoded is None else decode_result(encoded)
        if result is not None:
            findings.update(dict.fromkeys(f"{piece.recording}: {text}" for text in result.warnings))
        yield from joiner.add(piece, None if result is None else result.entries)
        reporter.step("joining pieces", done, len(pieces))
