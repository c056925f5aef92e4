"""Move modules by a map: joins files, and rewrites every import, name, dotted text and path that follows from it.

    pip install libcst && python tools/house/move_modules.py MAP… [--check]

``--check`` changes nothing and lists what is in the way: names that two joined modules bind to different things,
circles of the new imports, and modules that the rule of sizes and levels does not allow.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

import libcst as cst
from libcst.helpers import get_full_name_for_node
from libcst.metadata import (
    Access,
    Assignment,
    BaseAssignment,
    GlobalScope,
    ImportAssignment,
    MetadataWrapper,
    ParentNodeProvider,
    Scope,
    ScopeProvider,
)
from module_map import ROOT, ModuleMap, list_modules, read_maps

REPOSITORY = Path(__file__).resolve().parents[2]
CODE = ("src", "tests", "benchmarks", "tools", "docs", "deploy", "examples")
TEXTS = (
    ".pyi",
    ".md",
    ".toml",
    ".txt",
    ".yml",
    ".yaml",
    ".json",
    ".cmake",
    ".ipynb",
    ".cfg",
    ".service",
    ".sh",
    ".hpp",
    ".cpp",
)


@dataclass(slots=True)
class World:
    """Modules of the source tree, and the map."""

    modules: Mapping[str, Path]
    moves: ModuleMap
    reexports: dict[tuple[str, str], tuple[str, str]] = field(default_factory=dict)
    """(package, name) → (module, name) of what a package's own file imports for others."""
    problems: list[str] = field(default_factory=list[str])

    def follow(self, module: str, name: str) -> tuple[str, str]:
        """Return where a name that a dissolved package passes on is defined."""
        seen = set()
        while (module, name) in self.reexports and (module, name) not in seen:
            seen.add((module, name))
            if self.survives(module):
                break
            module, name = self.reexports[module, name]
        return module, name

    def survives(self, package: str) -> bool:
        """Return whether a package's own file stays."""
        if self.modules[package].name != "__init__.py":
            return True
        return any(
            new.startswith(f"{package}.")
            for new in [*self.moves.targets, *(m for m in self.modules if m not in self.moves.new_from_old)]
            if new not in self.modules or self.modules[new].name != "__init__.py" or new in self.moves.targets
        )

    def rewrite(self, text: str) -> str:
        """Return a text with the new names of modules and paths."""
        text = re.sub(rf"\b{ROOT}(?:\.\w+)+", lambda m: self.moves.rename_dotted(m[0], self.modules), text)
        return re.sub(r"(?:[\w.]+/)+\w+\.py\b", lambda m: self._rewrite_path(m[0]), text)

    def _rewrite_path(self, text: str) -> str:
        for prefix in (f"src/{ROOT}/", f"{ROOT}/", ""):
            if text.startswith(prefix):
                stem = text.removeprefix(prefix).removesuffix(".py").replace("/", ".")
                module = f"{ROOT}.{stem}"
                if module in self.moves.new_from_old:
                    new = self.moves.locate(module).removeprefix(f"{ROOT}.")
                    return f"{prefix}{new.replace('.', '/')}.py"
        return text


@dataclass(slots=True)
class Imported:
    """One imported name of a file, before and after."""

    local: str
    new_local: str
    module: str
    """New module; of a whole-module import its package."""
    name: str
    """New name in it."""
    is_own: bool
    """Whether it is of the same new module, so that no import is left."""


def make_dotted(name: str) -> cst.Name | cst.Attribute:
    node = cst.parse_expression(name)
    assert isinstance(node, cst.Name | cst.Attribute)
    return node


class Rewriter(cst.CSTTransformer):
    """Rewrites one file; ``own`` is its new module, "" for a file outside the package."""

    METADATA_DEPENDENCIES = (ScopeProvider, ParentNodeProvider)

    def __init__(self, world: World, old: str, own: str, place: str, wrapper: MetadataWrapper) -> None:
        super().__init__()
        self.world, self.old, self.own, self.place = world, old, own, place
        self.replaced: dict[int, cst.CSTNode] = {}
        self.renamed: dict[int, str] = {}
        """New names by id of definitions' nodes."""
        scopes = wrapper.resolve(ScopeProvider)
        self.parents = wrapper.resolve(ParentNodeProvider)
        self.scopes = {scope for scope in scopes.values() if scope is not None}
        self.bound = {name for scope in self.scopes for name in (a.name for a in scope.assignments)}
        self._plan()

    # ---- planning
    def _plan(self) -> None:
        for scope in self.scopes:
            for assignment in list(scope.assignments):
                if isinstance(assignment, ImportAssignment):
                    self._plan_import(assignment)
                elif isinstance(scope, GlobalScope) and isinstance(assignment, Assignment) and self.old:
                    self._plan_definition(assignment)

    def _plan_definition(self, assignment: Assignment) -> None:
        new = self.world.moves.rename(self.old, assignment.name)
        if new == assignment.name:
            return
        self.renamed[id(assignment.node)] = new
        self._replace_references(assignment, assignment.name, new)

    def _replace_references(self, assignment: BaseAssignment, old: str, new: str) -> None:
        for access in assignment.references:
            node = access.node
            if isinstance(node, cst.Attribute):
                while isinstance(node, cst.Attribute):
                    node = node.value
            if isinstance(node, cst.Name) and node.value == old:
                self._check_shadow(access, new, old)
                self.replaced[id(node)] = cst.Name(new)

    def _check_shadow(self, access: Access, new: str, old: str) -> None:
        scope: Scope = access.scope
        while not isinstance(scope, GlobalScope):
            if any(a.name == new for a in scope.assignments):
                self.world.problems.append(f"{self.place}: {old} → {new} is shadowed by a local name")
                return
            if scope.parent is scope:
                return
            scope = scope.parent

    def _plan_import(self, assignment: ImportAssignment) -> None:
        node = assignment.node
        for origin, alias, _ in self._entries(node):
            local = alias or origin[1] or origin[0]
            if local.split(".")[0] != assignment.name.split(".")[0] or local != assignment.name:
                continue
            if isinstance(node, cst.Import) and not alias:
                self._plan_plain_import(assignment)
                continue
            found = self.resolve(origin, alias)
            if found is None:
                continue
            module = f"{origin[0]}.{origin[1]}" if origin[1] else origin[0]
            if module in self.world.modules:
                self._plan_module_references(assignment, module, found)
            elif found.local != found.new_local:
                self._replace_references(assignment, found.local, found.new_local)

    def _plan_plain_import(self, assignment: ImportAssignment) -> None:
        for access in assignment.references:
            node = access.node
            full = get_full_name_for_node(node)
            if full:
                self.replaced[id(node)] = make_dotted(
                    self.world.moves.rename_dotted(full, self.world.modules)
                )

    def _plan_module_references(self, assignment: ImportAssignment, module: str, found: Imported) -> None:
        for access in assignment.references:
            node = access.node
            while isinstance(node, cst.Attribute):
                node = node.value
            if not isinstance(node, cst.Name):
                continue
            parent = self.parents.get(node)
            if isinstance(parent, cst.Attribute) and parent.value is node:
                attribute = self.world.moves.rename(module, parent.attr.value)
                if found.is_own:
                    self.replaced[id(parent)] = cst.Name(attribute)
                else:
                    self.replaced[id(parent)] = parent.with_changes(
                        value=cst.Name(found.new_local), attr=cst.Name(attribute)
                    )
            elif found.is_own:
                self.world.problems.append(
                    f"{self.place}: {module} is used as an object in its own new module"
                )
            else:
                self.replaced[id(node)] = cst.Name(found.new_local)

    def _entries(self, node: cst.CSTNode) -> Iterator[tuple[tuple[str, str], str, cst.ImportAlias]]:
        """Yield ((module, name), alias, node) of an import; name is "" for a whole module."""
        if isinstance(node, cst.ImportFrom):
            if isinstance(node.names, cst.ImportStar) or node.module is None:
                return
            module = get_full_name_for_node(node.module) or ""
            for one in node.names:
                yield (module, one.evaluated_name), one.evaluated_alias or "", one
        elif isinstance(node, cst.Import):
            for one in node.names:
                yield (one.evaluated_name, ""), one.evaluated_alias or "", one

    def resolve(self, origin: tuple[str, str], alias: str) -> Imported | None:
        """Return what becomes of an imported name; None for one of another package."""
        world, (module, name) = self.world, origin
        if not name and "." not in module:
            return None
        if module.split(".")[0] != ROOT or (
            module not in world.modules and f"{module}.{name}" not in world.modules
        ):
            return None
        whole = f"{module}.{name}" if name else module
        if whole in world.modules:
            new = world.moves.locate(whole)
            package, _, last = new.rpartition(".")
            local = alias or name or module
            new_local = alias if alias and alias != name else last
            if new_local != local and new_local in self.bound:
                new_local = local
            return Imported(local, new_local, package, last, new == self.own)
        origin_module, origin_name = world.follow(module, name)
        new, new_name = world.moves.locate(origin_module), world.moves.rename(origin_module, origin_name)
        is_own = new == self.own
        local = alias or name
        new_local = new_name if is_own or not alias else alias
        if self.old:
            chosen = world.moves.rename(self.old, local)
            if chosen != local and not is_own:
                new_local = chosen
        if new_local != local and new_local in self.bound and not is_own:
            new_local = local
        return Imported(local, new_local, new, new_name, is_own)

    # ---- rewriting
    def on_leave(self, original_node, updated_node):
        if id(original_node) in self.replaced:
            return self.replaced[id(original_node)]
        return super().on_leave(original_node, updated_node)

    def leave_FunctionDef(self, original_node, updated_node):  # noqa: N802
        return self._named(original_node, updated_node)

    def leave_ClassDef(self, original_node, updated_node):  # noqa: N802
        return self._named(original_node, updated_node)

    def _named(self, original_node, updated_node):
        new = self.renamed.get(id(original_node))
        return updated_node.with_changes(name=cst.Name(new)) if new else updated_node

    def leave_Name(self, original_node, updated_node):  # noqa: N802
        new = self.renamed.get(id(original_node))
        return updated_node.with_changes(value=new) if new else updated_node

    def leave_Global(self, original_node, updated_node):  # noqa: N802
        names = [
            item.with_changes(name=cst.Name(self.world.moves.rename(self.old, item.name.value)))
            for item in updated_node.names
        ]
        return updated_node.with_changes(names=names)

    def leave_SimpleString(self, original_node, updated_node):  # noqa: N802
        return updated_node.with_changes(value=self.world.rewrite(updated_node.value))

    def leave_FormattedStringText(self, original_node, updated_node):  # noqa: N802
        return updated_node.with_changes(value=self.world.rewrite(updated_node.value))

    def leave_Comment(self, original_node, updated_node):  # noqa: N802
        return updated_node.with_changes(value=self.world.rewrite(updated_node.value))

    def leave_SimpleStatementLine(self, original_node, updated_node):  # noqa: N802
        if len(original_node.body) != 1 or not isinstance(original_node.body[0], cst.ImportFrom | cst.Import):
            return updated_node
        node = original_node.body[0]
        if isinstance(node, cst.ImportFrom) and isinstance(node.names, cst.ImportStar):
            return updated_node
        lines: dict[str, list[str]] = {}
        is_changed = False
        for origin, alias, _ in self._entries(node):
            if isinstance(node, cst.Import) and not alias:
                new = self.world.moves.rename_dotted(origin[0], self.world.modules)
                lines[f"import {new}"] = []
                is_changed |= new != origin[0]
                continue
            found = self.resolve(origin, alias)
            if found is None:
                if isinstance(node, cst.Import):
                    lines[f"import {origin[0]} as {alias}"] = []
                else:
                    text = f"{origin[1]} as {alias}" if alias else origin[1]
                    lines.setdefault(f"from {origin[0]} import ", []).append(text)
                continue
            is_changed = True
            if found.is_own:
                continue
            text = found.name if found.name == found.new_local else f"{found.name} as {found.new_local}"
            lines.setdefault(f"from {found.module} import ", []).append(text)
        if not is_changed:
            return updated_node
        statements = [
            cst.parse_statement(head + ", ".join(dict.fromkeys(names)))
            if names
            else cst.parse_statement(head)
            for head, names in lines.items()
        ]
        if not statements:
            parent = self.parents.get(original_node)
            if isinstance(parent, cst.IndentedBlock) and len(parent.body) == 1:
                return cst.parse_statement("pass")
            return cst.RemoveFromParent()
        statements[0] = statements[0].with_changes(leading_lines=updated_node.leading_lines)
        last = statements[-1]
        statements[-1] = last.with_changes(trailing_whitespace=updated_node.trailing_whitespace)
        return cst.FlattenSentinel(statements)


def rewrite_file(world: World, path: Path, old: str, own: str) -> cst.Module:
    """Return a file's rewritten tree; problems are added to the world's."""
    wrapper = MetadataWrapper(cst.parse_module(path.read_text()))
    place = str(path.relative_to(REPOSITORY))
    return wrapper.module.visit(Rewriter(world, old, own, place, wrapper))


_WORLD: list[World] = []


def _rewrite_here(job: tuple[Path, str, str]) -> tuple[str, list[str]]:
    """Return a file's rewritten code and the problems, in a process of its own."""
    world = _WORLD[0]
    world.problems.clear()
    code = rewrite_file(world, *job).code
    return code, list(world.problems)


def rewrite_files(world: World, jobs: Sequence[tuple[Path, str, str]]) -> list[str]:
    """Return the rewritten code of files (path, old module, new module), on all cores."""
    _WORLD[:] = [world]
    with ProcessPoolExecutor(mp_context=get_context("fork")) as pool:
        found = list(pool.map(_rewrite_here, jobs, chunksize=4))
    world.problems += [problem for _, problems in found for problem in problems]
    return [code for code, _ in found]


def read_reexports(world: World) -> None:
    """Note what packages' own files import from below."""
    for name, path in world.modules.items():
        if path.name != "__init__.py":
            continue
        for statement in cst.parse_module(path.read_text()).body:
            for node in (
                getattr(statement, "body", ()) if isinstance(statement, cst.SimpleStatementLine) else ()
            ):
                if (
                    isinstance(node, cst.ImportFrom)
                    and not isinstance(node.names, cst.ImportStar)
                    and node.module
                ):
                    module = get_full_name_for_node(node.module) or ""
                    if module in world.modules:
                        for one in node.names:
                            local = one.evaluated_alias or one.evaluated_name
                            world.reexports[name, local] = (module, one.evaluated_name)


# ---- joining


@dataclass(slots=True)
class Part:
    """What a rewritten source gives to the module that it joins."""

    source: str
    docstring: str
    imports: list[cst.SimpleStatementLine]
    typing_imports: list[cst.SimpleStatementLine]
    body: list[cst.BaseStatement]


def split_module(source: str, tree: cst.Module) -> Part:
    docstring, imports, typing_imports, body = "", [], [], []
    statements = list(tree.body)
    if statements and tree.get_docstring() is not None:
        docstring = tree.get_docstring() or ""
        statements = statements[1:]
    for statement in statements:
        if _is_import(statement):
            if "__future__" not in cst.Module([statement]).code:
                imports.append(statement)
        elif isinstance(statement, cst.If) and _is_typing(statement):
            for inner in statement.body.body:
                (typing_imports if _is_import(inner) else body).append(inner)
        else:
            body.append(statement)
    return Part(source, docstring, imports, typing_imports, body)


def _is_import(statement: cst.BaseStatement) -> bool:
    return isinstance(statement, cst.SimpleStatementLine) and all(
        isinstance(node, cst.Import | cst.ImportFrom) for node in statement.body
    )


def _is_typing(statement: cst.If) -> bool:
    return (
        get_full_name_for_node(statement.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")
        and not statement.orelse
    )


def iterate_bindings(statement: cst.BaseStatement) -> Iterator[tuple[str, str]]:
    """Yield (name, what it is) for the names that a statement of a module binds."""
    if isinstance(statement, cst.FunctionDef | cst.ClassDef):
        yield statement.name.value, cst.Module([statement.with_changes(leading_lines=())]).code
    elif isinstance(statement, cst.SimpleStatementLine):
        for node in statement.body:
            code = cst.Module([cst.SimpleStatementLine([node])]).code
            if isinstance(node, cst.ImportFrom) and not isinstance(node.names, cst.ImportStar):
                module = get_full_name_for_node(node.module) if node.module else ""
                for one in node.names:
                    yield (
                        one.evaluated_alias or one.evaluated_name,
                        f"from {module} import {one.evaluated_name}",
                    )
            elif isinstance(node, cst.Import):
                for one in node.names:
                    local = one.evaluated_alias or one.evaluated_name.split(".")[0]
                    yield local, f"import {one.evaluated_name if one.evaluated_alias else local}"
            elif isinstance(node, cst.Assign):
                for target in node.targets:
                    for name in _names_of(target.target):
                        yield name, code
            elif isinstance(node, cst.AnnAssign):
                for name in _names_of(node.target):
                    yield name, code
            elif isinstance(node, cst.TypeAlias):
                yield node.name.value, code
    elif isinstance(statement, cst.If | cst.Try | cst.With | cst.For):
        for inner in statement.body.body:
            yield from iterate_bindings(inner)


def _names_of(node: cst.BaseExpression) -> list[str]:
    if isinstance(node, cst.Name):
        return [node.value]
    if isinstance(node, cst.Tuple | cst.List):
        return [name for element in node.elements for name in _names_of(element.value)]
    return []


def order_sources(sources: Sequence[str], dependencies: Mapping[str, set[str]]) -> list[str]:
    """Return sources so that each follows those that it imports; else in the order of the map."""
    ordered: list[str] = []
    waiting = list(sources)
    while waiting:
        for source in waiting:
            if not (dependencies[source] & set(waiting)) - {source}:
                break
        else:
            source = waiting[0]
        ordered.append(source)
        waiting.remove(source)
    return ordered


def join(world: World, name: str, parts: Sequence[Part], docstring: str, place: str) -> str:
    """Return the code of a new module."""
    kept: dict[str, tuple[str, str]] = {}
    body: list[cst.BaseStatement] = []
    for part in parts:
        for statement in part.body:
            bindings = list(iterate_bindings(statement))
            is_repeated = bool(bindings)
            for bound, what in bindings:
                before = kept.get(bound)
                if before is None or before[1] == part.source:
                    is_repeated = False
                elif before[0] != what:
                    is_repeated = False
                    world.problems.append(
                        f"{place}: {name}: {bound} is of {before[1].removeprefix(ROOT + '.')} and "
                        f"{part.source.removeprefix(ROOT + '.')}"
                    )
                if before is None:
                    kept[bound] = (what, part.source)
            if not is_repeated:
                body.append(statement)
    seen: dict[str, str] = {}
    runtime = _collect_imports(
        world, name, place, [(p.source, s) for p in parts for s in p.imports], kept, seen
    )
    typing = _collect_imports(
        world, name, place, [(p.source, s) for p in parts for s in p.typing_imports], kept, seen
    )
    text = [
        f'"""{docstring}"""' if "\n" not in docstring else f'"""{docstring.rstrip()}\n"""',
        "",
        "from __future__ import annotations",
        "",
    ]
    text += runtime
    if typing:
        if "from typing import TYPE_CHECKING" not in runtime:
            text.append("from typing import TYPE_CHECKING")
        text += ["", "if TYPE_CHECKING:", *(f"    {line}" for line in typing)]
    code = cst.Module(body).code
    return "\n".join(text) + "\n\n" + code


def _collect_imports(
    world: World,
    name: str,
    place: str,
    statements: Sequence[tuple[str, cst.SimpleStatementLine]],
    kept: Mapping[str, tuple[str, str]],
    seen: dict[str, str],
) -> list[str]:
    lines: list[str] = []
    for source, statement in statements:
        for node in statement.body:
            single = cst.SimpleStatementLine([node])
            comment = statement.trailing_whitespace.comment
            tail = f"  {comment.value}" if comment else ""
            for bound, what in iterate_bindings(single):
                if bound in kept:
                    world.problems.append(
                        f"{place}: {name}: {bound} is imported in {source.removeprefix(ROOT + '.')} ({what}) and "
                        f"defined in {kept[bound][1].removeprefix(ROOT + '.')}"
                    )
                if bound in seen and seen[bound] != what:
                    world.problems.append(
                        f"{place}: {name}: {bound} is imported as two things: {seen[bound]}; {what} "
                        f"({source.removeprefix(ROOT + '.')})"
                    )
                if bound in seen:
                    continue
                seen[bound] = what
                last = what.rsplit(" ", 1)[1]
                alias = (
                    f" as {bound}"
                    if bound != last
                    and not (what.startswith("import ") and "." not in last and bound == last)
                    else ""
                )
                lines.append(f"{what}{alias}{tail}")
            if isinstance(node, cst.Import):
                for one in node.names:
                    if not one.evaluated_alias and "." in one.evaluated_name:
                        lines.append(f"import {one.evaluated_name}")
    return list(dict.fromkeys(lines))


# ---- checks


def find_dependencies(modules: Mapping[str, Path]) -> dict[str, set[str]]:
    """Return module → modules of the package that it imports at any depth of its code, without typing ones."""
    found: dict[str, set[str]] = {}
    # imports at the margin only: one within a function or for types is no circle at run time
    pattern = re.compile(rf"^from ({ROOT}[\w.]*) import (\([^)]*\)|.*)$", re.M)
    for name, path in modules.items():
        text = path.read_text()
        used: set[str] = set()
        for match in pattern.finditer(text):
            names = re.findall(
                r"(\w+)(?: as \w+)?\s*(?:,|$|\)|\n|#)", re.sub(r"#.*", "", match[2]).strip("()")
            )
            for one in names:
                whole = f"{match[1]}.{one}"
                used.add(whole if whole in modules else match[1])
        found[name] = {one for one in used if one in modules} - {name}
    return found


def check_map(world: World) -> list[str]:
    """Return what the rules of the house say against the new tree."""
    dependencies = find_dependencies(world.modules)
    sizes: Counter[str] = Counter()
    graph: dict[str, set[str]] = defaultdict(set)
    for old, path in world.modules.items():
        if path.name == "__init__.py" and not world.survives(old) and old not in world.moves.new_from_old:
            continue
        new = world.moves.locate(old)
        sizes[new] += path.read_text().count("\n")
        graph[new] |= {world.moves.locate(one) for one in dependencies[old]} - {new}
    packages = {name.split(".")[1] for name in world.moves.targets}
    lines = [
        f"circle: {' → '.join(circle)}"
        for circle in find_circles(graph)
        if packages & {name.split(".")[1] for name in circle}
    ]
    sizes = Counter(
        {new: size for new, size in sizes.items() if new.count(".") and new.split(".")[1] in packages}
    )
    before = sum(name.count(".") > 0 and name.split(".")[1] in packages for name in world.modules)
    for new, size in sorted(sizes.items()):
        depth = new.count(".")
        is_package = (
            new in world.modules
            and world.modules[new].name == "__init__.py"
            and new not in world.moves.targets
        )
        if depth > 3 and not is_package:
            lines.append(f"level: {new}")
        if size > 480 and not is_package:
            lines.append(f"large: {new} {size}")
        if size < 60 and not is_package:
            lines.append(f"small: {new} {size}")
    lines.append(f"files: {before} → {len(sizes)}")
    return lines


def find_circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Return groups of modules that import each other (Tarjan, 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    circles: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = []
            while True:
                one = stack.pop()
                group.append(one)
                if one == node:
                    break
            if len(group) > 1:
                circles.append(sorted(group))

    sys.setrecursionlimit(10_000)
    for node in sorted(graph):
        if node not in index:
            visit(node)
    return circles


# ---- the whole


def iterate_files() -> Iterator[Path]:
    listed = subprocess.run(["git", "ls-files", *CODE, "*.md", "*.toml", "*.txt", ".github", ".ci"], cwd=REPOSITORY,
                            capture_output=True, text=True, check=True).stdout.split("\n")  # fmt: skip
    for name in listed:
        path = REPOSITORY / name
        if name and path.is_file() and "tools/house" not in name:
            yield path


def move(world: World, is_check: bool) -> None:
    source = REPOSITORY / "src"
    rewritten: dict[Path, str] = {}
    dependencies = find_dependencies(world.modules)
    old_of = {path: name for name, path in world.modules.items()}
    jobs = [(world.modules[old], old, t.name) for t in world.moves.targets.values() for old in t.sources]
    codes = dict(zip((job[1] for job in jobs), rewrite_files(world, jobs), strict=True))
    for target in world.moves.targets.values():
        sources = order_sources(target.sources, dependencies)
        trees = {old: cst.parse_module(codes[old]) for old in sources}
        parts = [split_module(old, trees[old]) for old in sources]
        first = target.sources[0]
        docstring = target.docstring or next(p.docstring for p in parts if p.source == first)
        path = source / (target.name.replace(".", "/") + ".py")
        if len(sources) == 1 and not target.docstring:
            rewritten[path] = trees[first].code
        else:
            rewritten[path] = join(world, target.name, parts, docstring, target.place)
    if is_check:
        return
    others: list[tuple[Path, str, str]] = []
    for path in iterate_files():
        if path in old_of and old_of[path] in world.moves.new_from_old:
            continue
        if path.suffix == ".py":
            old = old_of.get(path, "")
            if path.name == "__init__.py" and old and not world.survives(old):
                continue
            text = path.read_text()
            if ROOT in text or ".py" in text:
                others.append((path, old, old))
        elif path.suffix in TEXTS or path.name in ("Makefile", "CMakeLists.txt"):
            text = path.read_text()
            new = world.rewrite(text)
            if new != text:
                rewritten[path] = new
    for (path, _, _), code in zip(others, rewrite_files(world, others), strict=True):
        if code != path.read_text():
            rewritten[path] = code
    if world.problems:
        return
    for old in world.moves.new_from_old:
        world.modules[old].unlink()
    for old, path in world.modules.items():
        if path.name == "__init__.py" and path.exists() and not world.survives(old):
            statements = [s for s in cst.parse_module(path.read_text()).body if not _is_import(s)]
            if len(statements) > 1:
                print(f"lost with its package: {path}")
            path.unlink()
    for path, text in rewritten.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    _close_packages(source)


def _close_packages(source: Path) -> None:
    for folder in sorted((source / ROOT).rglob("*"), reverse=True):
        if folder.is_dir() and folder.name != "__pycache__":
            if any(folder.glob("*.py")) and not (folder / "__init__.py").exists():
                print(f"no __init__.py: {folder.relative_to(source)}")
            rest = [p for p in folder.iterdir() if p.name != "__pycache__"]
            if not rest:
                subprocess.run(["rm", "-r", str(folder)], check=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps", nargs="+", type=Path)
    parser.add_argument("--check", action="store_true", help="change nothing; say what is in the way")
    parser.add_argument(
        "--rules", action="store_true", help="as --check, without the names that two modules bind"
    )
    arguments = parser.parse_args()
    modules = list_modules(REPOSITORY / "src")
    world = World(modules, read_maps(arguments.maps, modules))
    read_reexports(world)
    if arguments.check or arguments.rules:
        print("\n".join(check_map(world)))
    if arguments.rules:
        return 0
    move(world, arguments.check)
    print("\n".join(dict.fromkeys(world.problems)))
    return bool(world.problems)


if __name__ == "__main__":
    sys.exit(main())
