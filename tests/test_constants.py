"""Every number at the level of a module says in a docstring what it is and where it comes from."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src"


def is_number(node: ast.expr) -> bool:
    """Return whether an expression is written with a number: ``3.0``, ``(1, 2)``, ``1 << 20``."""
    if isinstance(node, ast.Tuple | ast.List):
        return any(map(is_number, node.elts))
    if isinstance(node, ast.BinOp):
        return is_number(node.left) or is_number(node.right)
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def is_docstring(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def undocumented(text: str) -> Iterator[str]:
    """Yield the assignments of numbers that no docstring follows."""
    body = ast.parse(text).body
    for statement, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        if isinstance(statement, ast.Assign) and is_number(statement.value) and not is_docstring(after):
            yield ast.unparse(statement)


def test_numbers_have_docstrings():
    missing = [
        f"{path.relative_to(SOURCE)}: {one}"
        for path in SOURCE.rglob("*.py")
        for one in undocumented(path.read_text())
    ]
    assert missing == []


def test_a_number_without_a_docstring_is_found():
    text = 'A = 3.0\nB = (-1, 2)\n"""Both."""\nC, D = 1 << 20, "x"\nE = "y"\nF = True\nG = len("z")\n'
    assert list(undocumented(text)) == ["A = 3.0", "C, D = (1 << 20, 'x')"]
