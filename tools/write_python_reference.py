"""Write the table of all names of the Python interface into docs/python.md, from signatures and docstrings.

python tools/write_python_reference.py
"""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import beltscape as bs

PAGE = Path(__file__).resolve().parents[1] / "docs/python.md"
BEGIN, END = "<!-- reference -->", "<!-- end -->"


def fill_page(text: str) -> str:
    """Return the page with the table between its marks."""
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    names = sorted(bs.__all__, key=lambda name: (name[0].isupper(), name))
    rows = [row for name in names for row in list_rows(f"bs.{name}", getattr(bs, name))]
    return "\n".join([before + BEGIN, "| name | |", "|---|---|", *rows, END + after])


def list_rows(name: str, named: Any) -> list[str]:
    """Return the row of a name and, of a class, those of its public methods and properties."""
    own = [f"| `{format_call(name, named)}` | {read_first_line(named)} |"]
    if not inspect.isclass(named) or issubclass(named, Exception):
        return own
    short = name.removeprefix("bs.").lower()
    for key, member in vars(named).items():
        if key.startswith("_") or not (member.__doc__ if hasattr(member, "__doc__") else None):
            continue
        call = getattr(member, "__func__", member)
        if inspect.isfunction(call):
            own.append(f"| `{format_call(f'{short}.{key}', call)}` | {read_first_line(call)} |")
        elif isinstance(member, property):
            own.append(f"| `{short}.{key}` | {read_first_line(member)} |")
    return own


def format_call(name: str, named: Any) -> str:
    """Return a name with its arguments and their defaults, without types."""
    if inspect.isclass(named) and issubclass(named, Exception):
        return name
    parameters = [
        one.replace(annotation=inspect.Parameter.empty)
        for key, one in inspect.signature(named).parameters.items()
        if key not in ("self", "cls")
    ]
    shown = ", ".join(
        str(one) if one.default is one.empty or "<" not in str(one.default) else f"{one.name}=…"
        for one in parameters
    )
    marks = [k for k, one in enumerate(parameters) if one.kind is one.KEYWORD_ONLY]
    if marks and not any(one.kind is one.VAR_POSITIONAL for one in parameters):
        words = shown.split(", ")
        shown = ", ".join([*words[: marks[0]], "*", *words[marks[0] :]])
    return f"{name}({shown})"


def read_first_line(named: Any) -> str:
    """Return the first line of a docstring, for a cell of a table."""
    return (inspect.getdoc(named) or "").split("\n", 1)[0].replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(fill_page(PAGE.read_text("utf-8")), "utf-8")
