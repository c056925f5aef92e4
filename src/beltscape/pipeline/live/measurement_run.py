"""One measurement run without its threads: frame sets with encoder readings in, ledger entries out.

The mean cross-section of each strip is taken from a buffer of finished belt rows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.events import BeltStretch
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.core.ledger import BeltRecord, CrossSection, FlowRecord, RecordTag
from beltscape.core.progress import Reporter
from beltscape.health.images.belt_images import BeltImageMonitor
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import EmptyBeltReference
from beltscape.measure.flow.blocks import BeltPiece
from beltscape.measure.flow.density import Density
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from beltscape.measure.flow.settings import FlowSettings
from beltscape.pipeline.live.frame_choice import RepeatChoice
from beltscape.pipeline.live.learned_images import LearnedImages
from beltscape.pipeline.live.ledger import Ledger, LedgerState
from beltscape.pipeline.measuring.flow_chain import FlowChain
from beltscape.pipeline.reconstructing.checked_matcher import SequenceMatcher
from beltscape.pipeline.reconstructing.frame_measurements import MeasurementRequest
from beltscape.pipeline.reconstructing.match_ahead import Submit
from beltscape.pipeline.reconstructing.monitored_matcher import PendingFrame
from beltscape.workers.calls import CallMaker
from beltscape.workers.transport import SharedObject

_SECTION_CELL_MM = 5.0
"""Approximate column width of a stored cross-section."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    s_mm: NDArray[np.float64]
    height_mm: NDArray[np.float32]


class SectionBuffer:
    """Keeps the belt rows that unfinished strips may still need."""

    def __init__(self, reference: EmptyBeltReference) -> None:
        """Prepare for the columns of the empty-belt reference, joined to about 5 mm."""
        self._cell_mm = reference.cell_mm
        self._side = max(1, round(_SECTION_CELL_MM / reference.cell_mm))
        self._columns = reference.grid.shape[1] // self._side * self._side
        x = reference.grid.x_mm[: self._columns]
        self.x_mm = x.reshape(-1, self._side).mean(axis=1).astype(np.float32)
        self._parts: deque[_Rows] = deque()

    def add(self, piece: BeltPiece) -> NDArray[np.float32]:
        """Add a finished piece; return its heights, (n, Nx) float32 mm, on the joined columns."""
        height = piece.height_mm[:, : self._columns]
        joined = height.reshape(len(height), -1, self._side).mean(axis=2).astype(np.float32)
        s = self._cell_mm * (piece.first + np.arange(len(joined), dtype=np.float64))
        self._parts.append(_Rows(s, joined))
        return joined

    def mean_section(self, strip_mm: tuple[float, float]) -> CrossSection | None:
        """Return the mean section of a strip (of its row if it has no length); earlier rows are removed."""
        low, high = strip_mm
        half = self._cell_mm / 2
        while self._parts and self._parts[0].s_mm[-1] + half < low:
            self._parts.popleft()
        near = [rows.height_mm[_within(rows.s_mm, low - half, high + half)] for rows in self._parts]
        rows = np.concatenate(near) if near else np.empty((0, len(self.x_mm)), np.float32)
        return (
            CrossSection(self.x_mm, rows.mean(axis=0, dtype=np.float64).astype(np.float32))
            if len(rows)
            else None
        )


def _within(s_mm: NDArray[np.float64], low_mm: float, high_mm: float) -> slice:
    first, last = np.searchsorted(s_mm, [low_mm, high_mm])
    return slice(int(first), int(last))


_NO_TAG = RecordTag()


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementContext:
    """Rig, empty belt, matcher and settings; they change between two records only."""

    rig: Rig
    """At the image size that is matched."""
    empty_belt: EmptyBeltReference
    matcher: SequenceMatcher
    flow: FlowSettings
    density: Density
    belt_limits: BeltLimits | None = None
    """Limits of the comparison of the bare belt with the learned one; None: the defaults."""
    images: BeltImageMonitor | None = None
    """Checks the images against the measured surface and motion."""
    empty_belt_sha256: str = ""
    """Of the files that the learned empty belt was read from; empty: nothing is kept beside it."""
    learned_images: LearnedImages = field(default_factory=LearnedImages)
    """What is learned of the images."""
    submit: Submit | None = None
    """Begins to match a frame set on a worker; None: the matcher matches each in its turn."""
    calls: CallMaker | None = None
    """Has holes filled beside the thread that measures; None: it fills them itself."""

    def with_empty_belt(self, empty_belt: EmptyBeltReference) -> MeasurementContext:
        """Return the context with another empty belt of the same camera."""
        return replace(self, empty_belt=empty_belt)


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """The result of one frame set."""

    depth: DepthMap | None
    entries: list[BeltRecord]
    stretches: list[BeltStretch]
    speed_mm_s: float
    """Present speed of the belt; NaN: not known."""
    findings: tuple[Finding, ...] = ()
    """The findings of all checks of the frame set."""
    is_repeat: bool = False
    """Whether its images were checked only: it shows the belt of the last matched frame set."""


class MeasurementRun:
    """One run; the same frame sets give the same entries except for the system clock's time in them."""

    def __init__(
        self,
        context: MeasurementContext,
        state: LedgerState,
        cameras: Sequence[str],
        wall_ns: Callable[[], int],
        reporter: Reporter,
        *,
        matches_all: bool = False,
    ) -> None:
        """``state`` is the end of the ledger; ``wall_ns`` is the system clock.

        ``matches_all``: a belt at rest is matched at the full rate, too.
        """
        self.context, self._matches_all = context, matches_all
        self._cameras, self._wall_ns, self._reporter = tuple(cameras), wall_ns, reporter
        self._ledger = Ledger(state, cameras)
        self._stretches: list[BeltStretch] = []
        self._sections = SectionBuffer(context.empty_belt)
        self._chain: FlowChain | None = None
        self._choice = self._expected = RepeatChoice(0.0)
        """Which frame sets are matched; of those that are submitted, which will probably be."""
        self._tag = _NO_TAG
        """What the last matched frame set was counted for."""
        self._has_encoder = False
        """Whether a frame set of the present meter had an encoder reading."""
        self._needs_new_meter = False
        self._next: tuple[MeasurementContext, int] | None = None
        """The context to measure in from the next frame set on, and the run of its records."""
        self.first_number = state.number
        """Number of the first record of the present context."""

    @property
    def meter(self) -> BeltFlowMeter | None:
        """Return the present meter; None before the first frame set and after a failure."""
        return None if self._chain is None else self._chain.meter

    def set_context(self, context: MeasurementContext, run: int) -> None:
        """Measure in another context, of the same cameras, from the next frame set on.

        The records of earlier frames end before it, and its records belong to ``run``. Without an encoder it waits
        until the belt's motion is known, as the belt between two frame sets would be lost.
        """
        self._next = context, run

    def set_empty_belt(self, empty_belt: EmptyBeltReference) -> None:
        """Measure against another empty belt, of the same camera, from the next frame on."""
        self.context = self.context.with_empty_belt(empty_belt)
        self._needs_new_meter = True

    def submit(self, frames: FrameSet, ahead: int) -> PendingFrame | None:
        """Begin to match a frame set that is pushed later; None where it is matched when it is pushed.

        ``ahead`` others are submitted and are pushed before.
        """
        submit = self.context.submit
        if submit is None or not frames.images:
            return None
        resized, empty_belt, chain = self._resize(frames), self.context.empty_belt, self._chain
        if chain is None:
            limits = self.context.belt_limits or BeltLimits()
            return submit(resized, MeasurementRequest(SharedObject(empty_belt), limits, None, ahead))
        if chain.meter.follows_encoder and self._expected.is_near(frames) and self._expected.is_soon(frames):
            limits = self.context.belt_limits or BeltLimits()
            request = MeasurementRequest(SharedObject(empty_belt), limits, None, ahead)
            return submit(resized, replace(request, is_repeat=True))
        self._expected.note_matched(frames)
        return submit(resized, chain.expect(resized, ahead, empty_belt))

    def push(
        self,
        frames: FrameSet,
        findings: Sequence[Finding] = (),
        tag: RecordTag = _NO_TAG,
        pending: PendingFrame | None = None,
    ) -> Outcome:
        """Measure the next frame set; without images it only gives the belt's position.

        ``findings`` are further ones about it; its record is counted for ``tag``. ``pending`` is what `submit`
        returned for it; the result is the same without.
        """
        if self._is_repeat(frames, tag, pending):
            return self._pass_over(frames, findings)
        entries = self._change_context(frames)
        if pending is not None and (not frames.images or pending.matcher is not self.context.matcher):
            pending = None  # its images do not count any more, or it was submitted in the context before
        if self._chain is None:
            self._chain = self._begin_meter(self._begin_ledger(frames.position_mm))
        elif frames.position_mm is not None and not self._has_encoder:
            self._reporter.warn("an encoder now gives the belt's position; counting continues with it")
            self._needs_new_meter = True
        if self._needs_new_meter:
            entries += self._finish_meter(frames, self._chain, self.context.empty_belt)
            self._chain = self._continue_meter(frames, self._chain.meter)
        self._has_encoder |= frames.position_mm is not None
        if frames.images:
            self._choice.note_matched(frames)
            self._tag = tag
        whole = set(self._cameras) <= set(frames.images)
        self._ledger.push(frames.frame, frames.images.keys(), frames.position_mm, tag)
        resized = self._resize_pending(frames, pending)
        result = self._chain.push(resized, self._reporter, whole=whole, findings=findings, pending=pending)
        entries += self._make_entries(result.records)
        stretches, self._stretches = self._stretches, []
        speed = self._chain.meter.motion.speed
        speed_mm_s = float("nan") if speed is None else speed
        return Outcome(result.depth, entries, stretches, speed_mm_s, result.findings)

    def _is_repeat(self, frames: FrameSet, tag: RecordTag, pending: PendingFrame | None) -> bool:
        """Return whether a frame set shows the belt of the last matched one, and need not be matched."""
        chain, choice = self._chain, self._choice
        is_other = self._next is not None or self._needs_new_meter or tag != self._tag
        is_other |= pending is not None and pending.matcher is not self.context.matcher
        if chain is None or self._matches_all or is_other or not choice.is_near(frames):
            return False
        resized, has_moved = self._resize_pending(frames, pending), choice.has_moved(frames)
        if not chain.check_repeat(resized, self._reporter, pending, has_moved=has_moved):
            choice.note_change(frames)
            self._expected.note_change(frames)
            return False
        return choice.is_soon(frames)

    def _pass_over(self, frames: FrameSet, findings: Sequence[Finding]) -> Outcome:
        """Return the outcome of a frame set that repeats the last matched one.

        Its belt, if it has moved at all, is counted with the strip of the next frame set that is matched, as that
        of a frame set that the queue gave up.
        """
        assert self._chain is not None
        speed_mm_s = self._choice.compute_speed_mm_s(frames) / self._chain.meter.scale.ratio
        self._choice.note_passed(frames)
        result = self._chain.pass_over(frames, self._reporter)
        outcome = self._without_frame(result.records)
        found = (*findings, *result.findings, *outcome.findings)
        return replace(outcome, speed_mm_s=speed_mm_s, findings=found, is_repeat=True)

    def flush(self) -> Outcome:
        """Measure the frame that is matched but not measured yet: the entries are the same, but earlier."""
        return self._without_frame([] if self._chain is None else self._chain.flush())

    @property
    def is_filled(self) -> bool:
        """Return whether holes were being filled and `collect` need not wait for them any more."""
        return self._chain is not None and self._chain.meter.is_filled

    def collect(self) -> Outcome:
        """Return the entries whose holes have been filled; the next `push` returns them otherwise."""
        return self._without_frame([] if self._chain is None else self._chain.meter.collect())

    def finish(self) -> Outcome:
        """Return the remaining entries after the last frame."""
        return self._without_frame([] if self._chain is None else self._chain.finish())

    def _without_frame(self, records: Sequence[FlowRecord]) -> Outcome:
        entries = self._make_entries(records)
        stretches, self._stretches = self._stretches, []
        findings = () if self._chain is None else self._chain.pop_findings()
        return Outcome(None, entries, stretches, float("nan"), findings)

    def reset(self) -> None:
        """Restart after a failure with the next frame set; belt whose record was not finished becomes missing."""
        self._chain, self._has_encoder, self._stretches = None, False, []
        self._ledger.discard_pending()

    def _change_context(self, frames: FrameSet) -> list[BeltRecord]:
        """Begin the next context, if there is one, at a frame set; return the records that end before it."""
        chain, entries = self._chain, []
        if self._next is None or (chain is not None and not self._can_continue(frames, chain.meter)):
            return []
        if chain is not None:
            entries = self._finish_meter(frames, chain, self._next[0].empty_belt)
            self._chain = None
        self.context, run = self._next
        self._ledger.begin_run(run)
        self._next, self.first_number = None, self._ledger.state.number
        if chain is not None:
            self._chain = self._continue_meter(frames, chain.meter)
            self._has_encoder = frames.position_mm is not None
        return entries

    def _finish_meter(
        self, frames: FrameSet, chain: FlowChain, reference: EmptyBeltReference
    ) -> list[BeltRecord]:
        """Return the last records of the present meter; belt that stays in view is left to the next one.

        It would be measured by the few frames so far only; the next meter sees it in all that come.
        """
        records, start = chain.finish(), np.inf
        if frames.images and frames.time_ns is not None:
            start = chain.meter.predict_view_start_mm(
                frames.time_ns * 1e-9, frames.position_mm, reference.window_mm
            )
        entries = self._make_entries(list(takewhile(lambda one: not one.strip_mm[0] >= start, records)))
        self._ledger.discard_pending()
        return entries

    def _can_continue(self, frames: FrameSet, before: BeltFlowMeter) -> bool:
        """Return whether the belt between the last frame set and this one is known, by an encoder or by the speed."""
        return frames.position_mm is not None or self._has_encoder or before.prediction is not None

    def _continue_meter(self, frames: FrameSet, before: BeltFlowMeter) -> FlowChain:
        """Return the chain with a meter that continues where ``before`` ends, by the encoder or the belt's speed."""
        last, motion = before.motion.last, before.prediction
        is_by_encoder = frames.position_mm is not None or self._has_encoder
        if is_by_encoder or last is None or motion is None or frames.time_ns is None:
            return self._begin_meter(self._begin_ledger(frames.position_mm))
        travel_mm = (motion.speed or 0.0) * (frames.time_ns * 1e-9 - last.clock)
        chain = self._begin_meter(self._ledger.continue_by_motion(last.position_mm + travel_mm))
        chain.meter.continue_motion(motion)
        return chain

    def _begin_ledger(self, encoder_mm: float | None) -> float | None:
        """Begin a new meter in the ledger; return the encoder position up to which the belt is counted."""
        return self._ledger.begin_meter(encoder_mm, max(map(abs, self.context.empty_belt.window_mm)))

    def _begin_meter(self, front_mm: float | None) -> FlowChain:
        """Return the chain with a meter; the belt up to ``front_mm`` is counted."""
        context, self._needs_new_meter = self.context, False
        self._sections = SectionBuffer(context.empty_belt)
        meter = BeltFlowMeter(
            context.empty_belt,
            context.flow,
            density=context.density,
            watch_belt=self._add_stretch,
            watch_step=self._set_position,
            front_mm=front_mm,
            scale_sigma=context.rig.scale_sigma,
            calls=context.calls,
        )
        self._choice, self._expected = RepeatChoice(meter.step_mm), RepeatChoice(meter.step_mm)
        if self._chain is not None:
            self._chain.restart(meter)
            return self._chain
        return FlowChain(context.matcher, meter, context.belt_limits, context.images)

    def _set_position(self, step: FramePlacement) -> None:
        self._ledger.set_position(
            step.frame, step.place.position_mm, is_encoder_trusted=step.is_encoder_trusted
        )

    def _add_stretch(self, piece: BeltPiece) -> None:
        joined = self._sections.add(piece)
        cell = self.context.empty_belt.cell_mm
        stride = max(1, piece.measured.shape[1] // joined.shape[1])
        measured = piece.measured[:, ::stride][:, : joined.shape[1]]
        self._stretches.append(BeltStretch(cell * piece.first, cell, self._sections.x_mm, joined, measured))

    def _make_entries(self, records: Sequence[FlowRecord]) -> list[BeltRecord]:
        if not records or self._chain is None:
            return []
        sections: dict[str, CrossSection] = {}
        for record in records:
            section = self._sections.mean_section(record.strip_mm)
            if section is not None:
                sections[record.frame] = section
        return self._ledger.make_entries(records, sections, self._wall_ns())

    def _resize_pending(self, frames: FrameSet, pending: PendingFrame | None) -> FrameSet:
        """Return the frame set at the size that is matched, to which it was brought when it was submitted."""
        return self._resize(frames) if pending is None else replace(frames, images=pending.frame_set.images)

    def _resize(self, frames: FrameSet) -> FrameSet:
        """Return the frame set with its images at the size that is matched."""
        images = {
            name: resize_image(image, self.context.rig.cameras[name].size_px)
            for name, image in frames.images.items()
            if name in self.context.rig.cameras
        }
        return replace(frames, images=images)


def resize_image(image: Image, size_px: tuple[int, int]) -> Image:
    """Return the image reduced to ``size_px`` by area averages; the image itself if it has that size."""
    if image.shape[1::-1] == tuple(size_px):
        return image
    return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
