"""The verdict on a row: what was noticed when, what was published meanwhile, and whether the truth is covered."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from faults.capture import FRAMES_PER_S, RoundCapture
from faults.feed import find_end, find_shown_frame
from faults.player import Played
from faults.truth import Comparison, Selection, compare

_LENGTH_ERROR = 0.01
"""Largest error of the counted metres that is called right."""
_SIGMAS = 2.5
"""Number of σ within which a trend must agree with the truth, as the totals."""
_ALL = ("valid", "degraded", "missing")


@dataclass(frozen=True)
class RowResult:
    """The result of a row."""

    name: str
    promised: str
    noticed: str
    published: str
    error: str
    failures: tuple[str, ...]
    """Why the row fails; empty: it passes."""

    @property
    def passes(self) -> bool:
        """Return whether the row passes."""
        return not self.failures


def assess(capture: RoundCapture, played: Played) -> RowResult:
    """Return the verdict on a row."""
    case, records = played.case, [record for _, record in played.records]
    if played.refusal:
        failures = () if case.replaced else ("the system did not start",)
        return RowResult(
            case.name, case.promised, f"refused: {played.refusal.partition(': ')[2]}", "nothing", "", failures
        )
    if not records:
        return RowResult(case.name, case.promised, "", "no record", "", ("no record was published",))
    numbers = np.array([-1 if r.strip is None else int(r.strip.frame) for r in records])
    numbers = np.maximum.accumulate(numbers)
    before = numbers < played.onset
    sound = int(before.sum())
    if case.is_wrong_from_start:  # the ledger is wrong from the start: only its place is fitted
        before, sound = np.zeros(len(records), bool), len(records)
    comparison = compare(capture, records, sound, partial(find_shown_frame, capture, case, played.onset))
    since = ~before
    late = since & (numbers >= played.onset + math.ceil(case.within_s * FRAMES_PER_S))
    end = find_end(case.faults, played.onset)
    wrong = late if end is None else late & (numbers < end)
    noticed, is_in_time = _describe_notice(played)
    total = comparison.select(("valid", "degraded"), since.tolist())
    failures = [] if is_in_time else ["not named in time"]
    failures += _check_records(played, comparison, since, late, wrong)
    failures += _check_trends(played)
    if played.unstored:
        failures.append(f"{played.unstored} records not stored")
    if not total.covers_truth():
        failures.append("total beyond 2.5 σ")
    return RowResult(
        case.name, case.promised, noticed, _describe_published(played, comparison, since), _describe(total),
        tuple(failures),
    )  # fmt: skip


def _check_records(
    played: Played, comparison: Comparison, since: np.ndarray, late: np.ndarray, wrong: np.ndarray
) -> list[str]:
    """Return what is wrong about the records since the fault.

    ``late`` are those after the promised time, ``wrong`` those of them before the fault ends, if it does.
    """
    failures: list[str] = []
    length_mm = comparison.select(("valid",), wrong.tolist()).length_mm
    if not played.case.allows_valid and length_mm > 0:
        failures.append(f"{length_mm / 1000:.2f} m valid after the promised time")
    valid = comparison.select(("valid",), late.tolist())
    if not valid.covers_truth():
        failures.append(f"valid records wrong by {100 * valid.relative_error:+.1f} %")
    everything = comparison.select(_ALL, since.tolist())
    if abs(everything.length_mm - everything.true_mm) > _LENGTH_ERROR * everything.true_mm:
        failures.append(f"{everything.length_mm / 1000:.2f} m counted of {everything.true_mm / 1000:.2f} m")
    missing = comparison.select(("missing",), since.tolist())
    if missing.volume_mm3 != 0:
        failures.append("missing records hold volume")
    return failures


def _check_trends(played: Played) -> list[str]:
    """Return the checks whose last value is not the true one within 2.5 σ."""
    failures: list[str] = []
    for name, truth in played.case.trends.items():
        value, sigma = played.values.get(name, (math.nan, math.nan))
        if not abs(value - truth) <= _SIGMAS * sigma:
            failures.append(f"{name} is {value:.4g} ± {sigma:.2g}, in truth {truth:.4g}")
    return failures


def _describe_trends(played: Played) -> str:
    """Return the last values of the checks whose truth is known."""
    parts = [
        f"; {name} {played.values[name][0]:.4f} ± {played.values[name][1]:.4f}"
        for name in played.case.trends
        if name in played.values
    ]
    return "".join(parts)


def _describe_notice(played: Played) -> tuple[str, bool]:
    """Return when the fault was noticed and by what, and whether a name of it came in time."""
    case = played.case
    found = [(at, name, "finding") for name, (at, _) in played.findings.items()]
    found += [(at, name, "alarm") for name, at in played.alarms.items()]
    if case.is_sound:
        stands = {"belt_stopped"} if case.rests_s else set[str]()
        accused = [
            f"{name} after {at:.1f} s"
            for at, name, _ in sorted(found)
            if _is_fault_alarm(name) and name not in stands
        ]
        return "; ".join(accused) or "nothing", not accused
    found = sorted(one for one in found if one[0] >= played.onset_s)
    named = [one for one in found if case.is_named_by(one[1])]
    parts = []
    for kind in ("finding", "alarm"):
        first = next((one for one in named if one[2] == kind), None)
        if first is not None:
            after = first[0] - played.onset_s
            parts.append(f"{after:.1f} s ({round(after * FRAMES_PER_S)} frames): {kind} {first[1]}")
    others = sorted({_shorten(name) for _, name, _ in found if not case.is_named_by(name)})
    text = ("; ".join(parts) or "not named") + _describe_trends(played)
    if others:
        text += f" (also {', '.join(others)})"
    is_in_time = bool(named) and named[0][0] - played.onset_s <= case.within_s
    return text, is_in_time


def _shorten(name: str) -> str:
    """Return the name of a check; with the camera where it accuses its pose, since that may be the wrong one."""
    return name if name.startswith("camera_pose:") else name.split(":", maxsplit=1)[0]


def _is_fault_alarm(name: str) -> bool:
    """Return whether an alarm accuses the system; an empty belt between two heaps is none."""
    return name.split(":", maxsplit=1)[0] not in (
        "empty",
        "overload",
        "oversize_lump",
        "certificate_expiring",
    )


def _describe_published(played: Played, comparison: Comparison, since: np.ndarray) -> str:
    lengths = [comparison.select((one,), since.tolist()).length_mm / 1000 for one in _ALL]
    flows = np.array([flow for at, flow in played.flow_m3_h if at >= played.onset_s])
    known = flows[np.isfinite(flows)]
    live = f"{known.min():.1f} to {known.max():.1f} m³/h" if len(known) else "none"
    unknown = f", – in {np.mean(~np.isfinite(flows)):.0%}" if len(flows) and len(known) < len(flows) else ""
    return f"{lengths[0]:.2f} / {lengths[1]:.2f} / {lengths[2]:.2f} m; live {live}{unknown}"


def _describe(total: Selection) -> str:
    litres = (total.volume_mm3 - total.true_mm3) * 1e-6
    times = abs(litres) * 1e6 / total.sigma_mm3 if total.sigma_mm3 > 0 else math.inf if litres else 0.0
    # where next to nothing passed, a share of it says nothing
    share = f" ({100 * total.relative_error:+.1f} %)" if abs(total.relative_error) <= 1 else ""
    return f"{litres:+.2f} l{share}, {times:.1f} σ"
