"""The engine of the live system: the threads that feed, measure, write and monitor around one `MeasurementRun`."""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import replace
from time import monotonic, monotonic_ns, thread_time, time_ns

from beltscape.alarms.readings import Readings
from beltscape.core.alarm_catalogue import MAINTENANCE
from beltscape.core.events import FrameEvent, Maintenance
from beltscape.core.frames import FrameSet
from beltscape.core.supervision import make_supervised_thread
from beltscape.core.system_calls import release_memory
from beltscape.core.translatable_message import make_event_text
from beltscape.kernels import gpu_failures
from beltscape.pipeline.live import maintenance
from beltscape.pipeline.live.drift import store_drift
from beltscape.pipeline.live.engine_components import EngineComponents, MeasuringParts, RunRegister
from beltscape.pipeline.live.gauges import CapacityMeter
from beltscape.pipeline.live.intake import Arrival
from beltscape.pipeline.live.measurement_run import Outcome
from beltscape.pipeline.live.operator_controls import OperatorControls
from beltscape.pipeline.live.reporting import RepairNotice
from beltscape.pipeline.reconstructing.monitored_matcher import PendingFrame

Submitted = deque[tuple[Arrival, PendingFrame | None]]
"""The frame sets that were taken from the queue and are not measured yet, the oldest first."""

_WAIT_S = 0.2
"""Longest wait for a frame set before the engine checks whether it must stop."""
_SILENT_S = 1.0
"""After this time without a frame set, the belt's motion is taken from the encoder alone."""
_SILENT_STEP_MM = 50.0
"""Length of belt that is recorded as missing at once while no frame sets arrive."""
_MONITOR_S = 0.5
"""Period in which cameras, encoder and alarms are evaluated."""
_HOUSEKEEPING_S = 60.0
"""Period of the removal of old records, and of freed memory's return to the system: 3 ms for 200 MiB."""
_STUCK_S = 120.0
"""Time without a round of the monitor after which it counts as stuck: a disk may hang for a minute. Chosen."""
_PATIENCE_S = 10.0
"""Longest wait at the end for the events and for the housekeeping."""


class Engine(OperatorControls):
    """Starts, monitors and stops the threads."""

    def __init__(self, components: EngineComponents) -> None:
        super().__init__(components)
        self._repair = RepairNotice(components.historian, components.reporter)
        workers = components.workers
        self._capacity = CapacityMeter(None if workers is None else workers.count_matched_per_s)
        self._most = 1 if workers is None else workers.ahead
        """Number of frame sets that are submitted at a time."""
        self._runs = RunRegister(components.historian, components.read_certificate, components.provenance)
        self._next_run: int | None = None
        """The run of the next records, where only the certificate in force has changed."""
        self._next: MeasuringParts | None = None
        """The parts that take the place of the present ones between two records."""
        self._stopping = threading.Event()
        self._ended = threading.Event()
        self._done = self._repeated = 0
        self._last_frame_s = monotonic()
        self._last_position_mm: float | None = None
        self._monitored_s = monotonic()
        """Monotonic clock at the monitor's last round."""
        self._threads = {
            name: make_supervised_thread(name, work, self._warn_of_failure, self._stopping.wait)
            for name, work in (
                ("feeder", self._feed),
                ("worker", self._work),
                ("monitor", self._monitor),
                ("housekeeper", self._keep_house),
                ("watchdog", self._feed_watchdog),
            )
        }

    def start(self) -> None:
        """Start the threads; maintenance that an earlier run began goes on."""
        present = self._components.maintenance.current
        if present is not None:
            self._components.observer.on_maintenance(present)
        self._alarms.start()
        self._monitored_s = monotonic()
        for thread in self._threads.values():
            thread.start()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until a recording has ended; return whether it has."""
        return self._ended.wait(seconds)

    def stop(self) -> int:
        """Stop, measure and write the waiting frames; return how many records could not be written."""
        components = self._components
        self._stopping.set()
        components.source.close()
        self._threads["feeder"].join(5)
        components.queue.close()
        self._threads["worker"].join(60)
        unwritten = [writer.close() for writer in components.writers]
        self._threads["monitor"].join(5)
        self._threads["housekeeper"].join(_PATIENCE_S)
        components.finding_log.store(components.historian)
        store_drift(components.drift, components.historian)
        components.events.wait(_PATIENCE_S)
        if components.recorder is not None:
            components.recorder.close()
        if components.encoder is not None:
            components.encoder.close()
        return max(unwritten, default=0)

    def exchange(self, parts: MeasuringParts) -> None:
        """Measure with other parts, of the same cameras, from the next record on, which is the first of a new run."""
        run = self._runs.begin(parts.provenance)
        self._next, self._next_run = parts, None
        self._components.measurement.set_context(parts.context, run)

    def _follow_certificate(self) -> None:
        """Begin a new run where another certificate is in force, or the present one has ended."""
        run = None if self._next is not None else self._runs.follow()
        if run is not None:
            self._next_run, number = run, self._runs.certificate
            text = make_event_text("certificate_none")
            if number:
                text = make_event_text("certificate_in_force", number=number)
            self._events.add("certificate", number or "none", text, time_ns(), parameters={"number": number})

    def _warn_of_failure(self, failure: str) -> None:
        self._components.reporter.warn(f"{threading.current_thread().name}: {failure}; going on")

    def _feed(self) -> None:
        """Put the source's frame sets, with the encoder's reading, into the queue."""
        components = self._components
        for frames in components.source:
            self._last_frame_s = monotonic()
            located = self._add_position(frames)
            if components.recorder is not None:
                components.recorder.take(located)
            components.queue.put(located)
            if self._stopping.is_set():
                return
        components.queue.close()

    def _add_position(self, frames: FrameSet) -> FrameSet:
        encoder = self._components.encoder
        if encoder is None or frames.position_mm is not None:
            return frames
        return replace(frames, position_mm=encoder.position_at(frames.time_ns, frames.frame))

    def _work(self) -> None:
        """Measure the queue's frame sets in their order, while workers match those after them."""
        components, submitted = self._components, Submitted()
        while submitted or not components.queue.closed:
            self._submit_next(submitted)
            if components.measurement.is_filled:
                self._collect()
            elif submitted and _is_done(submitted[0][1]):
                arrival, pending = submitted.popleft()
                self._measure(arrival.frames, pending, arrived_s=arrival.at_s)
                if components.workers is None and not submitted and not len(components.queue):
                    self._flush()
            else:
                self._wait(submitted)
        try:
            self._publish(components.measurement.finish())
        except Exception as error:
            components.reporter.warn(
                f"at the end: {type(error).__name__}: {error}; what was not finished is missing"
            )
        self._ended.set()

    def _submit_next(self, submitted: Submitted) -> None:
        """Take frame sets from the queue, as many as may be submitted."""
        while len(submitted) < self._most and (arrival := self._components.queue.get(0)) is not None:
            submitted.append((arrival, self._submit(arrival.frames, len(submitted))))

    def _wait(self, submitted: Submitted) -> None:
        """Wait for a frame set or for a match; where neither comes, let the encoder give the belt's position."""
        components = self._components
        if len(submitted) == self._most:  # no further one is taken before the end of a match wakes the queue
            components.queue.wait_for_wake(_WAIT_S)
        elif components.queue.wait(_WAIT_S) or submitted:
            return
        elif components.polls_encoder and (step := self._encoder_step()) is not None:
            self._measure(step)

    def _encoder_step(self) -> FrameSet | None:
        """Return a frame set without images if no camera delivers but the belt has moved on, else None."""
        if monotonic() - self._last_frame_s < _SILENT_S:
            return None
        now = monotonic_ns()
        step = self._add_position(FrameSet(f"silent-{now // 1_000_000}", {}, now))
        position, last = step.position_mm, self._last_position_mm
        if position is None or (last is not None and position - last < _SILENT_STEP_MM):
            return None
        return step

    def _submit(self, frames: FrameSet, ahead: int) -> PendingFrame | None:
        """Begin to match a frame set on a worker, after ``ahead`` others; None: it is matched in its turn."""
        if self._components.maintenance.current is not None:
            return None
        try:
            return self._components.measurement.submit(frames, ahead)
        except Exception as error:
            self._components.reporter.warn(f"frame {frames.frame}: {type(error).__name__}: {error}")
            return None

    def _measure(
        self, frames: FrameSet, pending: PendingFrame | None = None, *, arrived_s: float | None = None
    ) -> None:
        components, began_s, began_cpu_s = self._components, monotonic(), thread_time()
        self._last_position_mm = frames.position_mm
        try:
            outcome = self._push(frames, components.maintenance.current, pending)
        except Exception as error:
            self._restart(f"frame {frames.frame}", error)
            return
        self._publish(outcome)
        if outcome.is_repeat:
            self._repeated += 1
            components.gauges.update_repeat(outcome.speed_mm_s)
            self._notify_frame(
                frames, monotonic() - (began_s if arrived_s is None else arrived_s), is_repeat=True
            )
            return
        if components.workers is not None:  # they match meanwhile: no frame waits for the next one
            self._flush()
        self._finish_exchange()
        self._components.zero.add(outcome.depth, outcome.findings)
        self._done += 1
        gauges, depth = components.gauges, outcome.depth
        if depth is not None:
            self._tell_capacity(monotonic() - began_s, thread_time() - began_cpu_s)
        gauges.update_frame(depth, outcome.speed_mm_s)
        self._notify_frame(frames, monotonic() - (began_s if arrived_s is None else arrived_s))

    def _notify_frame(self, frames: FrameSet, seconds: float, *, is_repeat: bool = False) -> None:
        """Pass the gauges on after a frame set; ``seconds`` is the time since its arrival."""
        components, gauges = self._components, self._components.gauges
        components.observer.on_frame(
            FrameEvent(
                frames,
                self._done,
                components.queue.dropped,
                len(components.queue),
                seconds,
                gauges.coverage,
                gauges.speed_mm_s,
                gauges.last_lump_mm,
                gauges.full_area_mm2,
                gauges.capacity,
                self._view_mm,
                self._repeated,
                is_repeat,
            )
        )

    @property
    def _view_mm(self) -> float:
        """Return the length of belt that a frame set sees."""
        low_mm, high_mm = self._components.measurement.context.empty_belt.window_mm
        return abs(high_mm - low_mm)

    def _tell_capacity(self, elapsed_s: float, own_s: float) -> None:
        """Take over how long a frame set took; the first time that the capacity is known it is an event."""
        self._capacity.add(elapsed_s, own_s)
        gauges, before = self._components.gauges, self._components.gauges.capacity
        gauges.capacity = self._capacity.compute(self._view_mm)
        if math.isnan(before.sets_per_s) and not math.isnan(gauges.capacity.sets_per_s):
            rate, speed = f"{gauges.capacity.sets_per_s:.3g}", f"{gauges.capacity.speed_mm_s * 1e-3:.3g}"
            text = make_event_text("capacity_measured", rate=rate, speed=speed)
            parameters: dict[str, object] = {"rate": float(rate), "speed": float(speed)}
            self._events.add("capacity", "measured", text, time_ns(), parameters=parameters)

    def _push(self, frames: FrameSet, present: Maintenance | None, pending: PendingFrame | None) -> Outcome:
        """Measure a frame set; during maintenance it only gives the belt's position."""
        run, self._next_run = self._next_run, None
        if run is not None:
            self._components.measurement.set_context(self._components.measurement.context, run)
        empty_belt = self._components.zero.pop_reference()
        if empty_belt is not None:
            self._components.measurement.set_empty_belt(empty_belt)
        finding = maintenance.make_maintenance_finding(present)
        measured = frames if present is None else replace(frames, images={})
        tag = self._components.read_tag()
        return self._components.measurement.push(measured, (finding,), tag, pending)

    def _finish_exchange(self) -> None:
        """Use the other parts that belong to the context, once the measurement uses it."""
        parts, measurement = self._next, self._components.measurement
        if parts is None or measurement.context is not parts.context:
            return
        self._next, gauges = None, self._components.gauges
        gauges.full_area_mm2, gauges.stale_s = parts.full_area_mm2, parts.stale_s
        self._components = replace(
            self._components,
            inspector=parts.inspector,
            zero=parts.zero,
            drift=parts.drift,
            learned_images=parts.context.learned_images,
        )
        self._events.add(
            "settings",
            "measuring",
            make_event_text("settings_measuring", record=measurement.first_number),
            time_ns(),
            parameters={"record": measurement.first_number},
        )

    def _flush(self) -> None:
        """Measure the frame that is matched but not measured yet, as no other frame set waits."""
        try:
            self._publish(self._components.measurement.flush())
        except Exception as error:
            self._restart("measuring", error)

    def _collect(self) -> None:
        """Publish what is complete since its holes have been filled."""
        try:
            self._publish(self._components.measurement.collect())
        except Exception as error:
            self._restart("measuring", error)

    def _restart(self, where: str, error: Exception) -> None:
        self._components.reporter.warn(
            f"{where}: {type(error).__name__}: {error}; measuring restarts after it"
        )
        self._components.measurement.reset()

    def _publish(self, outcome: Outcome) -> None:
        """Pass entries to the writers, belt stretches to the observer and findings to the alarms."""
        if outcome.findings:
            checked = [finding for finding in outcome.findings if finding.check != MAINTENANCE]
            self._components.gauges.add_findings(checked)
            self._components.finding_log.put(outcome.findings)
            self._components.observer.on_findings(outcome.findings)
        for stretch in outcome.stretches:
            self._components.observer.on_surface(stretch)
        if outcome.entries:
            self._components.gauges.add(outcome.entries)
            self._components.observer.on_measured(outcome.entries)
            for writer in self._components.writers:
                writer.put(outcome.entries)

    def _monitor(self) -> None:
        """Update health and alarms twice a second; it waits for no record, event or finding to be stored."""
        while not self._stopping.wait(_MONITOR_S):
            if self._components.maintenance.is_over:
                self.end_maintenance("")
            self._update_alarms()
            self._monitored_s = monotonic()

    def _keep_house(self) -> None:
        """Do what may wait for the history: its check, findings, timetable, and once a minute its old records."""
        components, last = self._components, monotonic()
        while not self._stopping.wait(_MONITOR_S):
            self._repair.check()
            components.finding_log.store(components.historian)
            store_drift(self._components.drift, components.historian)  # of the present rig
            self._follow_certificate()
            components.follow_timetable()  # an error of a history that cannot be written ends the round
            if monotonic() - last > _HOUSEKEEPING_S:
                last = monotonic()
                release_memory()
                components.historian.maintain(time_ns())

    def _feed_watchdog(self) -> None:
        """Feed the watchdog while the worker lives and the monitor comes round, whatever the disk does."""
        while not self._stopping.wait(_MONITOR_S):
            if self._threads["worker"].is_alive() and monotonic() - self._monitored_s < _STUCK_S:
                self._components.heartbeat()

    def _update_alarms(self) -> None:
        components = self._components
        components.inspector.inspect(components.gauges)
        readings = self._collect_readings()
        components.observer.on_health(readings.cameras)
        self._alarms.update(readings)

    def _collect_readings(self) -> Readings:
        """Return the readings of the measurement with the states of the components."""
        components = self._components
        encoder, recorder = components.encoder, components.recorder
        stores = (*components.writers, components.events, components.historian)
        troubles = [store.trouble for store in stores]
        return replace(
            components.gauges.collect_readings(components.queue.dropped),
            cameras=components.source.health(),
            core=components.measurement.context.rig.core,
            history_trouble=next((text for text in troubles if text), ""),
            history_repair=self._repair.text,
            users_trouble=components.users_trouble(),
            reports_trouble=components.reports_trouble(),
            recording_trouble="" if recorder is None else recorder.trouble,
            gpu_trouble=gpu_failures.text,
            encoder_silent_s=float("nan") if encoder is None else encoder.silent_s,
            encoder_trouble=None if encoder is None else encoder.trouble,
            certificate_days=components.certificate_days(),
            test_certificate=self._runs.read_certificate(),
            is_maintained=components.maintenance.current is not None,
        )


def _is_done(pending: PendingFrame | None) -> bool:
    """Return whether a frame set that was submitted can be measured without waiting for its match."""
    return pending is None or pending.is_done
