"""Every command and code block of the README and the manual is run in order, on a rig with distorting lenses."""

from __future__ import annotations

import json

import pytest

from beltscape.files.rig_json import read_rig
from tests.docs.blocks import read_blocks, split_commands
from tests.docs.conftest import page_text
from tests.docs.program import parser_of
from tests.docs.reader import RUN_ELSEWHERE, Reader
from tests.docs.results import Results
from tests.docs.system import ROOT, RULES

PAGES = sorted(
    (str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")),
    key=lambda page: ("/tutorials/" not in page, page),  # another worker follows the README meanwhile
)


def test_the_readme_holds_step_by_step(walked):
    folder, wrong, done = walked
    assert wrong == []
    assert {words.split()[0] for words in done} >= {
        "calibrate",
        "rectify",
        "reconstruct",
        "measure",
        "run",
        "plan",
    }
    plan = json.loads((folder / "plan/plan.json").read_text())
    assert not [text for text in plan["warnings"] if "too little light" in text]
    lenses = read_rig(folder / "rig/rig.json").cameras.values()
    assert all(abs(lens.distortion[0]) > 0.05 for lens in lenses)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_holds(make_reader, page):
    reader = make_reader(page)
    reader.follow(page, page_text(page))
    assert reader.wrong == []


def blocks_with_options() -> list[tuple[str, str]]:
    """Each option in a command block of the README, with its block."""
    found = {}
    for block in read_blocks("README.md", page_text("README.md")):
        for words in split_commands(block.text) if block.kind == "sh" else []:
            for word in words:
                if words[0] == "beltscape" and word.startswith("--"):
                    found.setdefault(word, block)
    return sorted(found.items(), key=lambda item: item[0])  # pyrefly: ignore[bad-return]


@pytest.mark.parametrize(("option", "block"), blocks_with_options(), ids=lambda value: str(value)[:20])
@pytest.mark.parametrize(
    "renamed", [lambda word: word + word[-1], lambda word: word[:-2]], ids=["longer", "shorter"]
)
def test_a_renamed_option_is_found(tmp_path, option, block, renamed):
    text = page_text("README.md").replace(f"{option} ", f"{renamed(option)} ")
    line = next(b for b in read_blocks("README.md", text) if b.line == block.line)
    reader = Reader(tmp_path, Results(tmp_path / "results"))
    for words in split_commands(line.text):
        if renamed(option) in words:
            reader.attempt("here", lambda words=words: reader.command(words))
    assert any(f"no option ['{renamed(option)}']" in one for one in reader.wrong)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("```\nls\n```\n", "no rule for a block of kind ''"),
        ("```ruby\nputs 1\n```\n", "no rule for a block of kind 'ruby'"),
        ("```sh\nfrobnicate --now\n```\n", "no rule of tests/docs/system.py covers 'frobnicate'"),
        ("```sh\nmake nonsense\n```\n", "no target 'nonsense'"),
        ("```toml\n[nonsense]\na = 1\n```\n", "no rule of tests/docs/tables.py"),
        ("```python\nimport beltscape.nonsense\n```\n", "ModuleNotFoundError"),
        ("```text\nbeltscape run project.toml\n```\n", "a command in a block that nobody runs"),
        ("Type:\n\n    beltscape run project.toml\n", "a command in a block that nobody runs"),
        ("```sh\nbeltscape reconstrukt empty\n```\n", "no command 'reconstrukt'"),
        ("```sh\nbeltscape measure volume nothing/000 --empty nothing\n```\n", "exit code 2"),
        ("Give `beltscape check --board-file b.toml`.\n", "no option --board-file"),
        ("Give `beltscape replay --speed full|slow`.\n", "--speed takes"),
        ("| `beltscape measure belt\\|weight DIR` | x |\n", "no 'weight'"),
    ],
)  # fmt: skip
def test_what_does_not_hold_is_found(tmp_path, text, says):
    reader = Reader(tmp_path, Results(tmp_path / "results"))
    reader.follow("page.md", text)
    assert len(reader.wrong) == 1
    assert says in reader.wrong[0]


def test_commands_are_split_as_a_shell_splits_them():
    text = "a 'b c' \\\n  d && e f   # comment\ng; h &\n# nothing\n"
    assert split_commands(text) == [["a", "b c", "d"], ["e", "f"], ["g"], ["h"]]


def test_what_is_not_run_here_is_run_elsewhere():
    for where in RUN_ELSEWHERE.values():
        assert (ROOT / where).exists()
    assert all(callable(rule) for rule in RULES.values())
    assert parser_of("demo")
