"""Every fault in front of the running system, against exact truth; writes benchmarks/FAULTS.md.

    cd benchmarks && python -m faults [--short|--small] [--only TEXT ...] [--seed 31] [--cache DIR] [--minutes M]
        [--rounds R] [--jobs N] [--write]

The capture is rendered once into the cache (default: out/bench-faults; minutes). The exit code is 1 if any row fails.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from beltscape.core.progress import Silent
from faults.capture import FRAMES_PER_S, LONG, SHORT, RoundCapture, open_capture
from faults.case import Case
from faults.cases import read_cases, read_not_played
from faults.player import SOUND_ROUNDS
from faults.results import describe_commits, keep_result, read_results
from faults.rows import play_rows
from faults.table import HEAD, ROOT, format_count, format_row, read_commit, write_table
from faults.verdict import RowResult


def main() -> int:
    """Play the chosen rows, print the table and write it."""
    arguments, commit = _parse(), read_commit()
    sizes = SHORT if arguments.short or arguments.small else LONG
    open_any = partial(open_capture, arguments.cache, sizes, arguments.seed, Silent())
    capture = open_any(None)
    cases = [_shorten(case, arguments.rounds) for case in read_cases()]
    chosen = [case for case in cases if _is_chosen(case, arguments)]
    print("\n".join(HEAD), flush=True)
    verdicts: list[RowResult] = []
    widths = {case.belt_width_mm for case in chosen}
    captures = {width: open_any(width) for width in sorted(widths, key=lambda width: width or 0.0)}
    for verdict in play_rows(captures, chosen, jobs=arguments.jobs, minutes=arguments.minutes):
        verdicts.append(verdict)
        keep_result(capture.folder, verdict, commit)
        print(format_row(verdict), flush=True)
    if arguments.write or not (arguments.short or arguments.only):
        _write(capture, chosen or cases, arguments.note)
    print(format_count(verdicts))
    return int(any(not verdict.passes for verdict in verdicts))


def _shorten(case: Case, rounds: float | None) -> Case:
    """Return the row with at most this number of rounds after the fault (None: its own), unless it needs more."""
    own = case.rounds if rounds is None else min(case.rounds, rounds)
    return replace(case, rounds=max(own, case.least_rounds))


def _write(capture: RoundCapture, chosen: Sequence[Case], note: str) -> None:
    """Write the table of all rows whose results are kept for this capture."""
    kept, cases = read_results(capture.folder), read_cases()
    small = (
        read_results(capture.folder.parent / f"{SHORT.name}-{capture.seed}") if capture.sizes == LONG else {}
    )
    small = {name: one for name, one in small.items() if name not in kept}
    played = {**kept, **small}
    left = [(case.name, _explain_absence(case, capture)) for case in cases if case.name not in played]
    write_table(
        ROOT / "benchmarks" / "FAULTS.md",
        [kept[case.name].result for case in cases if case.name in kept],
        [small[case.name].result for case in cases if case.name in small],
        [*read_not_played(), *left],
        " ".join([_describe(capture, chosen), note]).strip(),
        describe_commits(played),
    )


def _explain_absence(case: Case, capture: RoundCapture) -> str:
    is_small = case.needs_full_size and capture.sizes == SHORT
    return "its images are too small to resolve the projected dots" if is_small else "not run"


def _describe(capture: RoundCapture, chosen: Sequence[Case]) -> str:
    width, height = capture.rig.core_camera.size_px
    most = max((case.rounds for case in chosen), default=0)
    return (
        f"Capture: {len(capture.rig.cameras)} cameras of {width}×{height} px, preset fast, seed {capture.seed}, "
        f"{capture.step_mm:.1f} mm a frame at {FRAMES_PER_S:g} frames/s; {SOUND_ROUNDS} rounds of "
        f"{capture.frames} frames before the fault, at most {most:g} after it."
    )


def _is_chosen(case: Case, arguments: argparse.Namespace) -> bool:
    if arguments.short and not case.is_short:
        return False
    if case.needs_full_size and (arguments.short or arguments.small):
        return False
    return not arguments.only or any(text in case.name for text in arguments.only)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--short", action="store_true", help="a handful of rows on small images")
    parser.add_argument("--small", action="store_true", help="every row on small images")
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="rows whose name contains one of these")
    parser.add_argument("--write", action="store_true", help="write FAULTS.md also with --only")
    parser.add_argument("--note", default="", help="what the table states about the machine")
    parser.add_argument("--seed", type=int, default=31, help="of plant and heap")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no row after this time")
    parser.add_argument("--rounds", type=float, help="play at most this number of rounds after the fault")
    parser.add_argument("--jobs", type=int, default=1, help="rows at the same time")
    parser.add_argument(
        "--cache", type=Path, default=ROOT / "out" / "bench-faults", help="of rendered captures"
    )
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
