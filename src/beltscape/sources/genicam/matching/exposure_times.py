"""The exposure time of every image, from the instants at which the cameras took new ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class _Change:
    before_us: float
    present_us: float
    from_ns: int
    """Images that arrived before have the exposure time before."""
    until_ns: int
    """Images that arrive from here on have the present one."""


class ExposureTimes:
    """The exposure times of the cameras by the arrival of their images; the caller locks."""

    def __init__(self, exposures_us: Mapping[str, float], period_ns: int, *, is_triggered: bool) -> None:
        """``is_triggered``: new exposure times are set between two software triggers, ``period_ns`` apart."""
        self._period_ns, self._is_triggered = period_ns, is_triggered
        self._changes = {name: _Change(us, us, 0, 0) for name, us in exposures_us.items()}

    def set_present(self, camera: str, exposure_us: float, at_ns: int) -> None:
        """Account for a new exposure time that the camera took at an instant of the monotonic clock."""
        before = self._changes[camera].present_us
        first_ns = at_ns + round(500 * exposure_us) if self._is_triggered else at_ns
        settling_ns = (
            0 if self._is_triggered else 2 * self._period_ns + round(1000 * max(before, exposure_us))
        )
        self._changes[camera] = _Change(before, exposure_us, first_ns, first_ns + settling_ns)

    def find(self, camera: str, arrival_ns: int) -> float:
        """Return the exposure time of an image in µs; NaN while the camera may have used either."""
        change = self._changes[camera]
        if arrival_ns < change.from_ns:
            return change.before_us
        return change.present_us if arrival_ns >= change.until_ns else float("nan")
