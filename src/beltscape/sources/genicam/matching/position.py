"""The belt's position from the core camera's encoder counter."""

from __future__ import annotations

from beltscape.sources.genicam.settings import CameraEncoderSettings


class BeltCounter:
    """Unwraps the counts of a counter of limited width to a continuous position.

    The first position is the count itself: a camera that stays powered continues where it was when the program
    stopped, unless its counter has wrapped meanwhile.
    """

    def __init__(self, settings: CameraEncoderSettings) -> None:
        self._mm = settings.mm_per_count
        self._range = 1 << settings.bits
        self._last: int | None = None
        self._counts = 0
        self._reopened = False

    def on_reopened(self) -> None:
        """Handle that the camera was opened again: it may have lost power, and its count with it."""
        self._reopened = True

    def position_mm(self, count: int) -> float:
        """Return the belt's position at the next image's count; the belt may also roll back a little."""
        count %= self._range
        if self._last is None:
            self._counts = count
        else:
            self._counts += self._step(count)
        self._last = count
        self._reopened = False
        return self._counts * self._mm

    def _step(self, count: int) -> int:
        assert self._last is not None
        forward = (count - self._last) % self._range
        if self._reopened and count < self._last and self._mm > 0:
            return count  # the counter restarted at 0; travel without power is unknown
        return forward - self._range if forward >= self._range // 2 else forward
