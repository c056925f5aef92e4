"""Runs a step of a commissioning: its preparation, its commands in processes of their own, and what they found.

A command that is killed leaves no half result, and the step stays open; running it again goes on. Where the program
itself is killed, its command ends, too.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from beltscape.commissioning import material, project_text, trial
from beltscape.commissioning.former import list_former, set_former_aside
from beltscape.commissioning.live import collect_complete, open_source, prove_instants
from beltscape.commissioning.optics import assess_all
from beltscape.commissioning.staged_cameras import CarriedBoard
from beltscape.commissioning.state import CommissionSettings, CommissionState
from beltscape.commissioning.steps import (
    CALIBRATION,
    EMPTY,
    LIVE,
    MOVING,
    PROJECT,
    RIG,
    SKEW,
    TRIGGER,
    VIEWS,
    Words,
    find_capture,
    find_missing,
    find_step,
    list_commands,
)
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.progress import Reporter
from beltscape.core.system_calls import begin_dependent
from beltscape.files.atomic import write_text
from beltscape.files.capture import read_capture
from beltscape.files.json_text import read_json, to_plain
from beltscape.files.rig_json import read_rig
from beltscape.health.images.synchronisation import SIGMAS

Facts: TypeAlias = dict[str, Any]
"""What a step found, by the key of its text on the page."""
_SETS = 4
"""Sets of images of which the sharpest is assessed: the board may move in one."""
_TRIAL_INSTANTS = 24
"""Instants of the trial plant's swung board: its delays are then known to about 0.01 ms."""
_ROUNDED = {"exposure_us": 0.02, "gain_db": 0.1}
"""Difference of what a camera states from what was set, over the value or 1, that is named; cameras round."""
_DONE = re.compile(r"(?P<stage>.+): (?P<total>\d+) done")
"""A finished stage in a command's progress."""


class StepRun:
    """A step while it runs; from any thread it can be cancelled."""

    def __init__(self, state: CommissionState, reporter: Reporter) -> None:
        self._state, self._reporter = state, reporter
        self._process: subprocess.Popen[bytes] | None = None
        self._lock: int | None = None
        self._cancelled = threading.Event()

    def run(self, name: str) -> Facts:
        """Run a step and record its result.

        Raises
        ------
        InputError
            If a step before it is missing, another program runs a step, or it was cancelled.
        BeltscapeError
            With the one line of the command that failed.
        """
        self._state.refresh()
        step = find_step(name)
        if missing := find_missing(self._state, step):
            raise InputError(f"step {name}: finish the step {missing} first")
        self._require_files(name)
        with self._state.lock() as self._lock:
            project_text.write_cameras(self._state)
            facts = to_plain(_STEPS[name](self))
        self._state.finish(name, facts, step.inputs)
        return facts

    def _require_files(self, name: str) -> None:
        """Raise InputError with the setting that names a file of a step which is not there."""
        settings = self._state.settings
        key, path, instead = {
            "board": ("board.file", settings.board.file, "for a board to print"),
            "calibrate": ("plan", settings.plan, "for the core camera's whole view"),
            "material": ("material_test", settings.material_test, "for the runs that were answered"),
        }.get(name, ("", None, ""))
        if path is not None and not (self._state.folder / path).is_file():
            where = (self._state.folder / path).resolve()
            raise InputError(
                f"{key} = {str(path)!r}: there is no file {where}; correct it, or clear it {instead}"
            )

    def cancel(self) -> None:
        """End the command that runs; the step stays open."""
        self._cancelled.set()
        if (process := self._process) is not None and process.poll() is None:
            process.send_signal(signal.SIGINT)

    def call(self, words: Words) -> Any:
        """Run a command in the folder; return its JSON document."""
        if self._cancelled.is_set():
            raise InputError("cancelled")
        locks = [] if self._lock is None else [self._lock]
        pipe = subprocess.PIPE
        with begin_dependent((*words, "--json"), self._state.folder, locks, pipe, pipe) as process:
            self._process = process
            listener = threading.Thread(
                target=self._listen, args=(process,), name="output of a step", daemon=True
            )
            listener.start()
            assert process.stdout is not None
            text = process.stdout.read().decode("utf-8", "replace")
            listener.join()
            process.wait()  # before its standard input is closed, which would end it
        self._process = None
        if self._cancelled.is_set():
            raise InputError("cancelled")
        document = json.loads(text) if text.strip() else {}
        if code := process.returncode:
            raise InputError(
                document.get("error", {}).get("message") or f"{' '.join(words)}: ended with {code}"
            )
        return document

    def call_all(self, name: str) -> Any:
        """Run all commands of a step; return the document of the last one."""
        document: Any = {}
        for words in list_commands(self._state, name):
            document = self.call(words)
        return document

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stderr is not None
        for line in process.stderr:
            text = line.decode("utf-8", "replace").strip()
            if found := _DONE.fullmatch(text):
                self._reporter.step(found["stage"], int(found["total"]), int(found["total"]))
            elif text.startswith("warning: "):
                self._reporter.warn(text.removeprefix("warning: "))

    def _find_cameras(self) -> Facts:
        state = self._state
        if state.settings.source is None:
            raise SettingsError("source: give trial, captures or cameras")
        names = self._list_cameras()
        set_former_aside(state)
        core = state.settings.core or names[0]
        if core not in names:
            raise SettingsError(f"core = {core!r}: no such camera; there are {', '.join(names)}")
        if not state.settings.core:
            state.change_settings({"core": core})
        facts: Facts = {"cameras": len(names), "names": list(names), "core": core}
        former = list_former(state.folder)
        return {**facts, "set_aside": former} if former else facts

    def _list_cameras(self) -> tuple[str, ...]:
        """Return the names of the cameras, which answer or have views of the board."""
        state, settings = self._state, self._state.settings
        if settings.source == "cameras":
            if len(settings.devices) < 2:
                raise SettingsError("devices: name two cameras or more, such as devices.cam0=192.168.10.11")
            self._check_cameras("cameras")
            return tuple(settings.devices)
        if settings.source == "trial":
            set_former_aside(state)
            state.change_settings(trial.make_trial(state))
        elif settings.captures is None:
            raise SettingsError("captures: give the folder with calibration, empty and moving")
        views = state.folder / find_capture(state.settings, VIEWS)
        if not views.is_dir():
            raise InputError(
                f"captures = {str(settings.captures)!r}: {views.resolve()} is no folder; give the folder that has "
                f"{VIEWS}, {EMPTY} and {MOVING} in it, absolute or from {state.folder.resolve()}"
            )
        capture = read_capture(views)
        for line in capture.describe_omissions():
            self._reporter.warn(line)
        return capture.cameras

    def _check_cameras(self, name: str) -> Facts:
        """Open all cameras once with their settings; return what they say of exposure time and gain, if any.

        Raises
        ------
        InputError
            With every camera that does not answer, or refuses a setting.
        """
        document = self.call_all(name)
        if not document:
            return {}
        faults = [line for line in document["check"].values() if line]
        if faults:
            raise InputError("; ".join(faults))
        return {key: {camera: own[key] for camera, own in document["applied"].items()}
                for key in ("exposure_us", "gain_db")}  # fmt: skip

    def _warn_of_rounding(self, applied: Facts) -> None:
        """Warn of cameras that state another exposure time or gain than was set."""
        for key, own in applied.items():
            wanted = getattr(self._state.settings, key)
            for name, value in own.items():
                if (
                    wanted is not None
                    and value is not None
                    and abs(value - wanted) > _ROUNDED[key] * max(abs(wanted), 1)
                ):
                    self._reporter.warn(f"{name}: {key} = {wanted:g} was set, the camera states {value:g}")

    def _assess_images(self) -> Facts:
        applied = self._check_cameras("images")
        self._warn_of_rounding(applied)
        source = open_source(self._state)
        if isinstance(source, CarriedBoard):
            for line in source.list_left_out():
                self._reporter.warn(line)
        frame_sets = collect_complete(source, _SETS, self._cancelled)
        assessed = [assess_all(one.images) for one in frame_sets]
        reports = max(assessed, key=lambda own: sum(one.sharpness.median for one in own.values()))
        for name, report in reports.items():
            if report.fault:
                self._reporter.warn(f"{name}: {report.fault}")
        faults = [name for name, report in reports.items() if report.fault]
        return {
            "cameras": len(reports),
            "faults": faults,
            "sharpness": {name: report.sharpness.median for name, report in reports.items()},
            "evenness": min(report.sharpness.evenness for report in reports.values()),
            **applied,
        }

    def _prove_trigger(self) -> Facts:
        settings = self._state.settings
        if settings.source != "cameras":
            facts: Facts = prove_instants(self._state.folder / find_capture(settings, VIEWS), settings.core)
        else:
            _set_aside(self._state.folder / TRIGGER)
            document = self.call_all("trigger")
            facts = {**prove_instants(self._state.folder / TRIGGER, settings.core),
                     "instants": document["frames"], "incomplete": document["incomplete"],
                     "dropped": document["dropped"], "allowed_skew_ms": settings.allowed_skew_ms}  # fmt: skip
        if facts["incomplete"]:
            raise InputError(describe_incomplete(facts, settings))
        return facts

    def _make_board(self) -> Facts:
        document = self.call_all("board")
        return {"board": document.get("board", {}).get("kind", "charuco")}

    def _calibrate(self) -> Facts:
        if not any((self._state.folder / VIEWS).glob("*/*")):
            raise InputError(
                f"{VIEWS}: no views of the board yet: take them first, with the page or --step calibrate"
            )
        return describe_calibration(self.call_all("calibrate"))

    def _accept_rig(self) -> Facts:
        document = read_json(self._state.folder / CALIBRATION)
        facts = describe_calibration(document)
        findings = document["fit"]["doubts"]
        if findings and not self._state.settings.accept_doubts:
            raise InputError(f"the rig is in doubt: {findings[0]}; mend it, or give accept_doubts=true")
        sigma, allowed = facts["sigma_mm"], self._state.settings.tolerance_mm
        if sigma > allowed and not self._state.settings.accept_doubts:
            raise InputError(
                f"σ of depth from calibration is {sigma:.2g} mm, tolerance_mm = {allowed:g}: take more views, or "
                "give accept_doubts=true"
            )
        return {**facts, "doubts": len(findings)}

    def _measure_skew(self) -> Facts:
        settings = self._state.settings
        capture = self._state.folder / find_capture(settings, SKEW)
        if settings.source == "cameras":
            _set_aside(self._state.folder / SKEW)
        elif settings.source == "trial":
            trial.make_moving_board(self._state, _TRIAL_INSTANTS)
        elif not capture.is_dir():
            self._reporter.warn(
                f"{capture}: no such capture of a board that is swung; the cameras' skew is not measured"
            )
            return {"delays": None}
        delays = self.call_all("skew")["delays"]
        require_common_instant(delays, read_rig(self._state.folder / RIG).auxiliaries, settings)
        worst = max(delays, key=lambda name: abs(delays[name]["delay_ms"]))
        return {"delays": delays, "latest": worst, "skew_limit_ms": settings.skew_limit_ms,
                "speed_mm_s": settings.belt_mm_s}  # fmt: skip

    def _learn_belt(self) -> Facts:
        if self._state.settings.source == "cameras":
            _set_aside(self._state.folder / EMPTY)
        document = self.call_all("empty")
        return {
            "width_mm": document["width_mm"],
            "noise_mm": document["noise_mm"],
            "frames": document["frames"],
        }

    def _write_project(self) -> Facts:
        path = self._state.folder / PROJECT
        text = project_text.format_project(self._state.folder, self._state.settings)
        if not path.is_file() or self._state.is_as_written(PROJECT):
            self._state.keep_written(PROJECT, text)
            write_text(path, text)
        for line in project_text.list_differences(path, text):
            self._reporter.warn(line)
        return {"parts": self.call_all("project")["parts"]}

    def _test_live(self) -> Facts:
        if self._state.settings.source == "cameras":
            _set_aside(self._state.folder / MOVING)
        _set_aside(self._state.folder / LIVE)  # a replay would go on with the former one's history
        document = self.call_all("live")
        if not document["records"]:
            raise InputError("the live test gave no record: does the belt run, and is the encoder read?")
        totals = document["totals"]
        length = totals["valid_mm"] + totals["degraded_mm"] + totals["missing_mm"]
        return {
            "records": totals["records"],
            "litres": totals["volume_mm3"] * 1e-6,
            "sigma_litres": totals["sigma_mm3"] * 1e-6,
            "belt_m": length * 1e-3,
            "missing_share": totals["missing_mm"] / length if length else 0.0,
        }

    def _test_material(self) -> Facts:
        state = self._state
        if state.settings.material_test is None:
            material.require_answers(state.settings)
        document: Any = {}
        for words in list_commands(state, "material"):
            if words[0] == "certify" and state.settings.material_test is None:
                material.write_test(state)
            document = self.call(words)
        return {"errors": document["errors"], "results": document["results"], "notes": document["notes"]}

    def _certify(self) -> Facts:
        issue, listing = list_commands(self._state, "certificate")
        document = self.call(issue)
        issued = document["certificate"]
        newest = self.call(listing)["certificates"][0]
        if newest["number"] != issued["number"] or newest["changed"]:
            raise InputError(
                f"certificate {issued['number']} does not apply to the plant: {newest['changed']}"
            )
        return {"number": issued["number"], "page": issued["page"], "days": newest["days_left"]}


_STEPS: Mapping[str, Callable[[StepRun], Facts]] = {
    "cameras": StepRun._find_cameras,
    "images": StepRun._assess_images,
    "trigger": StepRun._prove_trigger,
    "board": StepRun._make_board,
    "calibrate": StepRun._calibrate,
    "rig": StepRun._accept_rig,
    "skew": StepRun._measure_skew,
    "empty": StepRun._learn_belt,
    "project": StepRun._write_project,
    "live": StepRun._test_live,
    "material": StepRun._test_material,
    "certificate": StepRun._certify,
}


def require_common_instant(
    delays: Mapping[str, Mapping[str, float]], auxiliaries: Sequence[str], settings: CommissionSettings
) -> None:
    """Raise InputError unless every camera exposes with the core within the limit, which its σ must show."""
    limit = settings.skew_limit_ms
    missing = [name for name in auxiliaries if name not in delays]
    if missing:
        raise InputError(f"{', '.join(missing)}: did not see the board move; swing it before all cameras")
    for name, one in delays.items():
        if abs(one["delay_ms"]) > max(limit, SIGMAS * one["sigma_ms"]):
            side = "after" if one["delay_ms"] > 0 else "before"
            raise InputError(
                f"{name}: exposes {abs(one['delay_ms']):.3g} ms ± {one['sigma_ms']:.2g} ms {side} the core, "
                f"{abs(one['belt_mm']):.3g} mm ± {one['sigma_mm']:.2g} mm of belt at {settings.belt_mm_s:g} mm/s; "
                f"skew_limit_ms is {limit:g}: check the trigger's wire, input and delay"
            )
        if SIGMAS * one["sigma_ms"] > limit:
            raise InputError(
                f"{name}: its delay is known to {one['sigma_ms']:.2g} ms only, too coarse for skew_limit_ms = "
                f"{limit:g}: swing the board faster, or give more instants"
            )


def describe_incomplete(facts: Mapping[str, Any], settings: CommissionSettings) -> str:
    """Return which cameras lack images, and what to do, in one line."""
    lacking = ", ".join(f"{count} of {name}" for name, count in facts.get("lacking", {}).items())
    fix = (
        "check the trigger's wire and the network, or allowed_skew_ms; then prove it again"
        if settings.source == "cameras"
        else "record them again; calibrating does without them"
    )
    return f"{facts['incomplete']} of {facts['instants']} instants lack images ({lacking or 'all of some'}): {fix}"


def describe_calibration(document: Mapping[str, Any]) -> Facts:
    """Return what the page shows of a calibration.json."""
    score = document["held_out"] or document["training"]
    sigmas = document["depth_sigma_mm"]
    return {
        "views": document["training"]["frames"],
        "held_out_px": score["rms_px"],
        "square_mm": score["square_rms_mm"],
        "sigma_mm": max(one["median"] for one in sigmas),
        "worst_mm": max(one["worst"] for one in sigmas),
        "uncovered": document["coverage"]["uncertain"],
        "doubts_lines": document["fit"]["doubts"],
    }


def _set_aside(folder: Path) -> None:
    """Keep an earlier recording under another name: none is overwritten."""
    if not folder.exists():
        return
    number = 1
    while (kept := folder.with_name(f"{folder.name}_{number}")).exists():
        number += 1
    folder.rename(kept)
