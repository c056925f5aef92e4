"""Frame sets with the encoder's reading → entries of the ledger: all of a run but its threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2

from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.belt.ledger_entries import BeltRecord, CrossSection
from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet, Image
from beltscape.core.live import BeltStretch
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.measure.flow.fusion.empty_belt_reference import Ground
from beltscape.measure.flow.fusion.rows import BeltPiece
from beltscape.measure.flow.meter import FlowMeter, Step
from beltscape.measure.flow.records.density import Density
from beltscape.measure.flow.settings import FlowSettings
from beltscape.pipeline.live.ledger import Books, Ledger
from beltscape.pipeline.live.sections import Sections
from beltscape.pipeline.measuring.flow_chain import FlowChain, SequenceMatcher

_FASTEST_MM_S = 20_000.0
"""No belt is faster: a reading that says so is from an encoder that began anew."""
_JITTER_MM = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """What is measured with, the same for all of a run."""

    rig: Rig
    """At the size at which it is matched."""
    ground: Ground
    matcher: SequenceMatcher
    flow: FlowSettings
    density: Density


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one frame set gave."""

    depth: DepthMap | None
    entries: list[BeltRecord]
    stretches: list[BeltStretch]
    speed_mm_s: float
    """Of the belt now; NaN: not known."""


class Measuring:
    """One run. The same frame sets give the same entries, but for the system clock's time in them."""

    def __init__(
        self,
        bench: Bench,
        books: Books,
        cameras: Sequence[str],
        wall_ns: Callable[[], int],
        reporter: Reporter,
    ) -> None:
        """``books`` say where the ledger stands; ``wall_ns`` is the system clock."""
        self.bench = bench
        self._cameras, self._wall_ns, self._reporter = tuple(cameras), wall_ns, reporter
        self._ledger = Ledger(books, cameras)
        self._stretches: list[BeltStretch] = []
        self._sections = Sections(bench.ground)
        self._chain: FlowChain | None = None
        self._last: FrameSet | None = None
        """The last one with an encoder's reading."""
        self._uncertain_mm3 = 0.0
        """σ of the meters of this run that are finished."""

    @property
    def encoder_ratio(self) -> tuple[float, float]:
        """Encoder over material and its σ; NaN before they were compared."""
        scale = None if self._chain is None else self._chain.meter.scale
        return (
            (scale.ratio, scale.sigma)
            if scale is not None and scale.compared >= 3
            else (float("nan"), float("nan"))
        )

    def push(self, frames: FrameSet) -> Outcome:
        """The next frame set; without images it still tells where the belt was."""
        entries: list[BeltRecord] = []
        if self._chain is None:
            self._chain = self._begin(frames.position_mm, anew=False)
        elif (anew := self._anew(frames)) is not None:
            entries += self._entries(self._chain.finish())
            self._uncertain_mm3 += self._chain.meter.totals.sigma_mm3
            self._chain = self._begin(frames.position_mm, anew=anew)
        if frames.position_mm is not None:
            self._last = frames
        whole = set(self._cameras) <= set(frames.images)
        self._ledger.push(frames.frame, frames.images.keys(), frames.position_mm)
        passed = self._chain.push(self._fitted(frames), self._reporter, whole=whole)
        entries += self._entries(passed.records)
        stretches, self._stretches = self._stretches, []
        speed = self._chain.meter.motion.speed
        return Outcome(passed.depth, entries, stretches, float("nan") if speed is None else speed)

    def settle(self) -> Outcome:
        """Measure what was only matched, where there is time: the entries are the same, but earlier."""
        return self._without_frame([] if self._chain is None else self._chain.settle())

    def finish(self) -> Outcome:
        """No more frames come: the entries that are left."""
        return self._without_frame([] if self._chain is None else self._chain.finish())

    def _without_frame(self, records: Sequence[FlowRecord]) -> Outcome:
        entries = self._entries(records)
        stretches, self._stretches = self._stretches, []
        return Outcome(None, entries, stretches, float("nan"))

    def abandon(self) -> None:
        """Something failed within: begin anew with the next frame set; belt that was not finished is missing."""
        if self._chain is not None:
            self._uncertain_mm3 += self._chain.meter.totals.sigma_mm3
        self._chain, self._last, self._stretches = None, None, []
        self._ledger.abandon()

    def _begin(self, encoder_mm: float | None, *, anew: bool) -> FlowChain:
        """A meter that counts from where the ledger stands."""
        bench = self.bench
        self._sections = Sections(bench.ground)
        meter = FlowMeter(
            bench.ground,
            bench.flow,
            density=bench.density,
            watch_belt=self._watch_belt,
            watch_step=self._watch_step,
            front_mm=self._ledger.begin(encoder_mm, anew=anew),
        )
        if self._chain is not None:
            self._chain.restart(meter)
            return self._chain
        return FlowChain(bench.matcher, meter)

    def _anew(self, frames: FrameSet) -> bool | None:
        """Whether the meter must begin anew: True as the encoder does, False as there is one now, None not at all."""
        last, position = self._last, frames.position_mm
        if position is None:
            return None
        if last is None or last.position_mm is None:
            self._reporter.warn("an encoder has begun to tell the belt's position; counting on by it")
            return False
        seconds = 0.0
        if frames.time_ns is not None and last.time_ns is not None:
            seconds = max(frames.time_ns - last.time_ns, 0) * 1e-9
        step = position - last.position_mm
        if abs(step) <= _JITTER_MM + _FASTEST_MM_S * seconds:
            return None
        self._reporter.warn(
            f"the encoder jumped from {last.position_mm:.0f} to {position:.0f} mm within {seconds:.2f} s; "
            "counting on from the new reading"
        )
        return True

    def _watch_step(self, step: Step) -> None:
        self._ledger.placed(step.frame, step.place.position_mm)

    def _watch_belt(self, piece: BeltPiece) -> None:
        joined = self._sections.add(piece)
        cell = self.bench.ground.cell_mm
        seen = piece.measured[:, :: max(1, piece.measured.shape[1] // joined.shape[1])][:, : joined.shape[1]]
        self._stretches.append(BeltStretch(cell * piece.first, cell, self._sections.x_mm, joined, seen))

    def _entries(self, records: Sequence[FlowRecord]) -> list[BeltRecord]:
        if not records or self._chain is None:
            return []
        sections: dict[str, CrossSection] = {}
        for record in records:
            section = self._sections.of(record.strip_mm)
            if section is not None:
                sections[record.frame] = section
        sigma = self._uncertain_mm3 + self._chain.meter.totals.sigma_mm3
        return self._ledger.entries(records, sections, sigma, self._wall_ns())

    def _fitted(self, frames: FrameSet) -> FrameSet:
        """Its images at the size at which they are matched."""
        images = {
            name: resized(image, self.bench.rig.cameras[name].size_px)
            for name, image in frames.images.items()
            if name in self.bench.rig.cameras
        }
        return replace(frames, images=images)


def resized(image: Image, size_px: tuple[int, int]) -> Image:
    """An image made smaller by means over areas; itself where it has that size."""
    if image.shape[1::-1] == tuple(size_px):
        return image
    return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)  # pyright: ignore[reportReturnType]
