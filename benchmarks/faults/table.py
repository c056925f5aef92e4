"""The table of the bench as text, and benchmarks/FAULTS.md."""

from __future__ import annotations

import datetime
import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from faults.results import KeptResult
from faults.verdict import RowResult

ROOT = Path(__file__).resolve().parents[2]
HEAD = (
    "| fault | promised | noticed after | valid / degraded / missing; live flow | error of the total | verdict |",
    "|---|---|---|---|---|---|",
)

_COUNT = re.compile(r"\d+ passed, \d+ failed\.")


def format_row(verdict: RowResult) -> str:
    """Return a row of the table."""
    result = "passed" if verdict.passes else "**failed**: " + "; ".join(verdict.failures)
    cells = (verdict.name, verdict.promised, verdict.noticed, verdict.published, verdict.error, result)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def format_count(verdicts: Sequence[RowResult]) -> str:
    """Return the last line."""
    return _count([verdict.passes for verdict in verdicts])


def _count(passes: Sequence[bool]) -> str:
    return f"{sum(passes)} passed, {len(passes) - sum(passes)} failed"


def _today() -> str:
    return datetime.datetime.now(datetime.UTC).date().isoformat()


def write_table(
    path: Path,
    sections: Sequence[tuple[str, Sequence[RowResult]]],
    unplayed: Sequence[tuple[str, str]],
    description: str,
    commit: str,
) -> None:
    """Write the tables of all sections that have rows, each under what it was played on.

    ``commit`` are those at which the rows were played.
    """
    lines = [
        "# Faults",
        "",
        f"Written by `make faults` on {_today()}; played at commit {commit}. {description}",
        "",
        "Times are seconds of the recording from the fault on, and frames. Metres and the total count from the fault",
        "on, against the exact truth of the rendered heap. A row passes if the fault is named in time, no wrong",
        "record is valid after the promised time, the metres are within 1 % and the total covers the truth within",
        "2.5 σ.",
        "",
    ]
    for heading, verdicts in sections:
        if verdicts:
            lines += [f"## {heading}", "", *HEAD, *map(format_row, verdicts), ""]
    every = [verdict for _, verdicts in sections for verdict in verdicts]
    lines += [
        "## All",
        "",
        f"{format_count(every)}.",
        "",
        "Not played here:",
        "",
        *(f"- {what}: {why}." for what, why in unplayed),
        "",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")


def renew_rows(path: Path, sections: Sequence[tuple[str, Mapping[str, KeptResult]]]) -> None:
    """Replace the rows of some results, by section and name, in a table that is there; others stay as they are.

    A row that its section lacks is added to it. The first lines name what was renewed, at which commit and on which
    day. ValueError without the section: then the table has to be written as a whole.
    """
    lines = path.read_text("utf-8").splitlines()
    renewed: list[str] = []
    for heading, results in sections:
        for name, kept in results.items():
            _put_row(lines, heading, name, format_row(kept.result))
            renewed.append(f"*{name}* ({heading}) at commit {kept.commit} on {_today()}")
    if renewed:
        head = next(at for at, line in enumerate(lines) if line.startswith("Written by"))
        lines[head] += f" Renewed since: {', '.join(renewed)}."
    verdicts = [line for line in lines if line.endswith("| passed |") or "| **failed**: " in line]
    at = next(at for at, line in enumerate(lines) if _COUNT.fullmatch(line))
    lines[at] = f"{_count([line.endswith('| passed |') for line in verdicts])}."
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _put_row(lines: list[str], heading: str, name: str, row: str) -> None:
    """Put a row into its section: in the place of the one of its name, else at the end."""
    if f"## {heading}" not in lines:
        raise ValueError(f"FAULTS.md has no section {heading!r}; write it as a whole with --write")
    first = lines.index(f"## {heading}") + 1
    end = next((at for at in range(first, len(lines)) if lines[at].startswith("## ")), len(lines))
    rows = [at for at in range(first, end) if lines[at].startswith("| ")]
    found = next((at for at in rows if lines[at].startswith(f"| {name} |")), None)
    if found is None:
        lines.insert(rows[-1] + 1, row)
    else:
        lines[found] = row


def read_commit() -> str:
    """Return the checked-out commit, with ``+`` where files differ from it."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else ""

    changed = git("status", "--porcelain", "--", "src", "native", "benchmarks", ":!benchmarks/FAULTS.md")
    return (git("rev-parse", "--short=9", "HEAD") or "unknown") + ("+" if changed else "")
