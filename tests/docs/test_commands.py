"""The reference of commands is made from their parsers, and the examples of every help fit these."""

from __future__ import annotations

import argparse
import runpy
import shlex

import pytest

from beltscape.cli.catalogue import COMMANDS, EXAMPLES
from tests.docs.conftest import page_text
from tests.docs.program import narrowed, parser_of
from tests.docs.reader import split_redirection
from tests.docs.system import ROOT

TOOL = runpy.run_path(str(ROOT / "tools/document_commands.py"))


@pytest.fixture(scope="module")
def reference() -> str:
    return TOOL["on_page_markdown"](page_text("docs/reference/commands.md"))


@pytest.mark.parametrize("command", COMMANDS)
def test_the_reference_has_every_argument(reference, command):
    section = reference.split(f"\n## {command}\n")[1].split("\n## ")[0]
    parsers = [parser_of(command), *TOOL["children_of"](parser_of(command)).values()]
    shown = [action for parser in parsers for action in parser._actions if action.help != argparse.SUPPRESS]
    for action in shown:
        for option in {*action.option_strings} - {"-h", "--help", "--json"}:
            assert f"`{option}" in section


def test_other_pages_are_left_alone():
    assert TOOL["on_page_markdown"]("# A page\n") == "# A page\n"


@pytest.mark.parametrize("example", [one for examples in EXAMPLES.values() for one in examples])
def test_examples_of_help_fit_the_parsers(example):
    words, _ = split_redirection(shlex.split(example.split("   (")[0]))
    assert narrowed(words)
    parser_of(words[0]).parse_args(words[1:])
