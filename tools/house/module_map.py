"""The map of a move: which old modules become which new ones, in which order, and which names change with it.

A map is a text file. A line ``new.module = old.module, old.module`` joins modules; names are below ``beltscape``. An
indented ``doc: …`` is the new module's docstring, which may go over several indented lines; an indented
``rename old.module:name new_name`` gives a definition or an imported name of an old module another name. Modules that
no line names stay.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

ROOT = "beltscape"


@dataclass(slots=True)
class Target:
    """A new module."""

    name: str
    sources: list[str]
    docstring: str = ""
    place: str = ""
    """File and line of the map."""


@dataclass(slots=True)
class ModuleMap:
    """New modules, and new names by old module and old name."""

    targets: dict[str, Target] = field(default_factory=dict[str, Target])
    renames: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])
    new_from_old: dict[str, str] = field(default_factory=dict[str, str])

    def locate(self, old: str) -> str:
        """Return the new name of an old module."""
        return self.new_from_old.get(old, old)

    def rename(self, old: str, name: str) -> str:
        """Return the new name of a definition of an old module."""
        return self.renames.get(old, {}).get(name, name)

    def rename_dotted(self, dotted: str, modules: Mapping[str, Path]) -> str:
        """Return the new dotted name of a module, or of a definition in one; others unchanged."""
        parts = dotted.split(".")
        for end in range(len(parts), 0, -1):
            module = ".".join(parts[:end])
            if module in modules:
                rest = parts[end:]
                if rest:
                    rest[0] = self.rename(module, rest[0])
                return ".".join([self.locate(module), *rest])
        return dotted


def list_modules(source: Path) -> dict[str, Path]:
    """Return the files of a source folder's modules and packages by dotted name."""
    modules: dict[str, Path] = {}
    for path in sorted((source / ROOT).rglob("*.py")):
        parts = path.relative_to(source).with_suffix("").parts
        modules[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return modules


def read_maps(files: Iterable[Path], modules: Mapping[str, Path]) -> ModuleMap:
    """Read maps; ValueError with file and line for what they cannot mean."""
    found = ModuleMap()
    for path in files:
        target: Target | None = None
        in_doc = False
        for number, raw in enumerate(path.read_text().splitlines(), 1):
            place, line = f"{path.name}:{number}", raw.rstrip()
            if not line or line.startswith("#"):
                continue
            if not line[0].isspace():
                target = _read_target(line, place, modules)
                if target.name in found.targets:
                    raise ValueError(f"{place}: {target.name} is there twice")
                found.targets[target.name] = target
                for old in target.sources:
                    if old in found.new_from_old:
                        raise ValueError(f"{place}: {old} goes to two modules")
                    found.new_from_old[old] = target.name
                in_doc = False
            elif line.lstrip().startswith("rename "):
                match = re.fullmatch(r"\s*rename ([\w.]+):(\w+) (\w+)", line)
                if not match:
                    raise ValueError(f"{place}: rename old.module:name new_name")
                module = f"{ROOT}.{match[1]}"
                if module not in modules:
                    raise ValueError(f"{place}: no module {module}")
                found.renames.setdefault(module, {})[match[2]] = match[3]
                in_doc = False
            elif target and line.lstrip().startswith("doc:"):
                target.docstring = line.split("doc:", 1)[1].strip()
                in_doc = True
            elif target and in_doc:
                target.docstring += "\n" + line.strip().removeprefix("|").removeprefix(" ")
            else:
                raise ValueError(f"{place}: neither doc nor rename")
    _check_places(found, modules)
    return found


def _read_target(line: str, place: str, modules: Mapping[str, Path]) -> Target:
    new, separator, olds = line.partition("=")
    if not separator:
        raise ValueError(f"{place}: new.module = old.module, …")
    sources = [f"{ROOT}.{old.strip()}" for old in olds.split(",")]
    for old in sources:
        if old not in modules:
            raise ValueError(f"{place}: no module {old}")
    return Target(f"{ROOT}.{new.strip()}", sources, place=place)


def _check_places(found: ModuleMap, modules: Mapping[str, Path]) -> None:
    """Raise ValueError if a new module would overwrite one that stays, or be both a module and a package."""
    stays = {name for name in modules if name not in found.new_from_old}
    for target in found.targets.values():
        if target.name in stays and modules[target.name].name != "__init__.py":
            raise ValueError(f"{target.place}: {target.name} is there already and goes nowhere")
    remaining = {name for name in stays if modules[name].name != "__init__.py"} | set(found.targets)
    packages = {name.rpartition(".")[0] for name in remaining}
    for name in remaining & packages:
        raise ValueError(f"{name} would be a module and a package")
