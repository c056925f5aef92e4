"""Plays a row through the running system's engine, frame by frame and by the recording's clock."""

from __future__ import annotations

import contextlib
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from beltscape.core.errors import BeltscapeError
from beltscape.core.findings import Finding
from beltscape.core.ledger import BeltRecord, Totals
from beltscape.core.progress import Silent
from beltscape.pipeline.live.assembly import RunOptions, assemble
from beltscape.pipeline.live.engine import Engine
from beltscape.pipeline.live.engine_components import EngineComponents
from beltscape.pipeline.live.measurement_run import Outcome
from beltscape.pipeline.live.project import RunSettings, read_project
from faults.capture import FRAMES_PER_S, RoundCapture
from faults.case import Case
from faults.clock import Clock, use_clock
from faults.disturbances import DISTURBANCES
from faults.feed import Feed
from faults.matching import Cache, use_cache
from faults.replacements import REPLACEMENTS, Named

SOUND_ROUNDS = 2
"""Rounds before the fault: checks learn their reference values there."""
_MONITOR_EVERY = int(FRAMES_PER_S // 2)
"""Frames between two evaluations of the alarms: half a second, as in the running system."""


_PAUSE_S = 0.005
"""Pause of a wait for the writers."""


class Silence(Silent):
    """An observer and reporter that keeps the messages; events it does not know are dropped."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[str] = []

    def on_message(self, message: str) -> None:
        """Keep a message."""
        self.messages.append(message)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("on_"):
            return lambda *_: None
        raise AttributeError(name)


@dataclass
class Played:
    """What happened in a row; times are seconds of the recording."""

    case: Case
    onset: int
    """The first frame with the fault."""
    count: int
    records: list[tuple[float, BeltRecord]] = field(default_factory=list)
    """With the time at which each was published."""
    alarms: dict[str, float] = field(default_factory=dict)
    """Time at which an alarm was first raised."""
    findings: dict[str, tuple[float, str]] = field(default_factory=dict)
    """Time and text of a check's first fault, or of the first event, such as a splice that passed."""
    values: dict[str, tuple[float, float]] = field(default_factory=dict)
    """The last value of a check that was made, and its σ."""
    flow_m3_h: list[tuple[float, float]] = field(default_factory=list)
    """The shown flow; NaN: unknown."""
    totals: Totals = field(default_factory=Totals)
    unstored: int = 0
    """Records that were measured and are not in the history at the end."""
    messages: list[str] = field(default_factory=list)
    refusal: str = ""
    """Why the system did not start; empty: it did."""

    @property
    def onset_s(self) -> float:
        """Return the time at which the fault begins."""
        return self.onset / FRAMES_PER_S


class RecordingEngine(Engine):
    """The engine without its threads, which notes what it publishes."""

    def __init__(self, components: EngineComponents, played: Played, clock: Clock) -> None:
        super().__init__(components)
        self._played, self._clock = played, clock

    def play(self, feed: Feed, disturb: Callable[[], Callable[[], None]]) -> None:
        """Measure every frame of a feed and evaluate the alarms by its clock; ``disturb`` at the fault."""
        board, end = self._components.board, _do_nothing
        evaluated = -_MONITOR_EVERY
        for frames in feed:
            number = int(frames.frame)
            if number == feed.onset:
                self._wait_for_writers()
                end = disturb()
            self._clock.now_s = number / FRAMES_PER_S
            self._last_frame_s = self._clock.monotonic()
            self._measure(self._add_position(frames))
            self._flush()
            if number // _MONITOR_EVERY > evaluated // _MONITOR_EVERY:
                evaluated = number
                self._wait_for_writers()
                self._repair.check()
                self._update_alarms()
                for alarm in board.alarms:
                    if alarm.state != "clear":
                        self._played.alarms.setdefault(alarm.name, self._clock.now_s)
        self._publish(self._components.measurement.finish())
        end()

    def _wait_for_writers(self) -> None:
        """Wait until every writer has stored what it has, or says why it cannot: the clock does not wait for it."""
        while any(len(writer) and not writer.trouble for writer in self._components.writers):
            time.sleep(_PAUSE_S)

    def _publish(self, outcome: Outcome) -> None:
        self._played.records += [(self._clock.now_s, entry) for entry in outcome.entries]
        for finding in outcome.findings:
            if math.isfinite(finding.value):
                self._played.values[_name(finding)] = finding.value, finding.sigma
            if finding.is_fault or (finding.is_momentary and math.isfinite(finding.value)):
                self._played.findings.setdefault(_name(finding), (self._clock.now_s, finding.text))
        super()._publish(outcome)


def play(capture: RoundCapture, case: Case, cache: Cache, *, sound_rounds: float = SOUND_ROUNDS) -> Played:
    """Play a row and return what happened."""
    begin = sound_rounds + case.begins_after
    onset = 0 if case.is_wrong_from_start else round(begin * capture.frames)
    count = round((begin + case.rounds) * capture.frames)
    played, clock = Played(case, onset, count), Clock()
    with tempfile.TemporaryDirectory() as folder, use_clock(clock), use_cache(cache):
        observer: Any = Silence()
        project = _open_project(capture, case, Path(folder))
        try:
            run = assemble(project, _options(Path(folder)), observer)
        except BeltscapeError as error:
            played.refusal = str(error)
            return played
        try:
            components = run.engine._components
            _note_flow(components, played, clock)
            feed = Feed(capture, case, onset, count)
            engine = RecordingEngine(replace(components, source=feed), played, clock)
            engine.play(feed, partial(_disturb, case, Path(folder) / "data"))
            for writer in components.writers:
                writer.close()
            played.totals = components.historian.totals
            played.unstored = len(played.records) - played.totals.records
        finally:
            run.close()
        played.messages = [*observer.messages, *observer.warnings]
    return played


def _disturb(case: Case, data: Path) -> Callable[[], None]:
    return DISTURBANCES[case.disturbed](data) if case.disturbed else _do_nothing


def _do_nothing() -> None:
    """Do nothing."""


def _options(folder: Path) -> RunOptions:
    return RunOptions(data=folder / "data", paced=False, record=False)


def _open_project(capture: RoundCapture, case: Case, folder: Path) -> Any:
    """Write and read the row's project.toml."""
    empty = capture.folder / "empty_rec"
    if case.zero_faults:
        name = "empty_" + case.name.replace(" ", "_").replace("/", "_")
        empty = capture.learn_zero(name, case.zero_faults, Silent())
    path = folder / "project.toml"
    moving = capture.folder / "moving"
    named = Named(moving / "truth" / "rig.json", empty)
    if case.replaced:
        named = REPLACEMENTS[case.replaced](named, folder)
    path.write_text(
        f'rig = "{named.rig}"\nempty = "{named.empty}"\n'
        f'[capture]\nfolder = "{moving}"\n[encoder]\nkind = "capture"\n'
        '[matching]\npreset = "fast"\nworkers = 0\n[watch]\nlumps_every_s = 0\n'
        f"edges_every_s = {0 if case.belt_width_mm is None else 1}\n"
        "[history]\nreserve_mib = 1\n[csv]\nenabled = false\n",
        encoding="utf-8",
    )
    return read_project(path, RunSettings)


def _note_flow(components: EngineComponents, played: Played, clock: Clock) -> None:
    """Note the flow of every evaluation of the alarms."""
    board: Any = components.board
    update = board.update

    def update_and_note(readings: Any, *rest: Any) -> Sequence[Any]:
        played.flow_m3_h.append((clock.now_s, readings.volume_flow_m3_h))
        return update(readings, *rest)

    with contextlib.suppress(AttributeError):
        board.update = update_and_note


def _name(finding: Finding) -> str:
    return f"{finding.check}:{finding.subject}" if finding.subject else finding.check
