"""Prove that a move changed no definition: every one has the same syntax tree before and after, but for mapped names.

    python tools/house/prove_move.py BEFORE MAP…

``BEFORE`` is the source folder before the move, such as that of a worktree of the commit before. In both trees each
name is replaced by what it stands for (module and definition, by the map in the tree before), imports are left out,
and the trees of all definitions of a new module are compared as a multiset of what `ast.dump` gives. Definitions that
two joined modules had alike, such as an alias of a type, are counted.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

from module_map import ROOT, ModuleMap, list_modules, read_maps
from move_modules import REPOSITORY, World, read_reexports

Environment = dict[str, str]


class Normaliser(ast.NodeTransformer):
    """Replaces names by what they stand for, in one definition of a module."""

    def __init__(self, tree: Tree, module: str, environment: Environment) -> None:
        self.tree, self.module = tree, module
        self.scopes: list[Environment | set[str]] = [environment]

    def _look_up(self, name: str) -> str | None:
        for scope in reversed(self.scopes):
            if isinstance(scope, set):
                if name in scope:
                    return None
            elif name in scope:
                return scope[name]
        return None

    def visit_Name(self, node: ast.Name) -> ast.AST:
        found = self._look_up(node.id)
        return ast.Name(found, node.ctx) if found else node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        value = self.visit(node.value)
        if isinstance(value, ast.Name) and value.id.startswith("module "):
            return ast.Name(self.tree.identify(value.id.removeprefix("module "), node.attr), node.ctx)
        return ast.Attribute(value, node.attr, node.ctx)

    def visit_Global(self, node: ast.Global) -> ast.AST:
        return ast.Global([self._look_up(name) or name for name in node.names])

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if isinstance(node.value, str):
            return ast.Constant(" ".join(self.tree.rewrite(node.value).split()))
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        return self._visit_scope(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.AST:
        return self._visit_scope(node)

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        return self._visit_scope(node)

    def _visit_scope(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) -> ast.AST:
        if not isinstance(node, ast.Lambda):
            node.decorator_list = [self.visit(one) for one in node.decorator_list]
            if node.returns:
                node.returns = self.visit(node.returns)
        for argument in ast.walk(node.args):
            if isinstance(argument, ast.arg) and argument.annotation:
                argument.annotation = self.visit(argument.annotation)
        node.args.defaults = [self.visit(one) for one in node.args.defaults]
        node.args.kw_defaults = [one and self.visit(one) for one in node.args.kw_defaults]
        self.scopes += [find_locals(node), self.tree.import_names(node)]
        if isinstance(node, ast.Lambda):
            node.body = self.visit(node.body)
        else:
            node.body = self._visit_body(node.body)
        del self.scopes[-2:]
        return node

    def _visit_body(self, body: list[ast.stmt]) -> list[ast.stmt]:
        kept = [self.visit(one) for one in body if not isinstance(one, ast.Import | ast.ImportFrom)]
        return [one for one in kept if not isinstance(one, ast.Pass)]

    def generic_visit(self, node: ast.AST) -> ast.AST:
        for field in ("body", "orelse", "finalbody"):
            statements = getattr(node, field, None)
            if isinstance(statements, list):
                setattr(
                    node, field, [s for s in statements if not isinstance(s, ast.Import | ast.ImportFrom)]
                )
        return super().generic_visit(node)


def find_locals(node: ast.AST) -> set[str]:
    """Return the names that a function binds, imports excepted."""
    found: set[str] = set()
    shared: set[str] = set()
    waiting = list(ast.iter_child_nodes(node))
    while waiting:
        one = waiting.pop()
        if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(one.name)
            continue
        if isinstance(one, ast.Lambda):
            continue
        if isinstance(one, ast.arg):
            found.add(one.arg)
        elif isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store | ast.Del):
            found.add(one.id)
        elif isinstance(one, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and one.name:
            found.add(one.name)
        elif isinstance(one, ast.Global | ast.Nonlocal):
            shared |= set(one.names)
        waiting += list(ast.iter_child_nodes(one))
    return found - shared


class Tree:
    """A source tree; with a map, that before the move."""

    def __init__(self, source: Path, moves: ModuleMap, old: World) -> None:
        self.modules, self.moves, self.old = list_modules(source), moves, old
        self.is_before = self.modules.keys() == old.modules.keys()

    def locate(self, module: str) -> str:
        return self.moves.locate(module) if self.is_before else module

    def rewrite(self, text: str) -> str:
        return self.old.rewrite(text) if self.is_before else text

    def identify(self, module: str, name: str) -> str:
        """Return what a name of a module stands for, in the words of the new tree."""
        whole = f"{module}.{name}"
        if whole in self.modules:
            return f"module {whole}"
        if self.is_before:
            module, name = self.old.follow(module, name)
            return f"{self.moves.locate(module)}.{self.moves.rename(module, name)}"
        return whole

    def import_names(self, node: ast.AST) -> Environment:
        """Return what the imports below a node bind."""
        found: Environment = {}
        for one in ast.walk(node):
            if isinstance(one, ast.ImportFrom) and one.module:
                for alias in one.names:
                    if one.module.split(".")[0] == ROOT:
                        found[alias.asname or alias.name] = self.identify(one.module, alias.name)
                    else:
                        found[alias.asname or alias.name] = f"{one.module}.{alias.name}"
            elif isinstance(one, ast.Import):
                for alias in one.names:
                    local = alias.asname or alias.name.split(".")[0]
                    name = alias.name if alias.asname else local
                    found[local] = f"module {name}" if name in self.modules and alias.asname else name
        return found

    def iterate_definitions(self) -> Iterator[tuple[str, str]]:
        """Yield (new module, dump) of each statement of each module that is neither an import nor a docstring."""
        for module, path in self.modules.items():
            tree = ast.parse(path.read_text())
            environment = self.import_names(ast.Module([s for s in tree.body if _is_header(s)], []))
            own = {name for s in tree.body if not _is_header(s) for name in find_locals(ast.Module([s], []))}
            environment |= {name: self.identify(module, name) for name in own}
            for statement in tree.body:
                if _is_header(statement) or _is_docstring(statement):
                    continue
                normal = Normaliser(self, module, environment).visit(statement)
                if hasattr(normal, "name"):
                    normal.name = environment[normal.name]
                yield self.locate(module), ast.dump(normal)


def _is_header(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Import | ast.ImportFrom) or (
        isinstance(statement, ast.If) and "TYPE_CHECKING" in ast.unparse(statement.test)
    )


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def main() -> int:
    before, *maps = [Path(one) for one in sys.argv[1:]]
    old_modules = list_modules(before)
    moves = read_maps(maps, old_modules)
    old = World(old_modules, moves)
    read_reexports(old)
    found: list[dict[str, Counter[str]]] = []
    for source in (before, REPOSITORY / "src"):
        counted: dict[str, Counter[str]] = defaultdict(Counter)
        for module, dump in Tree(source, moves, old).iterate_definitions():
            counted[module][dump] += 1
        found.append(counted)
    wrong = repeated = total = 0
    for module in sorted({*found[0], *found[1]}):
        a, b = found[0].get(module, Counter()), found[1].get(module, Counter())
        total += len(a)
        repeated += sum((Counter({d: n for d, n in a.items() if n > 1}) - b).values())
        for text, one, other in (("lost", a, b), ("new", b, a)):
            for dump in one.keys() - other.keys():
                wrong += 1
                print(f"{module}: {text}: {dump[: 2000 if '-v' in sys.argv else 160]}")
    print(f"{total} definitions, {wrong} changed, {repeated} that two joined modules had alike")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
