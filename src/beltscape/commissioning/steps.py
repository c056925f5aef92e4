"""The steps of a commissioning: what each needs and leaves behind, and the commands that make it.

Paths of commands are relative to the commissioning's folder, where they also work by hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from beltscape.commissioning.state import CommissionSettings, CommissionState
from beltscape.core.errors import InputError, suggest_name

PROJECT, BOARD, VIEWS, RIG, BELT = (
    "project.toml",
    "board/board.toml",
    "calibration",
    "rig/rig.json",
    "belt.json",
)
CAMERAS_FILE = "cameras.toml"
"""The table [cameras] before there is a whole project.toml; `record` and `cameras --check` read it."""
EMPTY, MOVING, LIVE, TEST, TEST_FILE = "empty", "moving", "live_test", "test", "material_test.toml"
SKEW = "moving_board"
"""Capture of a board that is swung before the cameras."""
TRIGGER = "trigger"
"""Capture that proves the trigger."""
CALIBRATION = "rig/calibration.json"
Status = Literal["open", "blocked", "done", "outdated"]
Words = tuple[str, ...]
"""A command line without the program's name."""


@dataclass(frozen=True, slots=True)
class Step:
    """A step of a commissioning."""

    name: str
    needs: tuple[str, ...] = ()
    """Steps that must be finished before."""
    inputs: tuple[str, ...] = ()
    """Files that its result depends on: when one changes, the step is outdated."""
    outputs: tuple[str, ...] = ()
    """Files that its result consists of."""


STEPS = (
    Step("cameras"),
    Step("images", ("cameras",)),
    Step("trigger", ("cameras",)),
    Step("board", ("cameras",), (), (BOARD,)),
    Step("calibrate", ("board",), (BOARD,), (RIG, CALIBRATION, "rig/report.html")),
    Step("rig", ("calibrate",), (RIG,)),
    Step("skew", ("rig",), (RIG,)),
    Step("empty", ("rig",), (RIG,), (BELT,)),
    Step("project", ("empty",), (RIG, BELT, CAMERAS_FILE), (PROJECT,)),
    Step("live", ("project",), (RIG, BELT, PROJECT)),
    Step("material", ("project",), (RIG, BELT, PROJECT), (f"{TEST}/test.json",)),
    Step("certificate", ("material",), (f"{TEST}/test.json", RIG, BELT, PROJECT)),
)
"""All steps, in their order."""


def find_step(name: str) -> Step:
    """Return a step by its name; InputError with the nearest one, or all."""
    for step in STEPS:
        if step.name == name:
            return step
    names = [step.name for step in STEPS]
    raise InputError(f"no step {name!r}; {suggest_name(name, names) or 'there are ' + ', '.join(names)}")


def get_status(state: CommissionState, step: Step) -> Status:
    """Return how a step stands."""
    if state.has_other_cameras:
        return "outdated" if step.name == "cameras" else "blocked"
    is_done = state.get_record(step.name) is not None
    if is_done and all((state.folder / name).exists() for name in step.outputs):
        return "outdated" if state.is_outdated(step.name) else "done"
    return "blocked" if find_missing(state, step) else "open"


def find_missing(state: CommissionState, step: Step) -> str:
    """Return the first step that must be finished before this one; empty: none."""
    if state.has_other_cameras and step.name != "cameras":
        return "cameras"  # it sets aside what was made with the former ones
    for name in step.needs:
        before = find_step(name)
        is_done = state.get_record(name) is not None
        if not is_done or not all((state.folder / output).exists() for output in before.outputs):
            return name
    return ""


def find_next(state: CommissionState) -> str:
    """Return the first step that is not done; the last one if all are."""
    return next((step.name for step in STEPS if get_status(state, step) != "done"), STEPS[-1].name)


def list_commands(state: CommissionState, step: str) -> list[Words]:
    """Return the commands of a step, in their order; empty for one that only looks at pictures or files."""
    settings = state.settings
    makers = {
        "cameras": _check_cameras,
        "images": _check_cameras,
        "trigger": _prove_trigger,
        "board": _make_board,
        "calibrate": _calibrate,
        "skew": _measure_skew,
        "empty": _learn_belt,
        "project": _check_project,
        "live": _test_live,
        "material": _test_material,
        "certificate": _certify,
    }
    make = makers.get(step)
    return [] if make is None else list(make(settings))


def _check_cameras(settings: CommissionSettings) -> Iterator[Words]:
    if settings.source == "cameras":
        yield ("cameras", "--check", CAMERAS_FILE)


def _prove_trigger(settings: CommissionSettings) -> Iterator[Words]:
    if settings.source == "cameras":
        yield ("record", CAMERAS_FILE, "--out", TRIGGER, "--sequence", "--shots", str(settings.instants))


def _make_board(settings: CommissionSettings) -> Iterator[Words]:
    board = settings.board
    if board.file is not None:
        yield ("target", "board", "--target", str(board.file), "--out", "board")
        return
    columns, rows = map(str, board.squares)
    sizes = ("--square", f"{board.square_mm:g}", "--marker", f"{board.marker_mm:g}")
    words = ("target", "board", "--squares", columns, rows, *sizes)
    yield (*words, "--dictionary", board.dictionary, "--out", "board")


def _calibrate(settings: CommissionSettings) -> Iterator[Words]:
    belt = () if settings.plan is None else ("--belt", str(settings.plan))
    core = ("--core", settings.core) if settings.core else ()
    yield ("calibrate", VIEWS, "--board", BOARD, *core, *belt, "--out", "rig")


def _measure_skew(settings: CommissionSettings) -> Iterator[Words]:
    if settings.source == "cameras":
        yield ("record", CAMERAS_FILE, "--out", SKEW, "--sequence", "--shots", str(settings.instants))
    capture = find_capture(settings, SKEW)
    yield ("check", capture, "--rig", RIG, "--board", BOARD, "--delays", f"{settings.belt_mm_s:g}")


def _learn_belt(settings: CommissionSettings) -> Iterator[Words]:
    if settings.source == "cameras":
        yield ("record", CAMERAS_FILE, "--out", EMPTY, "--sequence", "--seconds", f"{settings.seconds:g}")
    capture = find_capture(settings, EMPTY)
    yield ("reconstruct", capture, "--rig", RIG, "--preset", "fast", "--out", "depth_empty")
    yield ("measure", "belt", "depth_empty", "--out", BELT)


def _check_project(_settings: CommissionSettings) -> Iterator[Words]:
    yield ("run", PROJECT, "--check")


def _test_live(settings: CommissionSettings) -> Iterator[Words]:
    if settings.source == "cameras":
        yield ("record", PROJECT, "--out", MOVING, "--sequence", "--seconds", f"{settings.seconds:g}")
    yield ("replay", PROJECT, "--capture", find_capture(settings, MOVING), "--out", LIVE)


def name_flow(capture: Path) -> str:
    """Return the folder of the flow of a run's capture."""
    return f"flow_{capture.name}"


def _test_material(settings: CommissionSettings) -> Iterator[Words]:
    captures = [run.capture for run in settings.runs] + [settings.zero.capture]
    for capture in () if settings.material_test else captures:
        if capture is not None:
            words = ("measure", "flow", str(capture), "--rig", RIG, "--empty", BELT)
            encoder = ("--encoder", str(capture / "encoder.csv"))
            load = ("--preset", "fast", "--load", f"{settings.load_mm:g}")
            yield (*words, *encoder, *load, "--out", name_flow(capture))
    yield ("certify", "material", _name_test(settings), "--project", PROJECT, "--out", TEST)


def _certify(settings: CommissionSettings) -> Iterator[Words]:
    by = ("--by", settings.operator) if settings.operator else ()
    yield ("certify", "material", _name_test(settings), "--project", PROJECT, "--issue", *by, "--out", TEST)
    yield ("certify", "list", PROJECT)


def _name_test(settings: CommissionSettings) -> str:
    return str(settings.material_test or TEST_FILE)


def find_capture(settings: CommissionSettings, name: str) -> str:
    """Return the capture of the empty or the moving belt, or of the board's views: recorded here, or given."""
    folder = Path() if settings.source == "cameras" or settings.captures is None else settings.captures
    return str(folder / name)
