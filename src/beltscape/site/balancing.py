"""Balances of all transfer points: every closed window once, as soon as all its belts' ledgers are known."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.site.balance import BalanceResult, BeltWindow, compute_balance, shift_window, sum_window
from beltscape.site.settings import BalanceSettings, SiteSettings
from beltscape.site.store import SiteStore

_MARGIN_S = 10
"""Seconds beyond a window that are read with it, for the flow at its edges."""
_DUE_MS = 20_000
"""A ledger that is not known this long after a window is late: a belt that runs or stands is known within 10 s."""
_MOST_WINDOWS = 200
"""Windows that are balanced in one call, so that making up for a long absence does not stop the rest."""


@dataclass(frozen=True, slots=True)
class BalanceStatus:
    """Present state of a transfer point."""

    settings: BalanceSettings
    last: BalanceResult | None
    """The newest window that was closed; None: there is none yet."""
    waits_for: tuple[str, ...]
    """Belts whose ledger is not yet known up to the end of the next window, though they are away or late."""


class Balancer:
    """Balances the windows of one transfer point, one after the other."""

    def __init__(self, site: SiteSettings, settings: BalanceSettings, store: SiteStore) -> None:
        self._site, self.settings, self._store = site, settings, store
        self._window_ms = round(settings.window_min * 60_000)
        newest = store.read_balances(settings.name, 1)
        self._last = newest[0] if newest else None
        self._next_ms = None if self._last is None else self._last.end_ms

    def update(self, now_ms: int) -> BalanceStatus:
        """Balance the windows that have become complete; return the status."""
        for _ in range(_MOST_WINDOWS):
            start_ms = self._next_ms = self._next_ms or self._find_first_window()
            if start_ms is None or start_ms + self._window_ms > now_ms:
                return BalanceStatus(self.settings, self._last, ())
            late = self._list_late(start_ms)
            if late and start_ms > now_ms - self._site.keep_days * 86_400_000:
                is_due = now_ms > start_ms + self._window_ms + self._longest_delay_ms() + _DUE_MS
                return BalanceStatus(self.settings, self._last, late if is_due else ())
            self._close_window(start_ms, late)
        return BalanceStatus(self.settings, self._last, ())

    def _find_first_window(self) -> int | None:
        """Return the beginning of the first window that all belts have records of; None without."""
        starts: list[int] = []
        for belt in self.settings.belts:
            first = self._store.read_first_second(belt)
            if first is None:
                return None
            offset_ms, _ = shift_window(self.settings, belt, 0, 0)
            starts.append(first * 1000 - offset_ms)
        return -(-max(starts) // self._window_ms) * self._window_ms

    def _list_late(self, start_ms: int) -> tuple[str, ...]:
        """Return the belts whose ledgers are not known up to the end of a window."""
        end_ms = start_ms + self._window_ms
        return tuple(
            belt
            for belt in self.settings.belts
            if self._store.read_complete_ms(belt) < shift_window(self.settings, belt, start_ms, end_ms)[1]
        )

    def _longest_delay_ms(self) -> float:
        return max(self.settings.delay_s.values(), default=0.0) * 1000

    def _close_window(self, start_ms: int, late: tuple[str, ...]) -> None:
        """Keep the balance of a window; where a belt was away for longer than sums are kept, it is incomplete."""
        window = start_ms, start_ms + self._window_ms
        if late:
            result = BalanceResult(*window, "incomplete", None, None, None, "away", late[0])
        else:
            belts = [self._read_window(belt, *window) for belt in self.settings.belts]
            result = compute_balance(self.settings, window, belts)
        self._store.add_balance(self.settings.name, result)
        self._last, self._next_ms = result, window[1]

    def _read_window(self, belt: str, start_ms: int, end_ms: int) -> BeltWindow:
        start_ms, end_ms = shift_window(self.settings, belt, start_ms, end_ms)
        first, end = start_ms // 1000 - _MARGIN_S, end_ms // 1000 + _MARGIN_S
        sums, change = sum_window(self._store.read_seconds(belt, first, end), start_ms, end_ms)
        gaps = self._store.read_gaps(belt, start_ms, end_ms)
        return BeltWindow(belt, sums, change, gaps[0].reason if gaps else None)
