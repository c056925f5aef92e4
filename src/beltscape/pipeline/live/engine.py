"""The running system: cameras, worker, writers and watch as threads around one `Measuring`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import monotonic, monotonic_ns, time_ns

from beltscape.alarms.board import AlarmBoard
from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.core.errors import BeltscapeError
from beltscape.core.frames import FrameSet
from beltscape.core.live import FrameEvent, LiveSource, Observer
from beltscape.core.progress import Reporter
from beltscape.pipeline.live.frame_queue import FrameQueue
from beltscape.pipeline.live.gauges import Gauges
from beltscape.pipeline.live.inspector import Looker
from beltscape.pipeline.live.measuring import Measuring, Outcome
from beltscape.pipeline.live.writer import Writer
from beltscape.sinks.historian import Historian
from beltscape.sinks.recorder import Recorder
from beltscape.sources.encoder.protocol import Encoder

_WAIT_S = 0.2
_SILENT_S = 1.0
"""Without a frame set for so long, the encoder alone tells how much belt passes."""
_SILENT_STEP_MM = 50.0
_WATCH_S = 0.5
_TEND_S = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """What an engine is made of."""

    source: LiveSource
    encoder: Encoder | None
    """None where the frame sets bring the position themselves, or nothing tells it."""
    queue: FrameQueue
    measuring: Measuring
    historian: Historian
    writers: Sequence[Writer]
    recorder: Recorder | None
    board: AlarmBoard
    looker: Looker
    gauges: Gauges
    observer: Observer
    reporter: Reporter
    """For what is worth knowing."""
    ticks: bool
    """Whether the encoder is asked where no frame set comes: not for a recording."""
    certificate_days: Callable[[], float] = lambda: float("nan")
    alive: Callable[[], None] = lambda: None
    """Called as long as all threads do their work: for a watchdog."""


class Engine:
    """Starts, watches and stops the threads; what people may ask of it is `core.live.Controls`."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._stopping = threading.Event()
        self._ended = threading.Event()
        self._done = 0
        self._heard = monotonic()
        self._ticked_mm: float | None = None
        self._threads = [
            threading.Thread(target=self._guarded(work), name=name, daemon=True)
            for name, work in (("feeder", self._feed), ("worker", self._work), ("watch", self._watch))
        ]

    def start(self) -> None:
        """Begin to measure."""
        for thread in self._threads:
            thread.start()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until a recording has ended; whether it has."""
        return self._ended.wait(seconds)

    def stop(self) -> int:
        """Stop, measure what waits, write it down; how many records no disk would take."""
        parts = self._parts
        self._stopping.set()
        parts.source.close()
        self._threads[0].join(5)
        parts.queue.close()
        self._threads[1].join(60)
        left = [writer.close() for writer in parts.writers]
        self._threads[2].join(5)
        if parts.recorder is not None:
            parts.recorder.close()
        if parts.encoder is not None:
            parts.encoder.close()
        return max(left, default=0)

    def acknowledge(self, alarm: str, by: str) -> bool:
        """Somebody has seen an alarm."""
        board, wall = self._parts.board, time_ns()
        if not board.acknowledge(alarm, by, wall):
            return False
        self._note("alarm", alarm, "acknowledged", wall, by)
        self._parts.observer.on_alarms(board.alarms)
        return True

    def keep_recording(self, reason: str, by: str) -> bool:
        """Keep what the ring of recorded frames holds."""
        recorder = self._parts.recorder
        kept = None if recorder is None else recorder.keep(reason)
        if kept is None:
            return False
        self._note("recording", kept.name, reason, time_ns(), by)
        return True

    def _note(self, kind: str, name: str, text: str, wall_ns: int, by: str = "") -> None:
        """An event for the history; a disk that does not take it holds up nothing."""
        try:
            self._parts.historian.note(kind, name, text, by=by, wall_ns=wall_ns)
        except BeltscapeError as error:
            self._parts.reporter.warn(f"{kind} {name} {text}: not kept: {error}")

    def _guarded(self, work: Callable[[], None]) -> Callable[[], None]:
        """A thread that fails says so and goes on: a plant's metre must not stop for one bad frame."""

        def run() -> None:
            while True:
                try:
                    work()
                    return
                except Exception as error:
                    name = threading.current_thread().name
                    self._parts.reporter.warn(f"{name}: {type(error).__name__}: {error}; going on")
                    if self._stopping.wait(1.0):
                        return

        return run

    def _feed(self) -> None:
        """Frame sets from the source, with the encoder's reading, into the queue."""
        parts = self._parts
        for frames in parts.source:
            self._heard = monotonic()
            located = self._located(frames)
            if parts.recorder is not None:
                parts.recorder.take(located)
            parts.queue.put(located)
            if self._stopping.is_set():
                return
        parts.queue.close()

    def _located(self, frames: FrameSet) -> FrameSet:
        encoder = self._parts.encoder
        if encoder is None or frames.position_mm is not None:
            return frames
        return replace(frames, position_mm=encoder.position_at(frames.time_ns, frames.frame))

    def _work(self) -> None:
        """Frame sets from the queue into the ledger."""
        parts = self._parts
        while True:
            frames = parts.queue.get(_WAIT_S)
            if frames is not None:
                self._measure(frames)
                if not len(parts.queue):
                    self._settle()
            elif parts.queue.closed:
                break
            elif parts.ticks and (tick := self._tick()) is not None:
                self._measure(tick)
        try:
            self._give(parts.measuring.finish())
        except Exception as error:
            parts.reporter.warn(
                f"at the end: {type(error).__name__}: {error}; what was not finished is missing"
            )
        self._ended.set()

    def _tick(self) -> FrameSet | None:
        """A frame set without images where no camera says anything, but the belt moves on."""
        if monotonic() - self._heard < _SILENT_S:
            return None
        now = monotonic_ns()
        tick = self._located(FrameSet(f"silent-{now // 1_000_000}", {}, now))
        position = tick.position_mm
        if position is None or (self._ticked_mm is not None and position - self._ticked_mm < _SILENT_STEP_MM):
            return None
        return tick

    def _measure(self, frames: FrameSet) -> None:
        parts, began = self._parts, monotonic()
        self._ticked_mm = frames.position_mm
        try:
            outcome = parts.measuring.push(frames)
        except Exception as error:
            self._begin_anew(f"frame {frames.frame}", error)
            return
        self._give(outcome)
        self._done += 1
        gauges, depth = parts.gauges, outcome.depth
        gauges.saw(depth, outcome.speed_mm_s)
        gauges.encoder_ratio = parts.measuring.encoder_ratio
        parts.observer.on_frame(
            FrameEvent(
                frames,
                self._done,
                parts.queue.dropped,
                len(parts.queue),
                monotonic() - began,
                0.0 if depth is None else depth.coverage,
                outcome.speed_mm_s,
            )
        )

    def _settle(self) -> None:
        """No frame set waits: there is time to measure the one that was only matched."""
        try:
            self._give(self._parts.measuring.settle())
        except Exception as error:
            self._begin_anew("measuring", error)

    def _begin_anew(self, where: str, error: Exception) -> None:
        self._parts.reporter.warn(f"{where}: {type(error).__name__}: {error}; beginning anew after it")
        self._parts.measuring.abandon()

    def _give(self, outcome: Outcome) -> None:
        """Entries to the writers, pieces of belt to whoever looks."""
        for stretch in outcome.stretches:
            self._parts.observer.on_surface(stretch)
        if outcome.entries:
            self._parts.gauges.add(outcome.entries)
            for writer in self._parts.writers:
                writer.put(outcome.entries)

    def _watch(self) -> None:
        """Health and alarms, twice a second; the historian's housekeeping, once a minute."""
        tended = monotonic()
        while not self._stopping.wait(_WATCH_S):
            self._judge()
            if monotonic() - tended > _TEND_S:
                tended = monotonic()
                self._parts.historian.tend(time_ns())
            if self._threads[1].is_alive():
                self._parts.alive()

    def _judge(self) -> None:
        parts = self._parts
        cameras = parts.source.health()
        parts.observer.on_health(cameras)
        parts.looker.look(parts.gauges)
        troubles = [writer.trouble for writer in parts.writers] + [parts.historian.trouble]
        recording = "" if parts.recorder is None else parts.recorder.trouble
        encoder = parts.encoder
        readings = parts.gauges.readings(
            cameras=cameras,
            dropped=parts.queue.dropped,
            history_trouble=next((text for text in troubles if text), ""),
            recording_trouble=recording,
            encoder=None if encoder is None else (encoder.silent_s, encoder.trouble),
            certificate_days=parts.certificate_days(),
        )
        wall = time_ns()
        changed = parts.board.update(readings, wall, monotonic_ns())
        for alarm in changed:
            text = f"{alarm.state}: {alarm.detail}" if alarm.detail else alarm.state
            self._note("alarm", alarm.name, text, wall)
            if alarm.state == "raised" and alarm.severity == "critical" and parts.recorder is not None:
                parts.recorder.keep(alarm.name)
        parts.observer.on_alarms(parts.board.alarms)


def told(observer: Observer, historian: Historian) -> Callable[[Sequence[BeltRecord]], None]:
    """Tells an observer of records once they are on disk."""
    return lambda records: observer.on_records(records, historian.totals)
