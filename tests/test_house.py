"""The order of the source tree: packages, subjects and modules, one subject a file."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src" / "beltscape"
LEVELS = 3
"""A package, a subject, a module."""
SHORTEST_LINES, LONGEST_LINES = 60, 450
LONGEST_FUNCTION = 60
"""Lines of a function: it fits a screen."""

SHORT = {
    "a process's entry": ("__main__.py", "report/production/__main__.py", "workers/worker_process.py"),
    "one command a file": ("cli/commands/*.py",),
    "one format a file": (
        "files/arrays.py",
        "files/clouds.py",
        "files/exchange/opencv_stereo.py",
        "files/exposures_csv.py",
        "files/flow_csv.py",
        "files/stl.py",
        "files/times_csv.py",
    ),
    "one check a file": ("health/*.py",),
    "one family of kernels a file": ("kernels/reference/networks.py", "kernels/reference/photometry.py"),
    "settings that the command line reads before anything heavy is imported": (
        "measure/belt/settings.py",
        "measure/flow/settings.py",
        "measure/lumps/settings.py",
        "measure/volume/settings.py",
        "sources/encoder/settings.py",
        "workers/options.py",
    ),
    "a heavy import that waits until it is needed": ("kernels/native.py", "report/production/pdf.py"),
    "a small type or function that several packages share": (
        "core/arrays.py",
        "core/cloud.py",
        "core/depth.py",
        "core/display.py",
        "core/progress.py",
        "core/statistics.py",
        "core/translatable_message.py",
        "files/json_number.py",
        "files/sqlite_failures.py",
        "measure/flow/density.py",
        "production/calendar.py",
        "protocols/client_tls.py",
        "service/data_rights.py",
        "service/static.py",
    ),
    "what modules beside each other share, and none of them may import from another": (
        "files/exchange/rig_description.py",
        "kernels/backend.py",
        "kernels/projection.py",
        "protocols/kept_number.py",
        "simulate/faults/base.py",
        "sinks/days.py",
        "stereo/cameras.py",
        "stereo/multiview/parallel.py",
        "workers/call.py",
    ),
    "one table of the history a file": ("sinks/historian/drift.py",),
    "the files of one small command": ("pipeline/pattern_files.py", "pipeline/plan.py"),
    "two quantities of the running belt, from packages that do not know each other": (
        "measure/flow/periodic_checks.py",
    ),
}
"""Files that may be short, by the reason."""


def list_modules() -> Iterator[Path]:
    return (path.relative_to(SOURCE) for path in sorted(SOURCE.rglob("*.py")))


def count_lines(path: Path) -> int:
    return len((SOURCE / path).read_text("utf-8").splitlines())


def test_nothing_lies_deeper_than_package_subject_module():
    assert [str(path) for path in list_modules() if len(path.parts) > LEVELS] == []


def test_no_file_is_long():
    assert [str(path) for path in list_modules() if count_lines(path) > LONGEST_LINES] == []


def test_a_function_fits_a_screen():
    long = [
        f"{path}: {node.name}"
        for path in list_modules()
        for node in ast.walk(ast.parse((SOURCE / path).read_text("utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or 0) - node.lineno >= LONGEST_FUNCTION
    ]
    assert long == []


def test_a_short_file_has_a_reason():
    permitted = {path for patterns in SHORT.values() for name in patterns for path in SOURCE.glob(name)}
    short = [
        path for path in list_modules() if path.name != "__init__.py" and count_lines(path) < SHORTEST_LINES
    ]
    assert [str(path) for path in short if SOURCE / path not in permitted] == []


def test_the_short_files_exist():
    names = [pattern for patterns in SHORT.values() for pattern in patterns]
    assert [name for name in names if not list(SOURCE.glob(name))] == []
    assert len(set(names)) == len(names)


def test_every_package_has_a_docstring():
    folders = {path.parent for path in list_modules()}
    missing = []
    for folder in sorted(folders):
        init = SOURCE / folder / "__init__.py"
        if not init.exists() or not ast.get_docstring(ast.parse(init.read_text("utf-8"))):
            missing.append(str(folder))
    assert missing == []


def test_a_public_class_has_a_name_of_its_own() -> None:
    found: dict[str, list[str]] = {}
    for path in SOURCE.rglob("*.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(str(path.relative_to(SOURCE)))
    assert {name: where for name, where in found.items() if len(where) > 1} == {}
