"""Results of other cameras, set aside in a folder of their own when images come from elsewhere.

Nothing is deleted, and nothing measured by one set of cameras counts for another. The folder is a commissioning
itself and can be gone on with. A program that is killed meanwhile goes on with the same folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from beltscape.commissioning.state import FILE, CommissionState
from beltscape.commissioning.steps import (
    BELT,
    EMPTY,
    LIVE,
    MOVING,
    PROJECT,
    SKEW,
    TEST,
    TEST_FILE,
    TRIGGER,
    VIEWS,
)
from beltscape.commissioning.trial import ANSWERS, CAPTURES, OF_CAPTURES
from beltscape.files.atomic import output_error, write_text

_PREFIX = "former_"
"""Of the folders' names; what the cameras were follows."""
_RECORDED = (VIEWS, TRIGGER, SKEW, EMPTY, MOVING, LIVE)
"""Folders of recordings, whose earlier ones have numbers."""
_MADE = ("board", "rig", "depth_empty", Path(BELT).stem + ".*", PROJECT, TEST, TEST_FILE, "flow_*")
"""What else the steps leave, as patterns; the plant's records, users and certificates in its data folder stay."""
_MEASURED = frozenset({"runs", "zero", "material_test"})
"""Answers that belong to measurements."""


def set_former_aside(state: CommissionState) -> str:
    """Move what other cameras have left into a folder of its own; return its name, empty if there is nothing.

    Raises
    ------
    OutputError
        If it cannot be moved; the next call goes on.
    """
    if not state.has_other_cameras:
        return ""
    found = list(_list_results(state))
    name = state.begin_former(_choose_name(state))
    former = state.folder / name
    try:
        former.mkdir(exist_ok=True)
        if not (former / FILE).exists():
            write_text(former / FILE, state.format_former())
        for path in found:
            path.rename(former / path.name)
    except OSError as error:
        raise output_error(former, error) from error
    state.end_former(_MEASURED | (_list_answers_of_trial(state) if state.former_source == "trial" else set()))
    return name


def list_former(folder: Path) -> list[str]:
    """Return the folders of former cameras."""
    return sorted(path.parent.name for path in folder.glob(f"{_PREFIX}*/{FILE}"))


def _list_answers_of_trial(state: CommissionState) -> set[str]:
    """Return the settings that the trial plant has answered, not the engineer."""
    return {
        *OF_CAPTURES,
        "core",
        *(key for key, value in ANSWERS.items() if getattr(state.settings, key) == value),
    }


def _list_results(state: CommissionState) -> Iterator[Path]:
    """Yield what was made with the former cameras, except the folder that the new ones' images come from."""
    folder, captures = state.folder, state.settings.captures
    kept = None
    if state.settings.source == "captures" and captures is not None:
        kept = (folder / captures).resolve()
    patterns = [*_MADE, *_RECORDED, *(f"{name}_[0-9]*" for name in _RECORDED)]
    if state.former_source == "trial":
        patterns.append(CAPTURES)
    for pattern in patterns:
        for path in sorted(folder.glob(pattern)):
            if kept is None or not path.resolve().is_relative_to(kept):
                yield path


def _choose_name(state: CommissionState) -> str:
    """Return a name for the folder of the former cameras."""
    wanted = name = f"{_PREFIX}{state.former_source}"
    number = 1
    while (state.folder / name).exists():
        number += 1
        name = f"{wanted}_{number}"
    return name
