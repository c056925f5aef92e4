"""The examples in every help: each command has one, and each is a command line that the program takes."""

from __future__ import annotations

import pytest

from beltscape.cli.catalogue import COMMANDS, EXAMPLES
from beltscape.cli.main import main
from tests.docs.program import parser_of


def test_every_command_has_an_example():
    assert list(EXAMPLES) == sorted(EXAMPLES, key=list(COMMANDS).index)
    assert set(EXAMPLES) == set(COMMANDS)


@pytest.mark.parametrize("example", [one for examples in EXAMPLES.values() for one in examples])
def test_the_program_takes_the_example(example):
    words = example.split("   ")[0].split(" > ")[0].split()
    parser_of(words[0]).parse_args(words[1:])


@pytest.mark.parametrize(
    ("words", "shown", "hidden"),
    [
        (["reconstruct"], "beltscape reconstruct loaded --rig", "beltscape measure"),
        (["measure"], "beltscape measure volume", "beltscape run"),
        (["measure", "belt"], "beltscape measure belt", "beltscape measure volume"),
    ],
)
def test_help_ends_with_examples(words, shown, hidden, capsys):
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    text = capsys.readouterr().out
    assert shown in text.split("example")[-1]
    assert hidden not in text
