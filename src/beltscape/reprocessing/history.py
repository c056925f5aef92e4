"""The joined ledger as a history of its own, which pages, exports and comparisons read like a plant's.

The entries of a piece are kept as bytes. Pieces are joined in the order of the recordings, so that every millimetre
counts once; product and batch of a record are those at its time, from the timetable and the plant's own history.
"""

from __future__ import annotations

import base64
import json
import math
import shutil
import sqlite3
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, astuple, dataclass, fields, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.ledger import STANDINGS, BeltRecord, CrossSection, FlowRecord, RecordTag, SigmaParts
from beltscape.core.progress import Reporter
from beltscape.files.atomic import output_error
from beltscape.measure.flow.density import Density
from beltscape.pipeline.live.ledger import add_tag
from beltscape.pipeline.live.measuring_parts import describe_provenance
from beltscape.pipeline.live.project import Project, RunSettings, read_density
from beltscape.production.calendar import open_zone
from beltscape.production.shifts import find_due_change
from beltscape.reprocessing.manifest import Manifest
from beltscape.reprocessing.pieces import Piece, PieceResult, PieceTimes
from beltscape.sinks.historian.historian import Historian
from beltscape.sinks.historian.production import read_changes
from beltscape.sinks.historian.reading import ChangedMeanwhileError, open_history
from beltscape.sinks.historian.recovery import DATABASE

SEAM_MM = 2.0
"""Largest difference of two pieces about their seam that is not named: positions by the material scatter by less."""
NOT_MEASURED = "the piece of the recording could not be measured"


@dataclass(frozen=True, slots=True)
class Seam:
    """A place at which two pieces disagree about the end of one and the beginning of the next."""

    recording: str
    difference_mm: float
    """Beginning of the later less the end of the earlier piece; the ledger goes on without it."""


class LedgerJoiner:
    """Joins the entries of successive pieces into records that follow each other without gap or overlap.

    Positions are the encoder's; where it was reset, and without one, the ledger goes on with the belt's lengths. The
    belt of a piece that could not be measured is one missing record.
    """

    def __init__(
        self, density: Density, find_tag: Callable[[int], RecordTag], run: int = 1, number: int = 1
    ) -> None:
        """``find_tag`` returns product and batch at a system clock's time; ``number`` is that of the first record."""
        self.run = run
        """Run of the records."""
        self._density, self._find_tag, self._number = density, find_tag, number
        self._end_mm: float | None = None
        self._offset_mm = 0.0
        """Ledger position less encoder position."""
        self._parts = SigmaParts()
        self._wall_ns = 0
        self.seams: list[Seam] = []
        """Seams at which pieces disagree by more than `SEAM_MM`."""

    def add(self, piece: Piece, entries: Iterable[BeltRecord] | None) -> Iterator[BeltRecord]:
        """Yield the records of the next piece; ``entries`` None: it could not be measured."""
        if entries is None:
            yield from self._add_missing(piece)
            return
        for index, entry in enumerate(entries):
            if not index:
                self._place(piece, entry.belt_mm[0])
            yield self._make_record(piece, entry)

    def _place(self, piece: Piece, begin_mm: float) -> None:
        """Set the offset with which a piece's positions continue the ledger."""
        end = self._end_mm
        if end is None:
            self._end_mm = begin_mm
            return
        has_encoder = piece.own[0].frame.position_mm is not None
        continues = piece.previous_mm is not None or (piece.is_continuation and has_encoder)
        if not continues:  # the encoder was reset, or there is none: the whole belt in the first view is new
            self._offset_mm = end - begin_mm
            return
        difference_mm = begin_mm + self._offset_mm - end
        if abs(difference_mm) > SEAM_MM:
            self.seams.append(Seam(piece.recording, difference_mm))
            self._offset_mm -= difference_mm

    def _make_record(self, piece: Piece, entry: BeltRecord) -> BeltRecord:
        begin = self._end_mm or 0.0
        end = max(begin, entry.belt_mm[1] + self._offset_mm)
        strip = entry.strip
        if strip is not None:
            self._parts += strip.sigma_parts
            self._wall_ns = (strip.time_ns or 0) + (piece.start_wall_ns or 0)
            density, sigma = self._density.at(strip.time_ns)
            strip = replace(strip, density_kg_m3=density, density_sigma_kg_m3=sigma)
        record = replace(
            entry,
            number=self._number,
            run=self.run,
            belt_mm=(begin, end),
            wall_ns=self._wall_ns,
            strip=strip,
            run_sigma_mm3=self._parts.sigma_mm3,
            offset_mm=self._offset_mm + entry.offset_mm,
        )
        self._number, self._end_mm = self._number + 1, end
        return add_tag(record, self._find_tag(self._wall_ns))

    def _add_missing(self, piece: Piece) -> Iterator[BeltRecord]:
        """Yield the belt of a piece that was not measured as missing; without an encoder its length is not known."""
        first, last = (piece.own[index].frame for index in (0, -1))
        before = piece.lead_in[-1].frame.position_mm if piece.lead_in else piece.previous_mm
        before = first.position_mm if before is None else before
        length_mm = 0.0 if before is None or last.position_mm is None else max(0.0, last.position_mm - before)
        self._wall_ns = last.time_ns + (piece.start_wall_ns or 0)
        begin = 0.0 if self._end_mm is None else self._end_mm
        record = BeltRecord(
            number=self._number,
            run=self.run,
            belt_mm=(begin, begin + length_mm),
            standing="missing",
            reason=NOT_MEASURED,
            wall_ns=self._wall_ns,
            strip=None,
            run_sigma_mm3=self._parts.sigma_mm3,
            cameras=0,
            section=None,
            offset_mm=self._offset_mm,
        )
        self._number, self._end_mm = self._number + 1, record.belt_mm[1]
        yield record


_LATEST_NS = 2**63 - 1
"""The last time that SQLite can hold."""
_MINUTE_NS = 60 * 10**9
"""The live system looks at its timetable once a minute."""
Change = tuple[int, str]
"""System clock, ns, and the name of the product from then on."""


def read_product_changes(project: Project[RunSettings], reporter: Reporter) -> list[Change]:
    """Return the changes that people and the timetable made in the plant, by its own history, if there is one."""
    path = project.resolve(project.settings.data) / DATABASE
    if not project.settings.products or not path.is_file():
        return []
    try:
        with open_history(path) as connection:
            return [(one.wall_ns, one.product) for one in read_changes(connection, 0, _LATEST_NS)]
    except (ChangedMeanwhileError, sqlite3.Error, OSError) as error:
        reason = " ".join(str(error).split()) or "it changes meanwhile"
        reporter.warn(f"{path}: cannot be read ({reason}); products follow the timetable alone")
        return []


def find_no_product(wall_ns: int) -> RecordTag:
    """Return no product, whatever the time."""
    del wall_ns
    return RecordTag()


def make_tag_finder(project: Project[RunSettings], changes: Sequence[Change]) -> Callable[[int], RecordTag]:
    """Return the function that gives a record's product by the system clock's time.

    The newest change counts: of the timetable, or of ``changes``, which people made; before the first of them the
    settings' first product. Densities are those of the settings.
    """
    settings, production = project.settings, project.settings.production
    if not settings.products:
        return find_no_product
    by_name = {product.name: product for product in settings.products}
    zone, first = open_zone(production.time_zone), production.product or settings.products[0].name
    known = sorted(change for change in changes if change[1] in by_name)
    times = [wall_ns for wall_ns, _ in known]
    due_by_minute: dict[int, Change | None] = {}

    def find_due(wall_ns: int) -> Change | None:
        minute = wall_ns // _MINUTE_NS
        if minute not in due_by_minute:
            due = find_due_change(production.timetable, zone, minute * _MINUTE_NS)
            due_by_minute.clear()
            due_by_minute[minute] = None if due is None else (due.wall_ns, due.product)
        return due_by_minute[minute]

    def find_tag(wall_ns: int) -> RecordTag:
        due, place = find_due(wall_ns), bisect_right(times, wall_ns)
        made = known[place - 1] if place else None
        newest = max((one for one in (due, made) if one is not None), default=(0, first))
        product = by_name[newest[1]]
        return RecordTag(product.name, product.density_kg_m3, product.sigma_kg_m3)

    return find_tag


_STRIP_FIELDS = tuple(field.name for field in fields(FlowRecord) if field.name != "sigma_parts")
_OWN_FIELDS = ("belt_mm", "standing", "reason", "cameras", "offset_mm")
"""Fields of an entry that its piece determines; the others are given where the pieces are joined."""


def encode_result(result: PieceResult) -> bytes:
    """Return a piece's result as bytes; floats keep every digit, NaN included."""
    document = {
        "entries": [_encode_entry(entry) for entry in result.entries],
        "warnings": result.warnings,
        "times": asdict(result.times),
    }
    return zlib.compress(json.dumps(document, separators=(",", ":")).encode(), 1)


def decode_result(data: bytes) -> PieceResult:
    """Return the result that `encode_result` encoded."""
    document = json.loads(zlib.decompress(data))
    entries = tuple(map(_decode_entry, document["entries"]))
    return PieceResult(entries, tuple(document["warnings"]), PieceTimes(**document["times"]))


def _encode_entry(record: BeltRecord) -> dict[str, Any]:
    strip = record.strip
    values: dict[str, Any] = {name: getattr(record, name) for name in _OWN_FIELDS}
    if strip is not None:
        values["strip"] = [getattr(strip, name) for name in _STRIP_FIELDS]
        values["parts"] = astuple(strip.sigma_parts)
    if record.section is not None:
        values["section"] = [_encode_array(a) for a in (record.section.x_mm, record.section.height_mm)]
    return values


def _decode_entry(values: dict[str, Any]) -> BeltRecord:
    strip, section = values.pop("strip", None), values.pop("section", None)
    parts = SigmaParts(*values.pop("parts", ()))
    begin_mm, end_mm = values.pop("belt_mm")
    return BeltRecord(
        number=0,
        run=0,
        belt_mm=(begin_mm, end_mm),
        wall_ns=0,
        strip=None if strip is None else _decode_strip(strip, parts),
        run_sigma_mm3=math.nan,
        section=None if section is None else CrossSection(*map(_decode_array, section)),
        **values,
    )


def _decode_strip(values: Sequence[Any], parts: SigmaParts) -> FlowRecord:
    named = dict(zip(_STRIP_FIELDS, values, strict=True))
    low, high = named.pop("strip_mm")
    return FlowRecord(strip_mm=(low, high), sigma_parts=parts, **named)


def _encode_array(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array, "<f4").tobytes()).decode()


def _decode_array(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4").astype(np.float32)


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
    lengths: dict[str, float] = {name: getattr(totals, f"{name}_mm") for name in STANDINGS}
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
