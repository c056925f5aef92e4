"""Names follow docs/reference/glossary.md: the private terms that it replaced do not return as identifiers."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.thorough import list_cases

ROOT = Path(__file__).resolve().parents[1]
PRIVATE = """
begun belief blame brink brinks contend contends contested deeds duel duels finalist finalists foresight glance guilty
heard hears heldout hollows honesty hub impression judge judges lessons likeness looker looks nearness noting outlook
rival rivals scrutiny shelf sharpen sharpened surroundings told unevenness weighs whoever
"""
WORDS = frozenset(PRIVATE.split())
"""Words that no name contains."""
PHRASES = (
    "clear surface",
    "closer look",
    "displaced row",
    "first look",
    "first met",
    "side by side",
    "view row",
)
"""Sequences of words that no name contains."""
ORDINARY = """
Adjusted Agreement Arena Behind Bench Books Dropping Gathers LooksAround Marches Match Met Parts Sight Surveys Verdict
Way Ways adjust agree approach both brightness contest depends discs doubts dropping fitted focus ground
growing hear held influence judged kept known lanes latch lean look lost matched origin peers places relief said saw
shown sight stage steady sure surfaced top_view turns unseen until watch ways
"""
DEFINITIONS = frozenset(ORDINARY.split())
"""Names that no module, class, field or function has; as local names they may be ordinary words."""
NAMES = re.compile(r"[^\W\d]\w*")
"""A word that may be a name."""
DEFINED = re.compile(
    rf"\b(?:def|class)\s+_*(?:{'|'.join(ORDINARY.split())})_*\b|^\s+_*(?:{'|'.join(ORDINARY.split())})_*\s*:",
    re.M,
)
"""A definition that may have one of these names."""
CONTRACT = {("src/beltscape/pipeline/live/project.py", "watch")}
"""Keys of project.toml."""


def split_words(name: str) -> list[str]:
    """Return the words of a name in snake_case or CamelCase, in lower case."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]


@cache
def is_private_term(name: str) -> bool:
    """Return whether a name contains a word or a sequence of words that the glossary replaced."""
    words = split_words(name)
    joined = f" {' '.join(words)} "
    return not WORDS.isdisjoint(words) or any(f" {phrase} " in joined for phrase in PHRASES)


def python_names(tree: ast.AST) -> Iterator[str]:
    """Yield every identifier of a Python file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.arg | ast.keyword):
            yield node.arg or ""
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.alias):
            yield node.asname or node.name.rpartition(".")[2]
        elif isinstance(node, ast.ExceptHandler):
            yield node.name or ""


def defined_names(tree: ast.AST) -> Iterator[str]:
    """Yield the names of the classes, fields and functions that a Python file defines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        if isinstance(node, ast.ClassDef):
            for part in node.body:
                if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
                    yield part.target.id


def may_have_private_terms(text: str) -> bool:
    """Return whether a private term is a word of a Python file or may be defined in it; parsing takes longer."""
    return DEFINED.search(text) is not None or any(map(is_private_term, set(NAMES.findall(text))))


def find_private_terms(module: str, text: str) -> set[str]:
    """Return the private terms among the names of a Python module and in it."""
    own = module.removeprefix("test_")
    if not may_have_private_terms(f"def {own}\n{text}"):
        return set()
    tree = ast.parse(text)
    defined = {name for name in (own, *defined_names(tree)) if name.strip("_") in DEFINITIONS}
    return defined | {name for name in (own, *python_names(tree)) if is_private_term(name)}


def json_keys(value: object) -> Iterator[str]:
    """Yield the keys of a JSON value at any depth, and the names in its lists of features."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield key
            yield from part if key == "names" else json_keys(part)
    elif isinstance(value, list):
        for part in value:
            yield from json_keys(part)


@pytest.mark.parametrize("folder", list_cases(["src", "tools", "benchmarks", "tests"], ["src", "tests"]))
def test_python_names_are_terms_of_the_field(folder):
    found = {
        (str(path.relative_to(ROOT)), name)
        for path in (ROOT / folder).rglob("*.py")
        for name in find_private_terms(path.stem, path.read_text())
    }
    assert found - CONTRACT == set()


def test_cpp_names_are_terms_of_the_field():
    paths = [path for path in (ROOT / "native").rglob("*") if path.suffix in {".cpp", ".hpp"}]
    assert paths
    found = {
        (path.name, name)
        for path in paths
        for name in (path.stem, *re.findall(r"[A-Za-z_]\w*", strip_cpp_comments(path.read_text())))
        if is_private_term(name)
    }
    assert found == set()


def strip_cpp_comments(text: str) -> str:
    """Return C++ source without comments and string literals."""
    return re.sub(r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\\\n])*\"", " ", text, flags=re.S)


def test_names_in_the_weights_are_terms_of_the_field():
    found = {
        (path.name, key)
        for path in (ROOT / "src/beltscape/data").glob("*.json")
        for key in (path.stem, *json_keys(json.loads(path.read_text())))
        if is_private_term(key.replace(" ", "_")) or key in DEFINITIONS
    }
    assert found == set()


@pytest.mark.parametrize(
    ("module", "text", "term"),
    [
        ("nearness", "", "nearness"),
        ("test_scrutiny", "", "scrutiny"),
        ("depth", "def kept(mask): ...", "kept"),
        ("depth", "class Way: ...", "Way"),
        ("depth", "class State:\n    unseen: bool", "unseen"),
        ("depth", "x = y.rival_count", "rival_count"),
        ("depth", "def fit(told): ...", "told"),
        ("depth", "fit(side_by_side=True)", "side_by_side"),
        ("depth", "from module import Looker", "Looker"),
        ("depth", "FIRST_MET = 1", "FIRST_MET"),
    ],
)
def test_private_term_is_found(module, text, term):
    assert find_private_terms(module, text) == {term}


@pytest.mark.parametrize(
    "text", ["kept = 1", "def fit_known_intrinsics(): ...", "x.unseen_mm3", "'nearness told'", "# told"]
)
def test_ordinary_words_are_allowed(text):
    assert find_private_terms("depth", text) == set()
