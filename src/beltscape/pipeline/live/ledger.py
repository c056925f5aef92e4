"""The belt ledger: turns flow records into entries that follow each other without gap or overlap over all runs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from beltscape.core.ledger import (
    BeltRecord,
    CrossSection,
    FlowRecord,
    RecordTag,
    SigmaParts,
    standing_from_quality,
)
from beltscape.files.encoder_csv import LONGEST_ROLL_BACK_MM

_NO_TAG = RecordTag()
_ROUNDING_MM = 1e-6
"""Belt positions, up to 10⁹ mm in double precision, are the same within it."""


@dataclass(slots=True)
class LedgerState:
    """The current end of the ledger, over all runs."""

    run: int
    number: int
    """Number of the next entry."""
    end_mm: float | None
    """End of the last entry; None in a new ledger."""
    offset_mm: float = 0.0
    """Ledger position less encoder position."""


@dataclass(slots=True)
class _PendingFrame:
    """A frame whose record is not finished yet."""

    frame: str
    present: int
    missing: tuple[str, ...]
    encoder_mm: float | None
    meter_mm: float | None = None
    """Belt position by the meter; None if it has none."""
    is_encoder_trusted: bool = True
    """Whether encoder and material agree as far as both are known."""
    tag: RecordTag = _NO_TAG


class Ledger:
    """Turns the records of successive meters into entries.

    A meter counts in its own belt coordinate, which follows the material; the ledger's position is the encoder's
    plus an offset. Without an encoder, and while it is not trusted, the ledger adds the meter's lengths to its last
    position; the offset changes by what the encoder counted too much or too little meanwhile.
    """

    def __init__(self, state: LedgerState, cameras: Sequence[str]) -> None:
        """``cameras`` are those that each frame should contain."""
        self.state = state
        self._cameras = tuple(cameras)
        self._pending: deque[_PendingFrame] = deque()
        self._parts = SigmaParts()
        """The parts of σ of the run's volume."""
        self._has_strip = False
        """Whether a strip of the present meter has been entered."""
        self._continues = False
        """Whether the present meter continues the encoder's count of the ledger."""
        self._reach_mm = 0.0
        """Distance behind the encoder's position at which belt has left the view, whichever way it runs."""
        self._slip_mm = 0.0
        """Encoder position less meter position, at the last frame that had both."""
        self._follows_encoder = True
        """Whether the encoder was trusted at the last frame that had a reading."""

    def begin_run(self, run: int) -> None:
        """Count the next entries, and their σ, for another run."""
        self.state.run, self._parts = run, SigmaParts()

    def begin_meter(self, encoder_mm: float | None, reach_mm: float = 0.0) -> float | None:
        """Begin a new meter at an encoder reading; return the encoder position up to which the belt is counted.

        ``reach_mm`` is the distance behind the encoder's position at which belt has left the view for certain.
        The result is None for a new ledger, without an encoder, and after a reset of the encoder, which is
        assumed if the reading is further back than a belt rolls: then the whole belt in view is new.
        """
        self._has_strip, self._slip_mm, self._follows_encoder = False, 0.0, True
        self._reach_mm = reach_mm
        end = self.state.end_mm
        if end is None:
            self._continues = True
            return None
        counted = end - self.state.offset_mm
        self._continues = encoder_mm is not None and counted - encoder_mm <= LONGEST_ROLL_BACK_MM
        return counted if self._continues else None

    def continue_by_motion(self, position_mm: float) -> float | None:
        """Begin a new meter without an encoder, whose first frame lies at ``position_mm`` of the meter before.

        Return the position of the new meter, which counts from 0, up to which the belt is counted; None for a
        new ledger.
        """
        end, slip = self.state.end_mm, self._slip_mm
        self._has_strip, self._slip_mm, self._follows_encoder, self._continues = False, 0.0, True, True
        if end is None:
            return None
        self.state.offset_mm += slip + position_mm
        return end - self.state.offset_mm

    def discard_pending(self) -> None:
        """Forget the frames whose records are not finished."""
        self._pending.clear()

    def push(
        self, frame: str, present: Collection[str], encoder_mm: float | None, tag: RecordTag = _NO_TAG
    ) -> None:
        """Register a frame that goes into the meter; its record is counted for ``tag``."""
        missing = tuple(name for name in self._cameras if name not in present)
        self._pending.append(_PendingFrame(frame, len(present), missing, encoder_mm, tag=tag))

    def set_position(self, frame: str, meter_mm: float, *, is_encoder_trusted: bool = True) -> None:
        """Set the meter's position of a pending frame."""
        for pending in reversed(self._pending):
            if pending.frame == frame:
                pending.meter_mm, pending.is_encoder_trusted = meter_mm, is_encoder_trusted
                return

    def make_entries(
        self,
        records: Sequence[FlowRecord],
        sections: Mapping[str, CrossSection],
        wall_ns: int,
    ) -> list[BeltRecord]:
        """Return the entries of finished records; belt that passed unmeasured before them is a separate entry."""
        out: list[BeltRecord] = []
        for record in records:
            pending = self._pending.popleft()
            start, end = self._strip_interval(record, pending)
            if self.state.end_mm is not None and start - self.state.end_mm > _ROUNDING_MM:
                reason = "nothing measured while it passed"
                gap = self._entry(start, None, reason, wall_ns, 0, None)
                out.append(add_tag(gap, pending.tag))
            if self.state.end_mm is None:
                self.state.end_mm = start
            reason = _reason(record, pending)
            self._parts += record.sigma_parts
            section = sections.get(record.frame)
            entry = self._entry(end, record, reason, wall_ns, pending.present, section)
            out.append(add_tag(entry, pending.tag))
        return out

    def _strip_interval(self, record: FlowRecord, pending: _PendingFrame) -> tuple[float, float]:
        """Return start and end of a strip in the ledger's position."""
        low, high = record.strip_mm
        ledger_end = self.state.end_mm
        if pending.meter_mm is None or not math.isfinite(high):
            return self._unseen_interval(pending.encoder_mm)
        if pending.encoder_mm is not None:
            self._update_slip(pending.encoder_mm - pending.meter_mm, trusted=pending.is_encoder_trusted)
        if not self._has_strip and not self._continues and ledger_end is not None:
            self.state.offset_mm = ledger_end - (low + self._slip_mm)
        shift = self._slip_mm + self.state.offset_mm
        # every strip but the first begins at the end of the one before, even if the material slips on the encoder
        first, self._has_strip = not self._has_strip, True
        start = low + shift if first or ledger_end is None else ledger_end
        return start, (high + shift if high > low else start)

    def _unseen_interval(self, encoder_mm: float | None) -> tuple[float, float]:
        """Return start and end of what has passed for certain at a frame that has no place in the meter.

        Until the first strip the encoder alone says how much has: belt behind the view, which no later frame shows.
        Belt that is still in view, or was before, counts with the next strip.
        """
        state, has_reading = self.state, encoder_mm is not None and not self._has_strip
        passed_mm = (encoder_mm or 0.0) - self._reach_mm
        if has_reading and not self._continues and state.end_mm is not None:
            state.offset_mm, self._continues = state.end_mm - passed_mm, True
        start = passed_mm if state.end_mm is None else state.end_mm
        return start, max(start, passed_mm + state.offset_mm) if has_reading else start

    def _update_slip(self, slip_mm: float, *, trusted: bool) -> None:
        """Follow the encoder by the change of its slip; leave the change out while the encoder is not trusted."""
        if not (trusted and self._follows_encoder):
            self.state.offset_mm += self._slip_mm - slip_mm
        self._slip_mm, self._follows_encoder = slip_mm, trusted

    def _entry(
        self,
        end_mm: float,
        strip: FlowRecord | None,
        reason: str,
        wall_ns: int,
        cameras: int,
        section: CrossSection | None,
    ) -> BeltRecord:
        """Return the next entry, which begins at the ledger's end, and advance the ledger."""
        state = self.state
        begin = end_mm if state.end_mm is None else state.end_mm
        entry = BeltRecord(
            number=state.number,
            run=state.run,
            belt_mm=(begin, max(begin, end_mm)),
            standing="missing" if strip is None else standing_from_quality(strip.quality),
            reason=reason,
            wall_ns=wall_ns,
            strip=strip,
            run_sigma_mm3=self._parts.sigma_mm3,
            cameras=cameras,
            section=section,
            offset_mm=state.offset_mm,
        )
        state.number, state.end_mm = state.number + 1, entry.belt_mm[1]
        return entry


def add_tag(entry: BeltRecord, tag: RecordTag) -> BeltRecord:
    """Return the entry with its product and batch; a product's density replaces that of the measurement."""
    strip = entry.strip
    if tag.product and strip is not None:
        density = {"density_kg_m3": tag.density_kg_m3, "density_sigma_kg_m3": tag.density_sigma_kg_m3}
        strip = replace(strip, **density)
    return replace(entry, strip=strip, product=tag.product, batch=tag.batch)


def _reason(record: FlowRecord, pending: _PendingFrame) -> str:
    """Return why a strip is not valid, in a few words; empty if it is valid."""
    if record.quality == "measured":
        return ""
    if record.reason:
        return record.reason
    if record.quality == "missing":
        return "no frame showed it"
    if record.quality == "bridged":
        return "part of it passed between frames"
    if not pending.present:
        return "no image of its own; neighbouring frames show it"
    if pending.missing:
        return f"without {', '.join(pending.missing)}"
    return "much of it was hidden, its place not told, or a camera contradicts the rig"
