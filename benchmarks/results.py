"""RESULTS.md: sections that each state the commit at which they were measured, and how far it is behind.

Only `benchmarks/run.py` writes the file. A section that a run does not measure stays as it is, with its own commit.
"""

from __future__ import annotations

import datetime
import os
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_STAMP = re.compile(
    r"^\*Measured at commit (\S+) on (\S+) by the kernels (\S+), load average before (\S+)\.(?:.*)\*$"
)


@dataclass(frozen=True, slots=True)
class Section:
    """One section of RESULTS.md."""

    title: str
    lines: tuple[str, ...]
    commit: str
    """Short hash; with ``+`` where the tree had uncommitted changes."""
    date: str
    level: str
    """Instruction-set level of the kernels."""
    load: str
    """Load average over a minute before the section was measured."""


def make_section(title: str, lines: Sequence[str], level: str, load: float) -> Section:
    """Return a section that was measured at the current commit by the kernels of a level."""
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    return Section(title, tuple(_trim(lines)), current_commit(), today, level, f"{load:.1f}")


def current_commit() -> str:
    """Return the short hash of the checked-out commit, with ``+`` where files differ from it."""
    changed = _git("status", "--porcelain", "--", "src", "native", "benchmarks", ":!benchmarks/RESULTS.md")
    return (_git("rev-parse", "--short=9", "HEAD") or "unknown") + ("+" if changed else "")


def read_results(path: Path) -> list[Section]:
    """Return the sections of a RESULTS.md that carry a commit; none without the file."""
    if not path.is_file():
        return []
    sections = []
    for part in re.split(r"(?m)^## ", path.read_text(encoding="utf-8"))[1:]:
        title, *lines = part.splitlines()
        stamp = next((match for line in lines if (match := _STAMP.match(line))), None)
        if stamp is not None:
            rest = [line for line in lines if not _STAMP.match(line)]
            sections.append(Section(title.strip(), tuple(_trim(rest)), *stamp.groups()))
    return sections


def write_results(path: Path, head: str, sections: Sequence[Section], order: Sequence[str]) -> None:
    """Write the newest of each section in ``order``; those of an older commit state how far behind they are."""
    newest = {section.title: section for section in [*read_results(path), *sections]}
    lines = ["# Results", "", head, ""]
    for title in order:
        if title in newest:
            lines += [f"## {title}", "", _stamp(newest[title]), "", *newest[title].lines, ""]
    path.write_text("\n".join(lines), encoding="utf-8")


def _stamp(section: Section) -> str:
    behind = _git("rev-list", "--count", f"{section.commit.rstrip('+')}..HEAD")
    older = (
        f" {behind} commits before the state that this file was written at."
        if behind not in ("", "0")
        else ""
    )
    how = f"by the kernels {section.level}, load average before {section.load}"
    return f"*Measured at commit {section.commit} on {section.date} {how}.{older}*"


def _trim(lines: Sequence[str]) -> list[str]:
    text = "\n".join(lines).strip("\n")
    return text.split("\n") if text else []


def _git(*arguments: str) -> str:
    """Return git's output; empty without a repository or such a commit."""
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""


def load_average() -> float:
    """Return the load average over the last minute."""
    return os.getloadavg()[0]
