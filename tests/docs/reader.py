"""A reader of the manual: runs the blocks of a page one after the other in one folder."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import patch

import yaml

from beltscape.cli.catalogue import COMMANDS
from beltscape.files.encoder_csv import read_encoder
from tests.docs.blocks import Block, read_blocks, read_spans, split_commands
from tests.docs.plant import find_newest, make_history, make_tested_history, write_test_file
from tests.docs.program import call, narrowed, parser_of, unknown_options
from tests.docs.results import Results
from tests.docs.service import curl, run_service
from tests.docs.system import ROOT, RULES, Wrong, demand, run_system
from tests.docs.tables import check_table
from tests.service.proxy import read_locations

RUN_ELSEWHERE = {"evaluate paper": "tests/evaluate/paper", "demo": "tests/pipeline/test_demo.py",
                 "certify object": "tests/pipeline/certifying/test_known_volume.py",
                 "drift": "tests/pipeline/test_drift_command.py",  # of a plant that ran for four hours
                 "reload": "tests/pipeline/live/test_reload.py", "site": "tests/site/test_services.py",
                 "record": "tests/sources/genicam/test_record_command.py",
                 "commission trial_plant --step calibrate": "tests/commissioning/test_terminal.py"}  # fmt: skip
"""Commands that take minutes at any size, or cameras: parsed here, run by the tests named."""
SCENES = {"calibration", "module", "belt_empty", "belt_loaded", "belt_moving"}
"""A scene's name is rendered from ``scenes/NAME.toml``, the same scene seen by fewer cameras with fewer rocks."""


class _Keyboard(io.StringIO):
    def isatty(self) -> bool:
        return True


@dataclass(slots=True)
class Reader:
    """Follows pages in a folder; what does not hold is collected."""

    folder: Path
    results: Results
    """What commands gave before, on this page or another."""
    wrong: list[str] = field(default_factory=list)
    """One line per command or block that does not hold, with its place."""
    done: list[str] = field(default_factory=list)
    """Commands of the program that were run."""
    names: dict[str, object] = field(default_factory=dict)
    """What the page's Python blocks have defined."""
    processes: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    """The running system, where the page asks it, until the page ends."""
    address: str = ""
    """Of the running system."""
    asks: bool = False
    """Whether the page asks the running system, which then runs until the page ends."""

    def follow(self, page: str, text: str) -> None:
        """Do what the page says."""
        self.asks = "\ncurl " in text
        with self.processes:
            for block in read_blocks(page, text):
                self.do(block)
        for line, span in read_spans(text):
            self.attempt(f"{page}:{line}", lambda span=span: self._mention(span))

    def do(self, block: Block) -> None:
        """Do what a block says."""
        ways = {
            "sh": self._shell, "toml": self._toml, "python": self._python, "json": self._json, "yaml": self._yaml,
            "csv": self._csv, "nginx": self._nginx,
            "text": self._text, "indented": self._text,
        }  # fmt: skip
        way = ways.get(block.kind)
        if way is None:
            self.wrong.append(
                f"{block.place}: no rule for a block of kind {block.kind!r}; there are {[*ways]}"
            )
            return
        way(block)

    def attempt(self, place: str, what: Callable[[], None]) -> None:
        try:
            what()
        except Wrong as error:
            self.wrong.append(f"{place}: {error}")
        except Exception as error:
            self.wrong.append(f"{place}: {type(error).__name__}: {error}")

    def _nginx(self, block: Block) -> None:
        """tests/service/page/test_path_prefix.py serves belts by the block."""
        self.attempt(block.place, lambda: demand(read_locations(block.text), "no location"))

    def _shell(self, block: Block) -> None:
        for words in split_commands(block.text):
            self.attempt(f"{block.place}: {' '.join(words)}", lambda words=words: self.command(words))

    def command(self, words: Sequence[str]) -> None:
        words, target = split_redirection(words)
        out = ""
        if Path(words[0]).name == "beltscape":
            out = self._beltscape(list(words[1:]))
        elif words[0] == "curl":
            out = self._ask(words)
        else:
            run_system(words, self.folder)
        if target:
            path = self.folder / target.replace("~", "home")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(out)

    def _ask(self, words: Sequence[str]) -> str:
        """Ask the running system."""
        demand(self.address, "nothing runs that could answer")
        out = curl(words, self.address)
        demand(out, "no answer")
        return out

    def _beltscape(self, words: list[str]) -> str:
        """Return what the program prints when it is run as the page has it, but for the rules of this module."""
        if words == ["--version"]:
            demand(call(words, self.folder).code == 0, "fails")
            return ""
        unknown = unknown_options(words)
        demand(not unknown, f"no option {unknown}")
        asked = " ".join(words)
        if any(asked.startswith(name) for name in RUN_ELSEWHERE) or "--rerun" in words:
            parser_of(words[0]).parse_args(words[1:])
            return ""
        if words[0] == "commission" and len(words) == 2:  # the page: tests/commissioning/test_page.py
            demand((self.folder / words[1] / "commission.json").is_file(), "no such plant")
            return ""
        if words[0] == "run" and "--check" not in words and self.asks:
            self.address = self.processes.enter_context(run_service(self.folder / "live.toml"))
            self.done.append(asked)
            return ""
        words = self._on_small_material(words)
        keyboard = (
            patch("getpass.getpass", lambda *_: "long enough, of 5 kinds"),
            patch("sys.stdin", _Keyboard()),
        )
        with patch("webbrowser.open", lambda *_: True), keyboard[0], keyboard[1]:
            answer = self.results.obtain(words, self.folder, call)
        if words[0] == "cameras" and answer.code == 2:  # without the library or without the network's cameras
            demand("ravis" in answer.err or "camera" in answer.err, answer.err)
            return ""
        if words[:2] == ["run", "--check"] and answer.code == 2 and not find_spec("gi"):
            demand("cameras: Aravis cannot be used" in answer.err, answer.err)  # as the run would refuse
            return ""
        demand(answer.code == 0, f"exit code {answer.code}: {answer.err.strip().splitlines()[-1:]}")
        self.done.append(asked)
        return answer.out

    def _shrink_scene(self, words: list[str]) -> list[str]:
        """The command on a named scene's small form, or on the page's own scene with fewer rocks and frames."""
        if words[1] in SCENES:
            small = [word for word in words if word not in ("--size", "quarter")]
            return ["simulate", f"scenes/{words[1]}.toml", *small[2:]]
        path = self.folder / words[1]
        text = path.read_text()
        if 'kind = "belt_moving"' in text:
            path.write_text(text.replace("scale = 0.5", "scale = 1"))  # of the small demo's rig
            return [*words, "--frames", "3"]  # of eight
        few = re.sub(r"rocks = \d+", "rocks = 10", text)
        path.write_text(f"{few}\n[heap.fines]\nalong_mm = [-100, 100]\n")
        return [*words, "--size", "quarter"]

    def _on_small_material(self, words: list[str]) -> list[str]:
        """The same command, on scenes that render in seconds and with the page's project of a recorded capture."""
        small = self._shrink_scene(words) if words[0] == "simulate" else list(words)
        if words[0] == "replay" or (words[0] == "run" and "--check" not in words):
            return [word.replace("project.toml", "recorded.toml") for word in small]
        if words[0] in ("run", "users", "backup"):
            small = [word.removeprefix("/etc/beltscape/") for word in small]
        if words[0] == "backup":
            make_history(self.folder / "data")
        if words[0] == "reprocess":  # the recording that the page's project names, in this process
            small[1:] = ["moving", "--project", "recorded.toml", "--out", words[words.index("--out") + 1]]
        if words[0] == "compare":
            for name in words[1:3]:
                make_history(self.folder / name)
        if words[0] in ("certify", "explain", "budget"):
            make_tested_history(self.folder)
            write_test_file(self.folder)
        if words[:2] == ["certify", "verify"]:  # of this year
            small[2] = str(max((self.folder / "data/certificates").glob("*.html")).relative_to(self.folder))
        if words[0] == "restore":
            small[1] = find_newest(self.folder, words[1])
        return small

    def _toml(self, block: Block) -> None:
        self.attempt(block.place, lambda: check_table(block, self.folder))

    def _python(self, block: Block) -> None:
        def execute() -> None:
            code = compile(block.text, block.place, "exec")
            with contextlib.chdir(self.folder), contextlib.redirect_stdout(io.StringIO()):
                exec(code, self.names)

        self.attempt(block.place, execute)

    def _json(self, block: Block) -> None:
        """JSON lines; those of the audit log have the keys that the log writes."""

        def check() -> None:
            source = (ROOT / "src/beltscape/service/access/audit.py").read_text()
            for line in block.text.splitlines():
                for key in json.loads(line):
                    demand(
                        f'"{key}"' in source or key in ("request", "status"), f"the audit log has no {key!r}"
                    )

        self.attempt(block.place, check)

    def _yaml(self, block: Block) -> None:
        """Prometheus' configuration: it scrapes the address that the page has by default."""

        def check() -> None:
            from beltscape.service.settings import WebSettings

            jobs = yaml.safe_load(block.text)["scrape_configs"]
            web = WebSettings()
            demand(
                jobs[0]["static_configs"] == [{"targets": [f"{web.host}:{web.port}"]}],
                "scrapes another address than the page's",
            )

        self.attempt(block.place, check)

    def _csv(self, block: Block) -> None:
        """The columns of encoder.csv."""
        path = self.folder / "block.csv"
        path.write_text(block.text)
        self.attempt(block.place, lambda: demand(read_encoder(path), "holds no row"))

    def _text(self, block: Block) -> None:
        """Drawings, formulas and what the program prints: no line of it is a command."""
        for line in block.text.splitlines():
            word = (line.split() or [""])[0]
            if word == "beltscape" or word in RULES:
                self.wrong.append(f"{block.place}: a command in a block that nobody runs: {line.strip()}")

    def _mention(self, span: str) -> None:
        """A command within a sentence or a table: its options exist, its subcommands and choices, too."""
        text = span.replace("…", "")
        split = shlex.split(text) if text.count("'") % 2 == 0 else text.split()
        words = [word if "[" in word[1:] else word.strip("[]") for word in split]
        if not words or words[0] not in {"beltscape", *RULES}:
            return
        if words[0] == "beltscape":
            if len(words) > 1 and words[1] not in ("COMMAND", "--help"):
                _check_mention([word for word in words[1:] if word])
        elif len(words) > 1:
            run_system(words, self.folder)


def split_redirection(words: Sequence[str]) -> tuple[list[str], str]:
    """Return a command without its redirection, and the file that its output goes to."""
    if ">" not in words:
        return list(words), ""
    at = words.index(">")
    return list(words[:at]), words[at + 1]


def _check_mention(words: list[str]) -> None:
    """The words may be alternatives, a|b, and values may be names in capitals."""
    for first in words[0].split("|"):
        for second in words[1].split("|") if len(words) > 1 else [""]:
            chosen = [first, *([second] if second else []), *words[2:]]
            demand(first in COMMANDS, f"no command {first!r}")
            parser = narrowed(chosen) if _has_children(first) and second else parser_of(first)
            actions = parser._option_string_actions
            for option, value in zip(words, [*words[1:], ""], strict=True):
                if not option.startswith("--"):
                    continue
                demand(
                    option in {*actions, "--json", "--help"},
                    f"beltscape {first} {second}: no option {option}",
                )
                choices = actions[option].choices if option in actions else None
                if choices and re.fullmatch(r"[a-z0-9|_]+", value):
                    demand(set(value.split("|")) <= set(choices), f"{option} takes {choices}, not {value}")


def _has_children(command: str) -> bool:
    return any(isinstance(one, argparse._SubParsersAction) for one in parser_of(command)._actions)
