"""A camera's clock, told by the host's: learned from the arrival of its images."""

from __future__ import annotations

from collections import deque

import numpy as np

BIN_NS = 1_000_000_000
"""Of each second of camera time only the promptest image counts: what holds packets up only ever adds."""
KEPT = 60
"""Seconds that are remembered."""
FIRST = 5
"""Images whose delays must agree until the clock is used."""
AMONG = 20
"""Images of which these may be; older ones are forgotten."""
LINE_FROM = 6
"""Seconds known until the drift is told from them."""
UNSURE_PPM = 20.0
"""How far the drift may be wrong: what a pause adds to the offset's error."""
DRIFT_PPM = 300.0
"""No quartz is farther off."""
LATE_NS = 2_000_000_000
"""An image that seems to come so late says that a clock was set."""
OUTLIERS = 3
"""Images in a row that must say so."""


class CameraClock:
    """Offset and drift of one camera's clock.

    The host sees an image's first packet some time after the camera's timestamp. The least of those delays in
    each second lie on a line over camera time: its slope (median over all pairs of seconds: Theil 1950, Sen 1968,
    doi:10.1080/01621459.1968.10480934) is the drift, and the median above it the offset. The constant part of the
    delay stays in the offset; cameras of one kind have it in common.
    """

    def __init__(self, tight_ns: int, unsure_ppm: float = UNSURE_PPM) -> None:
        """``tight_ns``: delays that agree to this are believed; a tenth of the frames' period.

        Images that were held up and come all at once differ by whole periods: they never agree. After a pause in
        which an error of ``unsure_ppm`` would add up to ``tight_ns``, all is learned anew.
        """
        self._tight_ns = tight_ns
        self._longest_ns = tight_ns / (unsure_ppm * 1e-6) if unsure_ppm else float("inf")
        self._clear()

    def _clear(self) -> None:
        self._outliers = 0
        self._first: deque[tuple[int, int]] = deque(maxlen=AMONG)  # camera time, arrival − camera time
        self._bins: deque[tuple[int, int]] = deque(maxlen=KEPT)  # the same, one a second
        self._base_ns = 0
        self._base_delay_ns = 0
        self._offset_ns = 0.0
        self._drift = 0.0

    @property
    def is_settled(self) -> bool:
        """Whether it knows enough to be used."""
        return bool(self._bins)

    @property
    def drift_ppm(self) -> float:
        """How much the host's clock is faster, in parts per million."""
        return self._drift * 1e6

    def host_ns(self, camera_ns: int) -> int:
        """Host time of a camera's time."""
        since_ns = camera_ns - self._base_ns
        return camera_ns + self._base_delay_ns + round(self._offset_ns + self._drift * since_ns)

    def add(self, camera_ns: int, arrival_ns: int) -> bool:
        """An image with that camera time came at that host time; whether ``host_ns`` may be asked about it."""
        delay_ns = arrival_ns - camera_ns
        if self._bins and camera_ns - self._bins[-1][0] > self._longest_ns:
            self._clear()
        if not self.is_settled:
            return self._settle(camera_ns, delay_ns)
        # an image cannot come before it is taken; while little is known, the offset may still be too great
        early_ns = LATE_NS if len(self._bins) < LINE_FROM else 4 * self._tight_ns
        if not -early_ns < arrival_ns - self.host_ns(camera_ns) < LATE_NS:
            self._outliers += 1
            if self._outliers >= OUTLIERS:
                self._clear()
            return False
        self._outliers = 0
        self._keep(camera_ns, delay_ns)
        return True

    def _settle(self, camera_ns: int, delay_ns: int) -> bool:
        self._first.append((camera_ns, delay_ns))
        least = min(delay for _, delay in self._first)
        if sum(delay - least < self._tight_ns for _, delay in self._first) < FIRST:
            return False
        for time, delay in sorted(self._first):
            self._keep(time, delay)
        return False  # from the next image on: the other cameras may be as far by then

    def _keep(self, camera_ns: int, delay_ns: int) -> None:
        if self._bins and camera_ns // BIN_NS == self._bins[-1][0] // BIN_NS:
            if delay_ns >= self._bins[-1][1]:
                return
            self._bins[-1] = camera_ns, delay_ns
        else:
            self._bins.append((camera_ns, delay_ns))
        self._fit()

    def _fit(self) -> None:
        # the base is an exact integer: a float has no room for ns since 1970
        self._base_ns, self._base_delay_ns = self._bins[-1]
        time = np.array([t - self._base_ns for t, _ in self._bins], np.float64)
        delay = np.array([d - self._base_delay_ns for _, d in self._bins], np.float64)
        above = delay - self._drift * time
        prompt = above <= above.min() + self._tight_ns  # a busy host has whole seconds without a prompt image
        time, delay = time[prompt], delay[prompt]
        if len(time) < LINE_FROM:
            self._drift, self._offset_ns = 0.0, float(delay.min())
            return
        i, j = np.triu_indices(len(time), 1)
        slope = float(np.median((delay[j] - delay[i]) / (time[j] - time[i])))
        self._drift = float(np.clip(slope, -DRIFT_PPM * 1e-6, DRIFT_PPM * 1e-6))
        self._offset_ns = float(np.median(delay - self._drift * time))
