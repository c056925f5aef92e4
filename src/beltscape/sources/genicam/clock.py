"""Offset and drift of a camera's clock against the host's, estimated from the arrival of its images."""

from __future__ import annotations

from collections import deque

import numpy as np

BIN_NS = 1_000_000_000
"""In each second of camera time only the image with the least delay is used: the network only adds delay."""
KEPT = 60
"""Number of seconds that are kept; the temperature that changes a quartz's drift changes more slowly."""
FIRST = 5
"""Number of images whose delays must agree before the clock is used: an accidental delay differs. Chosen."""
AMONG = 20
"""Number of the latest images among which these must be."""
LINE_FROM = 6
"""Number of seconds from which the drift is estimated; over fewer, delays of 0.1 ms would make 20 ppm and more."""
UNSURE_PPM = 20.0
"""Error of the drift, which adds to the offset's error during a pause: that of a fit over `LINE_FROM` seconds."""
DRIFT_PPM = 300.0
"""Largest drift of a quartz clock; data sheets of cameras state 20 to 100."""
LATE_NS = 2_000_000_000
"""An image with a larger delay indicates that a clock was set."""
OUTLIERS = 3
"""Number of consecutive images that must indicate it."""


class CameraClock:
    """Offset and drift of one camera's clock.

    The host receives an image's first packet some time after the camera's timestamp. The least delays of each second
    lie on a line over camera time: its slope (median over all pairs of seconds: Theil 1950, Sen 1968,
    doi:10.1080/01621459.1968.10480934) is the drift, the median residual the offset. The constant part of the delay
    remains in the offset; cameras of one kind have it in common.
    """

    def __init__(self, tight_ns: int, unsure_ppm: float = UNSURE_PPM) -> None:
        """``tight_ns``: delays that agree to within this are used; a tenth of the frames' period.

        Delayed images that arrive all at once differ by whole periods and never agree. After a pause in which an
        error of ``unsure_ppm`` would add up to ``tight_ns``, the estimate starts anew.
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
        """Return whether offset and drift are known well enough to be used."""
        return bool(self._bins)

    @property
    def drift_ppm(self) -> float:
        """Drift of the host's clock against the camera's, in parts per million; positive if the host's is faster."""
        return self._drift * 1e6

    def host_ns(self, camera_ns: int) -> int:
        """Return the host time of a camera time."""
        since_ns = camera_ns - self._base_ns
        return camera_ns + self._base_delay_ns + round(self._offset_ns + self._drift * since_ns)

    def add(self, camera_ns: int, arrival_ns: int) -> bool:
        """Add an image's camera time and arrival; return whether ``host_ns`` is valid for it."""
        delay_ns = arrival_ns - camera_ns
        if self._bins and camera_ns - self._bins[-1][0] > self._longest_ns:
            self._clear()
        if not self.is_settled:
            return self._settle(camera_ns, delay_ns)
        # an image cannot arrive before it is taken; with few images the offset may still be too large
        early_ns = LATE_NS if len(self._bins) < LINE_FROM else 4 * self._tight_ns
        if not -early_ns < arrival_ns - self.host_ns(camera_ns) < LATE_NS:
            self._outliers += 1
            if self._outliers >= OUTLIERS:
                self._clear()
            return False
        self._outliers = 0
        self._add_to_bins(camera_ns, delay_ns)
        return True

    def _settle(self, camera_ns: int, delay_ns: int) -> bool:
        self._first.append((camera_ns, delay_ns))
        least = min(delay for _, delay in self._first)
        if sum(delay - least < self._tight_ns for _, delay in self._first) < FIRST:
            return False
        for time, delay in sorted(self._first):
            self._add_to_bins(time, delay)
        return False  # used from the next image on, when the other cameras' clocks may be known too

    def _add_to_bins(self, camera_ns: int, delay_ns: int) -> None:
        if self._bins and camera_ns // BIN_NS == self._bins[-1][0] // BIN_NS:
            if delay_ns >= self._bins[-1][1]:
                return
            self._bins[-1] = camera_ns, delay_ns
        else:
            self._bins.append((camera_ns, delay_ns))
        self._fit()

    def _fit(self) -> None:
        # the base is an exact integer: a float cannot hold ns since 1970
        self._base_ns, self._base_delay_ns = self._bins[-1]
        time = np.array([t - self._base_ns for t, _ in self._bins], np.float64)
        delay = np.array([d - self._base_delay_ns for _, d in self._bins], np.float64)
        residual = delay - self._drift * time
        is_prompt = (
            residual <= residual.min() + self._tight_ns
        )  # a busy host may delay all images of a second
        time, delay = time[is_prompt], delay[is_prompt]
        if len(time) < LINE_FROM:
            self._drift, self._offset_ns = 0.0, float(delay.min())
            return
        i, j = np.triu_indices(len(time), 1)
        slope = float(np.median((delay[j] - delay[i]) / (time[j] - time[i])))
        self._drift = float(np.clip(slope, -DRIFT_PPM * 1e-6, DRIFT_PPM * 1e-6))
        self._offset_ns = float(np.median(delay - self._drift * time))
