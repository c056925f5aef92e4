"""A commissioning as the page sees it: its steps, the one that runs, the live view and the guided calibration.

One at a time: a step that runs has the cameras for itself. All methods may be called from any thread.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from beltscape.commissioning.guided import GuidedSession
from beltscape.commissioning.live import LiveView, open_source
from beltscape.commissioning.material import DATA, count_turns
from beltscape.commissioning.optics import assess_all
from beltscape.commissioning.runner import StepRun
from beltscape.commissioning.state import CommissionState, ZeroAnswer
from beltscape.commissioning.steps import (
    STEPS,
    find_missing,
    find_next,
    find_step,
    get_status,
    list_commands,
)
from beltscape.core.errors import BeltscapeError, InputError
from beltscape.core.events import CameraHealth
from beltscape.core.supervision import describe_failure
from beltscape.core.translatable_message import get_key, get_values

ViewAction = Literal["start", "stop", "take", "anew"]
_LINES = 6
"""Newest lines of a step's progress that are shown."""
_WARNINGS = 20
"""Warnings of a step that are shown: a camera that delivers one image again and again warns with every frame."""
_TURNS_S = 3.0
"""Time between two counts of the belt's turns: a belt takes ten times as long for one."""
SHOWN = (".html", ".png", ".pdf", ".svg")
"""Endings of result files that the page opens."""


class StepProgress:
    """Reporter that keeps the newest lines and the first warnings of a step."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.warnings: list[str] = []

    def step(self, stage: str, done: int, total: int) -> None:
        """Keep a stage."""
        self.lines = [*self.lines, f"{stage}: {done}/{total}"][-_LINES:]

    def warn(self, message: str) -> None:
        """Keep a warning, once; of too many only that there are more."""
        if message in self.warnings or len(self.warnings) > _WARNINGS:
            return
        is_last = len(self.warnings) == _WARNINGS
        self.warnings.append(
            "further warnings: run the step in the terminal, which lists all" if is_last else message
        )


class TurnCounter:
    """How often the belt has turned since the zero test's beginning, read from the plant's records now and again."""

    def __init__(self, state: CommissionState) -> None:
        self._state = state
        self._read_of: tuple[ZeroAnswer, float] | None = None
        self._turns: float | None = None

    def read(self) -> float | None:
        """Return the turns; None while there are none. Turns that suffice are not counted on."""
        zero, now_s = self._state.settings.zero, time.monotonic()
        if self._read_of is not None and self._read_of[0] == zero:
            is_enough = self._turns is not None and self._turns >= zero.revolutions
            if is_enough or now_s - self._read_of[1] < _TURNS_S:
                return self._turns
        self._read_of, self._turns = (zero, now_s), count_turns(self._state.folder / DATA, zero)
        return self._turns


class CommissionSession:
    """What the page of a commissioning shows and does."""

    def __init__(self, state: CommissionState) -> None:
        self.state = state
        self.live = LiveView(lambda: open_source(state))
        self._guided: GuidedSession | None = None
        self._lock = threading.RLock()
        self._run: StepRun | None = None
        self._running = ""
        self._progress = StepProgress()
        self._failures: dict[str, str] = {}
        self._warnings: dict[str, list[str]] = {}
        self._turns = TurnCounter(state)

    def take_snapshot(self) -> dict[str, Any]:
        """Return everything that the page shows, except pictures."""
        with self._lock:
            self.state.refresh()
            state, running = self.state, self._running
            return {
                "folder": str(state.folder.resolve()),
                "settings": state.settings.model_dump(mode="json"),
                "steps": [self._describe_step(step.name) for step in STEPS],
                "next": find_next(state),
                "running": running,
                "turns": self._turns.read(),
                "progress": self._progress.lines if running else [],
                "live": {
                    "is_open": self.live.is_open,
                    "cameras": self.live.cameras,
                    "trouble": self.live.trouble,
                    "faults": [_describe_fault(one) for one in self.live.list_faults()],
                },
                "views": None if self._guided is None else self._guided.describe(),
            }

    def _describe_step(self, name: str) -> dict[str, Any]:
        step, state = find_step(name), self.state
        record = state.get_record(name)
        is_running = self._running == name
        return {
            "name": name,
            "status": "running" if is_running else get_status(state, step),
            "missing": find_missing(state, step),
            "failure": "" if is_running else self._failures.get(name, ""),
            "warnings": self._progress.warnings if is_running else self._warnings.get(name, []),
            "finished_ms": None if record is None else record["finished_ms"],
            "result": None if record is None else record["result"],
            "commands": [" ".join(("beltscape", *words)) for words in list_commands(state, name)],
            "files": list_files(state.folder, name),
        }

    def change_settings(self, changes: Mapping[str, Any]) -> None:
        """Change settings; pictures are taken anew with them. InputError while a step runs."""
        with self._lock:
            self._require_rest()
            self.state.change_settings(changes)
            self.close_cameras()

    def start(self, name: str) -> None:
        """Run a step in a thread of its own. InputError while another one runs."""
        step = find_step(name)
        with self._lock:
            self._require_rest()
            if missing := find_missing(self.state, step):
                raise InputError(f"step {name}: finish the step {missing} first")
            self.close_cameras()
            self._running, self._progress = name, StepProgress()
            self._failures.pop(name, None)
            self._run = StepRun(self.state, self._progress)
            work = threading.Thread(
                target=self._work, args=(name, self._run), name=f"step {name}", daemon=True
            )
            work.start()

    def _work(self, name: str, run: StepRun) -> None:
        failure = ""
        try:
            run.run(name)
        except BeltscapeError as error:
            failure = str(error)
        except Exception as error:  # the page must not show a step as running for ever
            failure = describe_failure(error)
        with self._lock:
            if failure:
                self._failures[name] = failure
            self._warnings[name] = self._progress.warnings
            self._running, self._run = "", None

    def cancel(self) -> None:
        """End the step that runs; it stays open."""
        with self._lock:
            if self._run is not None:
                self._run.cancel()

    def open_cameras(self) -> None:
        """Open the cameras for pictures. InputError while a step runs, or if they cannot be opened."""
        with self._lock:
            self._require_rest()
            self.live.open()
            if self.live.trouble:
                raise InputError(self.live.trouble)

    def close_cameras(self) -> None:
        """Close the cameras and the guided calibration; its views stay."""
        with self._lock:
            if self._guided is not None:
                self._guided.close()
                self._guided = None
            self.live.close()

    def handle_views(self, action: ViewAction) -> None:
        """Start or stop taking views of the board, take the present one, or begin anew. InputError if it cannot."""
        with self._lock:
            self._require_rest()
            if action == "start":
                if missing := find_missing(self.state, find_step("calibrate")):
                    raise InputError(f"step calibrate: finish the step {missing} first")
                if self._guided is None:
                    guided = GuidedSession(self.state, self.live)
                    self.open_cameras()
                    guided.start()
                    self._guided = guided
                return
            if self._guided is None:
                raise InputError("no views are being taken: start first")
            if action == "stop":
                self.close_cameras()
            elif action == "take":
                self._guided.force()
            else:
                self._guided.set_aside()

    def assess_optics(self) -> dict[str, Any]:
        """Return histogram and sharpness of every camera's newest picture; empty while there is none."""
        frames = self.live.take()
        reports = {} if frames is None else assess_all(frames.images)
        return {name: own.document() for name, own in reports.items()}

    def encode_picture(self, camera: str) -> bytes | None:
        """Return a camera's newest picture as JPEG; while views are taken, the one that was assessed last."""
        guided = self._guided
        return (self.live if guided is None else guided).encode_picture(camera)

    def close(self) -> None:
        """End what runs; everything that is finished is on the disk."""
        self.cancel()
        self.close_cameras()

    def _require_rest(self) -> None:
        if self._running:
            raise InputError(f"the step {self._running} runs: wait, or cancel it")


def _describe_fault(health: CameraHealth) -> dict[str, Any]:
    """Return a camera's fault by its key and values, from which the page composes its text."""
    message = health.message
    return {
        "camera": health.name,
        "text": str(message),
        "key": get_key(message),
        "values": get_values(message),
    }


_RESULTS = {
    "board": ("board/board.pdf",),
    "calibrate": ("rig/report.html", "rig/coverage.png"),
    "rig": ("rig/report.html",),
    "empty": ("belt.html",),
    "material": ("test/report.html", "flow_*/report.html"),
    "certificate": ("data/certificates/*.html",),
}
"""Result files of a step that the page opens, as patterns."""


def list_files(folder: Path, step: str) -> list[str]:
    """Return the result files of a step that are there, relative to the folder."""
    found = (path for pattern in _RESULTS.get(step, ()) for path in sorted(folder.glob(pattern)))
    return [path.relative_to(folder).as_posix() for path in found]


def find_file(folder: Path, name: str) -> Path | None:
    """Return a result file that a step lists; None for any other."""
    is_listed = any(name in list_files(folder, step) for step in _RESULTS)
    return folder / name if is_listed and Path(name).suffix in SHOWN else None
