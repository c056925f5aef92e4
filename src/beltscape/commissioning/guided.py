"""Guided calibration: views of the board are taken by themselves, scored every few, until the belt's σ is enough.

The views are files of a capture from the first one on, and the scores are those of `beltscape calibrate` in a process
beside; so nothing is lost when page or program ends. The page and the terminal use the same session.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from beltscape.calibration.detection.corners import Corners
from beltscape.commissioning.live import LiveView, encode_jpeg, open_source
from beltscape.commissioning.staged_cameras import StagedCameras
from beltscape.commissioning.state import CommissionState
from beltscape.commissioning.steps import BOARD, RIG, VIEWS, find_capture, list_commands
from beltscape.core.arrays import Array
from beltscape.core.errors import BeltscapeError, InputError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.supervision import make_supervised_thread
from beltscape.core.system_calls import begin_dependent
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.pipeline.calibrating.guidance import (
    RigVerdict,
    draw_ghost,
    find_moved_camera,
    paint_coverage,
    read_verdict,
)
from beltscape.pipeline.calibrating.view_selection import ViewAssessment, ViewSelector
from beltscape.pipeline.recording.shots import CornerCounter, find_next_number
from beltscape.sinks.recording import CaptureWriter
from beltscape.target.board import read_board

FIRST_SCORE, SCORE_EVERY = 6, 4
"""Views from which on a first score is tried, and after which it is made anew."""
LEAST_VIEWS = 8
"""Views below which it is never enough: of fewer, the held-out score is that of a few poses."""
_BLAMED_VIEWS = 2
"""Newest views that a camera must contradict before it is named: one may be a blink of its trigger."""
_CLOSE_S = 30.0
"""Longest wait for the frame set that is being assessed: a large one takes seconds on a busy machine."""
_SILENCE_S = 30.0
"""Longest time without images in the terminal: cameras are searched for meanwhile."""
_WAIT_S = 0.1
"""Interval at which the session looks for a new frame set or the end of a score."""


class GuidedSession:
    """Takes the views of a board from a live view, in a thread of its own."""

    def __init__(self, state: CommissionState, live: LiveView) -> None:
        """Go on with the views that are there; InputError where the board's file cannot be used."""
        self._state, self._live = state, live
        self._folder = state.folder / VIEWS
        self._board = read_board(state.folder / BOARD)
        self._counter = CornerCounter(self._board)
        self._selector = ViewSelector(self._board)
        self._sizes: dict[str, tuple[int, int]] = {}
        self._corners_px: dict[str, list[Array]] = {}
        self._seeing: set[str] = set()
        self._now: Mapping[str, Corners] = {}
        self._assessment = ViewAssessment("no_board")
        self._frames: FrameSet | None = None
        self._verdict: RigVerdict | None = None
        self._trouble = ""
        self._moved = ""
        self._new_views: list[Mapping[str, Corners]] = []
        self._scored = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._output: IO[bytes] | None = None
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._is_forced = False
        self._is_resuming = False
        self._thread: threading.Thread | None = None
        self._lock_of_folder: int | None = None
        self._locked = ExitStack()

    @property
    def taken(self) -> int:
        """Number of views that were taken."""
        return self._selector.taken

    @property
    def is_enough(self) -> bool:
        """True if the newest score says that the views suffice."""
        verdict = self._verdict
        return (
            verdict is not None
            and verdict.views >= LEAST_VIEWS
            and not self._moved
            and verdict.is_enough(self._state.settings.tolerance_mm)
        )

    @property
    def moved(self) -> str:
        """The camera that was moved since the first views; empty: none."""
        return self._moved

    @property
    def trouble(self) -> str:
        """Why the newest score failed, in one line; empty: it did not."""
        return self._trouble

    @property
    def is_exhausted(self) -> bool:
        """True when recorded views stand for cameras, and all of them were looked at."""
        source = self._live.source
        return isinstance(source, StagedCameras) and source.is_exhausted

    def list_unseen(self) -> list[str]:
        """Return the cameras that have not seen the board yet, neither now nor in the views that were taken."""
        return [name for name in self._live.cameras if name not in self._seeing | self._corners_px.keys()]

    @property
    def is_scoring(self) -> bool:
        """True while a score is computed."""
        return self._process is not None

    @property
    def verdict(self) -> RigVerdict | None:
        """The newest score."""
        return self._verdict

    @property
    def assessment(self) -> ViewAssessment:
        """The verdict on the newest frame set."""
        return self._assessment

    def resume(self) -> None:
        """Find the board in the views that are there, and read their newest score."""
        self._is_resuming = True
        has_views = self._folder.is_dir() and any(self._folder.glob("*/*"))
        capture = read_capture(self._folder) if has_views else None
        self._read_score(0 if capture is None else len(capture.frames))
        if capture is not None:
            for frame in capture.frames:
                images = {name: read_image(own[frame]) for name, own in capture.files.items() if frame in own}
                corners = self._counter.detect(images)
                self._add_sizes(FrameSet(frame, images))
                self._selector.remember(corners, self._sizes)
                self._add_corners(corners)
        self._scored = 0 if self._verdict is None else min(self._verdict.views, self.taken)
        self._is_resuming = False

    def start(self) -> None:
        """Take views until the session is closed. InputError while another program does, or runs a step."""
        self.lock_folder()
        self._thread = make_supervised_thread("guided calibration", self._run, self._fail, self._closed.wait)
        self._thread.start()

    def lock_folder(self) -> None:
        """Keep other programs from running a step until the session is closed; InputError where one does."""
        self._lock_of_folder = self._locked.enter_context(self._state.lock())

    def _fail(self, reason: str) -> None:
        self._trouble = reason

    def close(self) -> None:
        """End the session; the views stay, and a score that is being computed is given up."""
        self._closed.set()
        if (process := self._process) is not None:
            process.terminate()
            process.communicate()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(_CLOSE_S)  # a detection that is under way cannot be interrupted
        self._locked.close()

    def force(self) -> None:
        """Take the next frame set that shows the board to two cameras, whatever is wrong with it."""
        self._is_forced = True

    def set_aside(self) -> Path:
        """Keep the views under another name and begin anew, such as after a camera was moved."""
        with self._lock:
            number = 1
            while (kept := self._folder.with_name(f"{VIEWS}_{number}")).exists():
                number += 1
            if self._folder.exists():
                self._folder.rename(kept)
            self._selector = ViewSelector(self._board, self._sizes)
            self._corners_px.clear()
            self._new_views.clear()
            self._verdict, self._moved, self._trouble, self._scored = None, "", "", 0
        return kept

    def _run(self) -> None:
        self.resume()
        last = ""
        while not self._closed.is_set():
            self.collect_score()
            frames = self._live.take_next(last, _WAIT_S)
            if frames is not None:
                last = frames.frame
                self.assess(frames)

    def assess(self, frames: FrameSet) -> ViewAssessment:
        """Judge a frame set, and take it where it is worth it."""
        corners = self._counter.detect(frames.images)
        with self._lock:
            self._add_sizes(frames)
            assessment = self._selector.assess(frames.images, corners)
            if assessment.verdict not in ("taken", "no_board", "one_camera") and self._is_forced:
                self._selector.remember(corners, self._sizes)
                assessment = replace(assessment, verdict="taken")
            if assessment.verdict == "taken":
                self._is_forced = False
                self._take(frames, corners)
            self._seeing.update(corners)
            self._now, self._assessment, self._frames = corners, assessment, frames
        if isinstance(source := self._live.source, StagedCameras):
            source.follow(self._draw_ghost())
        self._start_score()
        if isinstance(self._live.source, StagedCameras):
            self.wait_for_score()  # its time is counted in frame sets, however slow the machine is
        return assessment

    def _take(self, frames: FrameSet, corners: Mapping[str, Corners]) -> None:
        number = find_next_number(self._folder) if self._folder.is_dir() else 0
        writer = CaptureWriter(self._folder, "png")
        writer.write(replace(frames, frame=f"{number:03d}", position_mm=None))
        self._add_corners(corners)
        if self._verdict is not None:
            self._new_views.append(corners)
            newest = self._new_views[-_BLAMED_VIEWS:]
            if len(newest) == _BLAMED_VIEWS and not self._moved:
                self._moved = find_moved_camera(self._verdict, self._board, newest, self._sizes)

    def _add_sizes(self, frames: FrameSet) -> None:
        self._sizes.update({name: (image.shape[1], image.shape[0]) for name, image in frames.images.items()})

    def _add_corners(self, corners: Mapping[str, Corners]) -> None:
        for name, own in corners.items():
            self._corners_px.setdefault(name, []).append(own.pixels)

    def _start_score(self) -> None:
        """Begin a score beside, when enough new views are there; none while a camera is known to have been moved."""
        least = SCORE_EVERY if self._scored else FIRST_SCORE
        if self._process is not None or self._moved or self.taken - self._scored < least:
            return
        self._scored = self.taken
        (words,) = list_commands(self._state, "calibrate")
        # a file: a pipe that nobody reads meanwhile is full after 64 KiB, and the command would wait for ever
        self._output = tempfile.TemporaryFile()  # noqa: SIM115
        locks = [] if self._lock_of_folder is None else [self._lock_of_folder]
        self._process = begin_dependent(
            (*words, "--json"), self._state.folder, locks, self._output, subprocess.DEVNULL
        )

    def collect_score(self) -> None:
        """Read the score that was computed beside, if it is finished."""
        process = self._process
        if process is None or process.poll() is None:
            return
        assert self._output is not None
        process.communicate()
        with self._output:
            self._output.seek(0)
            text = self._output.read().decode("utf-8", "replace")
        self._process = None
        if process.returncode:
            document = json.loads(text) if text.strip() else {}
            self._trouble = document.get("error", {}).get("message", "")
            return
        self._trouble = ""
        with self._lock:
            self._new_views.clear()
            self._read_score(self.taken)

    def _read_score(self, views: int) -> None:
        """Read the newest score, unless it is of more views than there are: those were set aside."""
        plan = self._state.settings.plan
        folder = (self._state.folder / RIG).parent
        try:
            verdict = read_verdict(folder, None if plan is None else self._state.folder / plan)
            self._verdict = None if verdict is None or verdict.views > views else verdict
        except BeltscapeError as error:
            self._trouble = str(error)

    def encode_picture(self, camera: str) -> bytes | None:
        """Return the picture of the frame set that was assessed last as JPEG; None without one."""
        frames = self._frames
        image = None if frames is None else frames.images.get(camera)
        return None if image is None else encode_jpeg(image)

    def wait_for_score(self) -> None:
        """Wait until no score is being computed."""
        while self._process is not None and not self._closed.wait(_WAIT_S):
            self.collect_score()

    def _draw_ghost(self) -> dict[str, list[list[float]]]:
        """Return the outline of the next pose in every camera's image."""
        return draw_ghost(self._board, self._sizes, self._state.settings.core, self._verdict, self.taken)

    def describe(self) -> dict[str, Any]:
        """Return what the page shows, as plain values for JSON."""
        with self._lock:
            corners_px = {name: np.concatenate(own) for name, own in self._corners_px.items()}
            sizes, now, verdict = dict(self._sizes), dict(self._now), self._verdict
            taken = self.taken
        return {
            "taken": taken,
            "verdict": "resuming" if self._is_resuming else self._assessment.verdict,
            "camera": self._assessment.camera,
            "moved": self._moved,
            "trouble": self._trouble,
            "is_scoring": self.is_scoring,
            "is_enough": self.is_enough,
            "unseen": self.list_unseen() if self.is_exhausted else [],
            "tolerance_mm": self._state.settings.tolerance_mm,
            "score": None if verdict is None else _describe_verdict(verdict),
            "cells": paint_coverage(sizes, corners_px, verdict),
            "ghost": self._draw_ghost(),
            "corners": {name: np.round(own.pixels, 1) for name, own in now.items()},
            "sizes_px": sizes,
        }


def _describe_verdict(verdict: RigVerdict) -> dict[str, Any]:
    return {
        "views": verdict.views,
        "held_out_px": verdict.held_out_px,
        "square_mm": verdict.square_rms_mm,
        "sigma_mm": verdict.sigma_mm,
        "uncovered": verdict.uncovered,
        "is_sound": verdict.is_sound,
        "doubts": verdict.findings,
        "next": verdict.next_words,
    }


def take_views(state: CommissionState, reporter: Reporter) -> None:
    """Take views in the terminal until they are enough, or a folder of captures has no further ones.

    Raises
    ------
    InputError
        If a camera was moved in between, or no images come; the cameras are named.
    """
    live = LiveView(lambda: open_source(state))
    session = GuidedSession(state, live)
    session.lock_folder()
    last, last_s, named = "", time.monotonic(), set[str]()
    try:
        session.resume()
        live.open()
        if live.trouble:
            raise InputError(live.trouble)
        while not session.is_enough and not session.is_exhausted:
            session.collect_score()
            lost = {one.name: one.message for one in live.list_faults() if one.state == "lost"}
            for name in lost.keys() - named:
                reporter.warn(f"{name}: {lost[name]}")
            named = set(lost)
            if (frames := live.take_next(last, _WAIT_S)) is None:
                if time.monotonic() - last_s > _SILENCE_S:
                    raise InputError(f"no images for {_SILENCE_S:.0f} s; {_describe_silence(live)}")
                continue
            last, last_s = frames.frame, time.monotonic()
            if session.assess(frames).verdict == "taken":
                reporter.step(_describe_view(session), 1, 1)
            if session.moved:
                raise InputError(
                    f"camera {session.moved} was moved since the first views: fix it, move {VIEWS} away, and take "
                    "the views anew"
                )
        session.wait_for_score()
        if session.is_exhausted:
            _report_unseen(state, session, reporter)
    finally:
        live.close()
        session.close()


def _report_unseen(state: CommissionState, session: GuidedSession, reporter: Reporter) -> None:
    """Warn of cameras that see the board in no recorded view; InputError where no two see it at one instant."""
    unseen = session.list_unseen()
    if not session.taken:
        folder = state.folder / find_capture(state.settings, VIEWS)
        lacking = f" ({', '.join(unseen)}: nowhere)" if unseen else ""
        raise InputError(
            f"{folder}: no two cameras see the board of {BOARD} at one instant{lacking}; give the board that was "
            "used (board.file, or board.squares, its sizes and dictionary) and make it again, or record other views"
        )
    for name in unseen:
        reporter.warn(f"{name}: sees the board in no recorded view; record some, or leave its folder out")


def _describe_silence(live: LiveView) -> str:
    """Return why there are no images, in one line."""
    return "; ".join(f"{one.name}: {one.message}" for one in live.list_faults()) or live.trouble or "no fault"


def _describe_view(session: GuidedSession) -> str:
    """Return the line of a view that was taken, with the newest score."""
    score = session.verdict
    found = "" if score is None else f", σ {score.sigma_mm:.3g} mm, {score.held_out_px:.3g} px held out"
    return f"view {session.taken}{found}"
