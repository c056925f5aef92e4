"""Every fault in front of the running system, against exact truth; writes benchmarks/FAULTS.md.

    cd benchmarks && python -m faults [--short|--small] [--only TEXT ...] [--seed 31] [--cache DIR] [--minutes M]
        [--rounds R] [--jobs N] [--write | --renew] [--rendered FOLDER]

The capture is rendered once into the cache (default: out/bench-faults; minutes). With --rendered the moving belt in a
folder of captures of another renderer is played, in all rows that need no rendering. FAULTS.md is written from the
results that the cache keeps; --renew replaces the chosen rows in it alone, for which the cache needs no others. The
exit code is 1 if any row fails.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from beltscape.core.progress import Silent
from faults.capture import FRAMES_PER_S, LONG, SHORT, RoundCapture, open_capture
from faults.case import Case
from faults.cases import read_cases, read_not_played
from faults.imported_round import IMPORTED, import_round, is_playable
from faults.player import SOUND_ROUNDS
from faults.results import KeptResult, describe_commits, keep_result, read_results
from faults.rows import play_rows
from faults.table import HEAD, ROOT, format_count, format_row, read_commit, renew_rows, write_table
from faults.verdict import RowResult

FAULTS = ROOT / "benchmarks" / "FAULTS.md"


def main() -> int:
    """Play the chosen rows, print the table and write it."""
    arguments, commit = _parse(), read_commit()
    cases = [_shorten(case, arguments.rounds) for case in read_cases()]
    chosen = [case for case in cases if _is_chosen(case, arguments)]
    captures = _open_captures(arguments, {None, *(case.belt_width_mm for case in chosen)})
    capture = captures[None]
    print("\n".join(HEAD), flush=True)
    verdicts: list[RowResult] = []
    for verdict in play_rows(captures, chosen, jobs=arguments.jobs, minutes=arguments.minutes):
        verdicts.append(verdict)
        keep_result(capture.folder, verdict, commit)
        print(format_row(verdict), flush=True)
    if arguments.renew:
        renew_rows(FAULTS, _read_kept(arguments, {case.name for case in chosen}))
    elif arguments.write or not (arguments.short or arguments.only or arguments.rendered):
        _write(arguments, chosen or cases)
    print(format_count(verdicts))
    return int(any(not verdict.passes for verdict in verdicts))


def _open_captures(
    arguments: argparse.Namespace, widths_mm: set[float | None]
) -> dict[float | None, RoundCapture]:
    """Return the captures of belts of these widths; None is the width of most rows."""
    if arguments.rendered is not None:
        return {None: import_round(arguments.rendered, arguments.cache, Silent())}
    sizes = SHORT if arguments.short or arguments.small else LONG
    return {
        width: open_capture(arguments.cache, sizes, arguments.seed, Silent(), width)
        for width in sorted(widths_mm, key=lambda width: width or 0.0)
    }


def _shorten(case: Case, rounds: float | None) -> Case:
    """Return the row with at most this number of rounds after the fault (None: its own), unless it needs more."""
    own = case.rounds if rounds is None else min(case.rounds, rounds)
    return replace(case, rounds=max(own, case.least_rounds))


def _write(arguments: argparse.Namespace, chosen: Sequence[Case]) -> None:
    """Write the table of all rows whose results are kept, on large images, else on small ones."""
    cases = read_cases()
    kept = _read_kept(arguments, {case.name for case in cases})
    own = {name for _, results in kept[:2] for name in results}
    left = [(case.name, "not run") for case in cases if case.name not in own]
    write_table(
        FAULTS,
        [(what, [one[case.name].result for case in cases if case.name in one]) for what, one in kept],
        [*read_not_played(), *left],
        " ".join([_describe(arguments, chosen), arguments.note]).strip(),
        describe_commits([result for _, results in kept for result in results.values()]),
    )


def _read_kept(arguments: argparse.Namespace, names: set[str]) -> list[tuple[str, dict[str, KeptResult]]]:
    """Return the kept results of some rows by the table's sections; on small images where there are no others."""
    long, short, imported = (
        {name: one for name, one in read_results(arguments.cache / folder).items() if name in names}
        for folder in (f"{LONG.name}-{arguments.seed}", f"{SHORT.name}-{arguments.seed}", IMPORTED)
    )
    short = {name: one for name, one in short.items() if name not in long}
    return [
        ("Rows on images of 612×512 px", long),
        ("Rows on images of 306×256 px only", short),
        ("Rows on the moving belt of another renderer, 612×512 px, 1.6 m/s", imported),
    ]


def _describe(arguments: argparse.Namespace, chosen: Sequence[Case]) -> str:
    most = max((case.rounds for case in chosen), default=0)
    return (
        f"Own captures: 5 cameras, preset fast, seed {arguments.seed}, rounds of {LONG.frames} frames (small: "
        f"{SHORT.frames}) at {FRAMES_PER_S:g} frames/s; {SOUND_ROUNDS} rounds before the fault, "
        f"at most {most:g} after it."
    )


def _is_chosen(case: Case, arguments: argparse.Namespace) -> bool:
    if arguments.short and not case.is_short:
        return False
    if case.needs_full_size and (arguments.short or arguments.small):
        return False
    if arguments.rendered is not None and not is_playable(case):
        return False
    return not arguments.only or any(text in case.name for text in arguments.only)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--short", action="store_true", help="a handful of rows on small images")
    parser.add_argument("--small", action="store_true", help="every row on small images")
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="rows whose name contains one of these")
    table = parser.add_mutually_exclusive_group()
    table.add_argument("--write", action="store_true", help="write FAULTS.md also with --only")
    table.add_argument("--renew", action="store_true", help="replace the chosen rows of FAULTS.md alone")
    parser.add_argument("--note", default="", help="what the table states about the machine")
    parser.add_argument("--seed", type=int, default=31, help="of plant and heap")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no row after this time")
    parser.add_argument("--rounds", type=float, help="play at most this number of rounds after the fault")
    parser.add_argument("--rendered", type=Path, help="folder with captures of another renderer")
    parser.add_argument("--jobs", type=int, default=1, help="rows at the same time")
    parser.add_argument(
        "--cache", type=Path, default=ROOT / "out" / "bench-faults", help="of rendered captures"
    )
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
