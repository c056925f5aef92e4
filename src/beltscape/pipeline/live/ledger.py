"""Flow records of one run → entries of the ledger, which meet end to end from run to run."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.belt.ledger_entries import BeltRecord, CrossSection, standing_from_quality

ROLL_BACK_MM = 3000.0
"""A belt that stops may roll back by so much; an encoder that is back further has begun to count anew."""


@dataclass(slots=True)
class Books:
    """Where the ledger stands, over all runs."""

    run: int
    number: int
    """Of the next entry."""
    end_mm: float | None
    """Where the last entry ended; None in a new ledger."""
    offset_mm: float = 0.0
    """What the ledger's count is ahead of the encoder's."""


@dataclass(slots=True)
class _Pushed:
    """A frame whose record is not finished yet."""

    frame: str
    present: int
    missing: tuple[str, ...]
    encoder_mm: float | None
    place_mm: float | None = None
    """Where the meter placed the belt; None where nothing told."""


class Ledger:
    """Turns the records of meters, one after the other, into entries.

    A meter counts in its own belt coordinate, which follows the material; the ledger counts what the encoder said,
    plus an offset. Without an encoder it counts what the meter did, on from where it stood.
    """

    def __init__(self, books: Books, cameras: Sequence[str]) -> None:
        """``cameras`` are those that each frame should have."""
        self.books = books
        self._cameras = tuple(cameras)
        self._pushed: deque[_Pushed] = deque()
        self._begun = False
        self._carried = False
        self._slip_mm = 0.0
        """The encoder's count less the material's, at the last frame that had both."""

    def begin(self, encoder_mm: float | None, *, anew: bool = False) -> float | None:
        """A new meter begins at that reading: where (in the encoder's count) its belt is counted up to already.

        None where the ledger is new, there is no encoder, or it has begun ``anew``, as it must have where it is
        further back than a belt rolls: all in view is new then.
        """
        self._begun, self._slip_mm = False, 0.0
        end = self.books.end_mm
        if end is None:
            self._carried = True
            return None
        counted = end - self.books.offset_mm
        self._carried = encoder_mm is not None and not anew and counted - encoder_mm <= ROLL_BACK_MM
        return counted if self._carried else None

    def abandon(self) -> None:
        """The records of what was pushed will not come."""
        self._pushed.clear()

    def push(self, frame: str, present: Collection[str], encoder_mm: float | None) -> None:
        """A frame goes into the meter."""
        missing = tuple(name for name in self._cameras if name not in present)
        self._pushed.append(_Pushed(frame, len(present), missing, encoder_mm))

    def placed(self, frame: str, place_mm: float) -> None:
        """The meter placed a frame that was pushed."""
        for one in reversed(self._pushed):
            if one.frame == frame:
                one.place_mm = place_mm
                return

    def entries(
        self,
        records: Sequence[FlowRecord],
        sections: Mapping[str, CrossSection],
        run_sigma_mm3: float,
        wall_ns: int,
    ) -> list[BeltRecord]:
        """Finished records as entries; belt that passed unseen before the first of them is an entry of its own."""
        out: list[BeltRecord] = []
        for record in records:
            pushed = self._pushed.popleft()
            start, end = self._reach(record, pushed)
            if self.books.end_mm is not None and start > self.books.end_mm:
                reason = "nothing measured while it passed"
                out.append(self._entry(start, None, reason, run_sigma_mm3, wall_ns, 0, None))
            if self.books.end_mm is None:
                self.books.end_mm = start
            reason = _reason(record, pushed)
            section = sections.get(record.frame)
            out.append(self._entry(end, record, reason, run_sigma_mm3, wall_ns, pushed.present, section))
        return out

    def _reach(self, record: FlowRecord, pushed: _Pushed) -> tuple[float, float]:
        """From where to where a strip reaches in the ledger's count."""
        low, high = record.strip_mm
        stands = self.books.end_mm
        if pushed.place_mm is None or not math.isfinite(high):
            here = stands if stands is not None else (pushed.encoder_mm or 0.0)
            return here, here
        if pushed.encoder_mm is not None:
            self._slip_mm = pushed.encoder_mm - pushed.place_mm
        if not self._begun and not self._carried and stands is not None:
            self.books.offset_mm = stands - (low + self._slip_mm)
        shift = self._slip_mm + self.books.offset_mm
        # but for the first, a strip begins where the one before ended, though the material slips on the encoder
        first, self._begun = not self._begun, True
        start = low + shift if first or stands is None else stands
        return start, (high + shift if high > low else start)

    def _entry(
        self,
        end_mm: float,
        strip: FlowRecord | None,
        reason: str,
        run_sigma_mm3: float,
        wall_ns: int,
        cameras: int,
        section: CrossSection | None,
    ) -> BeltRecord:
        """The next entry, from where the ledger stands."""
        books = self.books
        begin = end_mm if books.end_mm is None else books.end_mm
        entry = BeltRecord(
            number=books.number,
            run=books.run,
            belt_mm=(begin, max(begin, end_mm)),
            standing="missing" if strip is None else standing_from_quality(strip.quality),
            reason=reason,
            wall_ns=wall_ns,
            strip=strip,
            run_sigma_mm3=run_sigma_mm3,
            cameras=cameras,
            section=section,
            offset_mm=books.offset_mm,
        )
        books.number, books.end_mm = books.number + 1, entry.belt_mm[1]
        return entry


def _reason(record: FlowRecord, pushed: _Pushed) -> str:
    """Why a strip is not valid, in a few words; empty where it is."""
    if record.quality == "measured":
        return ""
    if record.quality == "missing":
        return "no frame showed it"
    if record.quality == "bridged":
        return "part of it passed between frames"
    if pushed.missing:
        return f"without {', '.join(pushed.missing)}"
    return "much of it was hidden, its place not told, or a camera contradicts the rig"
