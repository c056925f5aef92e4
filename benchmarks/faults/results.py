"""The results of rows, kept beside the capture: a table may be played in several parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from beltscape.files.json_text import read_json, write_json
from faults.verdict import RowResult


@dataclass(frozen=True)
class KeptResult:
    """The last result of a row."""

    result: RowResult
    commit: str
    """At which it was played."""


def keep_result(folder: Path, result: RowResult, commit: str) -> None:
    """Add the result of a row to those kept in the folder of a capture, instead of an older one."""
    kept = {**read_results(folder), result.name: KeptResult(result, commit)}
    write_json(folder / "results.json", {name: asdict(one) for name, one in kept.items()})


def read_results(folder: Path) -> dict[str, KeptResult]:
    """Return the kept results by the rows' names; empty without any."""
    path = folder / "results.json"
    if not path.is_file():
        return {}
    return {
        name: KeptResult(
            RowResult(**(one["result"] | {"failures": tuple(one["result"]["failures"])})), one["commit"]
        )
        for name, one in read_json(path).items()
    }


def describe_commits(kept: Iterable[KeptResult]) -> str:
    """Return the commits of the rows, the most frequent first."""
    counts = Counter(one.commit for one in kept).most_common()
    return ", ".join(f"{commit} ({count} rows)" for commit, count in counts)
