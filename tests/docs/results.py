"""Results of commands by the bytes that they read: what a page has done, another page need not compute again.

The commands in `PURE` depend on nothing but their words and the files that these name, so a result holds for the same
bytes under any name. Every worker finds the results of all others.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

from tests.docs.program import Answer
from tests.once import hold_lock

WITH_SUBCOMMANDS = {"measure", "target", "evaluate"}
LISTENING = "run"
"""The command that listens at the manual's ports, the same on all its pages: one at a time over all workers."""
PURE = {"calibrate", "check", "rectify", "reconstruct", "simulate", "plan", "view"} | WITH_SUBCOMMANDS


@dataclass(frozen=True, slots=True)
class Results:
    """A folder of results, shared by all workers of a test run."""

    folder: Path

    def obtain(self, words: Sequence[str], at: Path, call: Callable[[Sequence[str], Path], Answer]) -> Answer:
        """Return the answer of a command run in the folder ``at``, whose output is there afterwards."""
        self.folder.mkdir(exist_ok=True)
        if words[0] == LISTENING:
            with hold_lock(self.folder / "ports.lock"):
                return call(words, at)
        if words[0] not in PURE:
            return call(words, at)
        kept = self.folder / digest_command(words, at)
        out = at / words[words.index("--out") + 1] if "--out" in words else None
        with hold_lock(kept.with_suffix(".lock")):
            if (kept / "answer.json").is_file():
                if out is not None:
                    replace(kept / "out", out)
                return Answer(**json.loads((kept / "answer.json").read_text()))
            answer = call(words, at)
            if answer.code == 0:
                kept.mkdir(exist_ok=True)
                if out is not None:
                    replace(out, kept / "out")
                (kept / "answer.json").write_text(json.dumps(asdict(answer)))
        return answer


def replace(source: Path, target: Path) -> None:
    """Copy a file or folder over what may be there."""
    if target.is_dir():
        shutil.rmtree(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)


def digest_command(words: Sequence[str], at: Path) -> str:
    """Return the digest of a command with the bytes of all that it names in place of the names."""
    names = 2 if words[0] in WITH_SUBCOMMANDS else 1
    parts = list(words[:names])
    for before, word in pairwise(words[names - 1 :]):
        if before == "--out":
            parts.append(Path(word).suffix)
        elif (at / word).exists():
            top, *rest = Path(word).parts
            parts.append("/".join([digest_path(at / top), *rest]))
        else:
            parts.append(word)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def digest_path(path: Path) -> str:
    """Return the digest of a file, with the files that a TOML file names, or of all files of a folder."""
    total = hashlib.sha256()
    for one in sorted(path.rglob("*")) if path.is_dir() else [path, *named_in(path)]:
        if one.is_file():
            total.update(str(one.relative_to(path) if path.is_dir() else one.suffix).encode())
            total.update(hashlib.sha256(one.read_bytes()).digest())
    return total.hexdigest()


def named_in(path: Path) -> Iterator[Path]:
    """Yield the files that a TOML file names."""
    if path.suffix == ".toml":
        names = re.findall(r'"([^"\n]+)"', path.read_text())
        yield from (path.parent / name for name in names if (path.parent / name).is_file())
