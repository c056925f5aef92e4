"""Every fault in front of the running system, against exact truth; writes benchmarks/FAULTS.md.

    cd benchmarks && python -m faults [--short] [--only TEXT ...] [--seed 21] [--cache DIR] [--minutes M]

The capture is rendered once into the cache (default: out/bench-faults; minutes). The exit code is 1 if any row fails.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from beltscape.core.progress import Silent
from faults.capture import LONG, SHORT, RoundCapture, open_capture
from faults.case import Case
from faults.cases import read_cases, read_not_played
from faults.matching import Cache
from faults.player import play
from faults.table import HEAD, ROOT, format_count, format_row, write_table
from faults.verdict import Verdict, assess


def main() -> int:
    """Play the chosen rows, print the table and write it."""
    arguments = _parse()
    sizes = SHORT if arguments.short else LONG
    capture = open_capture(arguments.cache, sizes, arguments.seed, Silent())
    chosen = [case for case in read_cases() if _is_chosen(case, arguments)]
    print("\n".join(HEAD), flush=True)
    verdicts: list[Verdict] = []
    cache: Cache = {}
    began = time.monotonic()
    for case in chosen:
        if arguments.minutes is not None and time.monotonic() - began > 60 * arguments.minutes:
            break
        verdicts.append(_play(capture, case, cache))
        print(format_row(verdicts[-1]), flush=True)
    left = [(case.name, "the time was over") for case in chosen[len(verdicts) :]]
    if not arguments.short and (not arguments.only or arguments.write):
        width, height = capture.rig.core_camera.size_px
        description = (
            f"Capture: {len(capture.rig.cameras)} cameras of {width}×{height} px, preset fast, seed "
            f"{arguments.seed}, {capture.step_mm:.1f} mm a frame at 8 frames/s, three rounds of {capture.frames} "
            "frames before the fault."
        )
        write_table(ROOT / "benchmarks" / "FAULTS.md", verdicts, [*read_not_played(), *left], description)
    print(format_count(verdicts))
    return int(any(not verdict.passes for verdict in verdicts))


def _play(capture: RoundCapture, case: Case, cache: Cache) -> Verdict:
    """Play a row; its depth maps are kept only where the images are those of the sound plant."""
    own: Cache = dict(cache)
    verdict = assess(capture, play(capture, case, own))
    if case.is_sound or set(case.faults) == {"encoder"}:
        cache.update(own)
    return verdict


def _is_chosen(case: Case, arguments: argparse.Namespace) -> bool:
    if arguments.short and not case.is_short:
        return False
    return not arguments.only or any(text in case.name for text in arguments.only)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--short", action="store_true", help="a handful of rows on small images")
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="rows whose name contains one of these")
    parser.add_argument("--write", action="store_true", help="write FAULTS.md also with --only")
    parser.add_argument("--seed", type=int, default=21, help="of plant and heap")
    parser.add_argument("--minutes", type=float, help="begin no row after this time")
    parser.add_argument(
        "--cache", type=Path, default=ROOT / "out" / "bench-faults", help="of rendered captures"
    )
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
