"""The core camera's counter → where the belt is."""

from __future__ import annotations

from beltscape.sources.genicam.settings import EncoderSettings


class BeltCounter:
    """Counts that begin again after some bits → a position that goes on.

    The first position is the count itself: a camera that kept its power goes on where it was when the program
    stopped, as long as its counter has not begun again meanwhile.
    """

    def __init__(self, settings: EncoderSettings) -> None:
        self._mm = settings.mm_per_count
        self._range = 1 << settings.bits
        self._last: int | None = None
        self._counts = 0
        self._reopened = False

    def on_reopened(self) -> None:
        """The camera was opened again: it may have lost power, and its count with it."""
        self._reopened = True

    def position_mm(self, count: int) -> float:
        """Where the belt is at the next image's count; the belt may also go back a little."""
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
            return count  # it began at 0; how far the belt went without power is not known
        return forward - self._range if forward >= self._range // 2 else forward
