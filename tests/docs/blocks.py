"""Code blocks and commands in the text of a page of the manual."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from textwrap import dedent

_FENCE = re.compile(r"^(?P<indent> *)```(?P<kind>[^\n`]*)\n(?P<text>.*?)^ *```[ ]*$", re.M | re.S)
_INDENTED = re.compile(r"(?<=\n\n)(?: {4,}\S[^\n]*\n|(?<=\n)\n(?= {4}))+")
_SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
_OPERATORS = ("&&", ";", "&", "|", "||")


@dataclass(frozen=True, slots=True)
class Block:
    """One code block."""

    page: str
    """Path from the repository's root."""
    line: int
    """Of its first line of text, from 1."""
    kind: str
    """What stands behind the fence; "indented" for a block without one."""
    text: str

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"


def read_blocks(page: str, text: str) -> list[Block]:
    """Return the page's code blocks in the reader's order."""
    fenced = list(_FENCE.finditer(text))
    blocks = [
        Block(page, _line(text, found.start("text")), found["kind"].strip(), dedent(found["text"]))
        for found in fenced
    ]
    for found in _INDENTED.finditer(text):
        if not any(block.start() <= found.start() < block.end() for block in fenced):
            blocks.append(Block(page, _line(text, found.start()), "indented", dedent(found[0])))
    return sorted(blocks, key=lambda block: block.line)


def read_spans(text: str) -> list[tuple[int, str]]:
    """Return (line, text) of each inline code span outside the blocks; a table's escaped bars are plain ones."""
    plain = _FENCE.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)
    return [(_line(text, found.start()), found[1].replace("\\|", "|")) for found in _SPAN.finditer(plain)]


def split_commands(text: str) -> list[list[str]]:
    """Return the words of each command of a shell block, comments and operators left out."""
    commands = []
    for line in text.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars="&;|")
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if word in _OPERATORS:
                commands += [words] if words else []
                words = []
            else:
                words.append(word)
    return commands


def _line(text: str, offset: int) -> int:
    return text.count("\n", 0, offset) + 1
