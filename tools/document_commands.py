"""The reference of all commands, from their parsers: a hook of mkdocs that fills docs/reference/commands.md."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from textwrap import wrap
from typing import Any

from beltscape.cli.catalogue import COMMANDS, EXAMPLES, load_command

PLACE = "<!-- commands -->"
"""Line of the page that the reference replaces."""
USAGE_WIDTH = 76
"""Characters of a line of the usage; more would scroll beside the site's two columns of contents."""


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page of the manual with the reference in its place."""
    return markdown.replace(PLACE, "\n".join(document_commands())) if PLACE in markdown else markdown


def document_commands() -> Iterator[str]:
    """Yield the lines of the reference: a heading per command, its usage, arguments and examples."""
    for name, description in COMMANDS.items():
        parser = make_parser(name)
        yield from ("", f"## {name}", "", to_sentence(description))
        yield from document_parser(parser)
        for word, child in children_of(parser).items():
            yield from ("", f"### {name} {word}", "", to_sentence(child.description or help_of(parser, word)))
            yield from document_parser(child)
        yield from ("", "```sh", *(f"beltscape {example}" for example in EXAMPLES[name]), "```")


def make_parser(name: str) -> argparse.ArgumentParser:
    """Return the parser of a command."""
    parser = argparse.ArgumentParser(prog=f"beltscape {name}")
    load_command(name).add_arguments(parser)
    return parser


def children_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of the sub-commands by name."""
    return {
        name: child
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for name, child in action.choices.items()
    }


def help_of(parser: argparse.ArgumentParser, name: str) -> str:
    """Return the line that lists a sub-command in its parent's help."""
    (actions,) = (
        one._choices_actions for one in parser._actions if isinstance(one, argparse._SubParsersAction)
    )
    return next(action.help or "" for action in actions if action.dest == name)


def to_sentence(description: str) -> str:
    """Return a description with a capital letter and a full stop."""
    return f"{description[0].upper()}{description[1:].rstrip('.')}."


def document_parser(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Yield the usage of a command and a table of its arguments."""
    if not children_of(parser):
        usage = " ".join(parser.format_usage().split()).removeprefix("usage: ").replace("[-h] ", "")
        lines = wrap(usage, USAGE_WIDTH, subsequent_indent="    ", break_on_hyphens=False)
        yield from ("", "```text", *lines, "```")
    rows = [action for action in parser._actions if not isinstance(action, argparse._SubParsersAction)]
    rows = [action for action in rows if action.dest != "help" and action.help is not argparse.SUPPRESS]
    if rows:
        yield from ("", "| argument | |", "|---|---|", *map(format_row, rows))


def format_row(action: argparse.Action) -> str:
    """Return the table's row of an argument."""
    values = list(action.choices) if action.choices else []
    metavar = (
        action.metavar if isinstance(action.metavar, tuple) else (action.metavar or action.dest.upper(),)
    )
    words = " ".join(str(word) for word in metavar) if action.nargs != 0 else ""
    name = ", ".join(f"`{option} {words}`".replace(" `", "`") for option in action.option_strings)
    text = (action.help or "") % {**vars(action), "prog": "beltscape"}
    listed = f"; one of {', '.join(f'`{value}`' for value in values)}" if values and len(values) < 12 else ""
    return f"| {name or f'`{words}`'} | {text}{listed} |".replace("<", "&lt;")
