"""The catalogue of alarms against the source: checks take their names from it, and each of its rows is used."""

from __future__ import annotations

import ast
from pathlib import Path

from beltscape.core import alarm_catalogue
from beltscape.core.alarm_catalogue import DEFINITIONS, KINDS, STATES

SOURCE = Path(alarm_catalogue.__file__).parents[1]
TEXTS = {path: path.read_text("utf-8") for path in sorted(SOURCE.rglob("*.py"))}
MODULES = {
    path: ast.parse(text)
    for path, text in TEXTS.items()
    if any(word in text for word in ("alarm_catalogue", "Finding(", "has_fault("))
}
CONSTANTS = {name.upper() for name in DEFINITIONS}


def test_each_row_is_a_constant_of_its_name():
    rows = {name for name in vars(alarm_catalogue) if name in CONSTANTS}
    assert rows == CONSTANTS
    assert all(getattr(alarm_catalogue, name) == name.lower() for name in rows)


def test_each_row_is_used_by_its_check_or_rule():
    used = {
        alias.name
        for module in MODULES.values()
        for node in ast.walk(module)
        if isinstance(node, ast.ImportFrom) and node.module == "beltscape.core.alarm_catalogue"
        for alias in node.names
    }
    assert CONSTANTS - used == set()


def test_no_check_writes_its_name_anew():
    written = [
        f"{path.relative_to(SOURCE)}:{node.lineno}"
        for path, module in MODULES.items()
        for node in ast.walk(module)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in ("Finding", "has_fault")
        and any(isinstance(one, ast.Constant) and one.value in DEFINITIONS for one in node.args)
    ]
    assert written == []


def test_the_places_in_the_list_are_counted_from_one():
    assert [DEFINITIONS[name].place for name in KINDS] == list(range(1, len(KINDS) + 1))


def test_states_of_the_plant_are_alarms_and_do_not_hide_themselves():
    assert set(STATES) <= set(DEFINITIONS)
    others = [state for state in STATES if state != "maintenance"]
    assert all(state not in DEFINITIONS[state].suppressed_by for state in others)
