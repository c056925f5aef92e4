"""The joining of pieces into one ledger: every millimetre once, in the order of the recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from beltscape.core.belt.ledger_entries import BeltRecord, RecordTag
from beltscape.core.belt.sigma_parts import SigmaParts
from beltscape.measure.flow.records.density import Density
from beltscape.pipeline.live.measurement.ledger import add_tag
from beltscape.reprocessing.pieces import Piece

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
