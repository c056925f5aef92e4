"""A drift of a rig as the page sees it, whose changes are kept in memory and may be refused."""

from __future__ import annotations

from typing import Any

from beltscape.core.errors import InputError


class FakeDrift:
    """A rig whose camera cam2 has moved, until the proposal is taken."""

    volume_l: float | None = -50.0
    window_s = 7200.0
    also: tuple[str, ...] = ("empty", "density.table")
    newest_is_there = True

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.changes: list[dict[str, Any]] = []
        self.fault = self.change_fault = ""

    def read(self) -> dict[str, Any]:
        self._refuse()
        moved = self.newest_is_there and (not self.changes or self.changes[-1]["action"] == "undone")
        last = {"volume_percent": -1.25, "volume_sigma_percent": 0.25}
        return {
            "reference_ns": 5, "window_s": self.window_s,
            "estimates": [last] if moved else [], "newest": 7 if moved else None,
            "moved": "cam2" if moved else None, "has_proposal": moved, "needs_new_belt": False,
            "is_significant": moved, "change_litres": self.volume_l if moved else None,
            "change_sigma_litres": 10.0 if moved and self.volume_l else None, "changes": self.changes,
        }  # fmt: skip

    def render(self, language: str) -> str:
        return f"<html lang={language}>cam2</html>"

    def take(self, number: int, by: str, address: str) -> tuple[str, ...]:
        self._refuse()
        self._refuse_change()
        self.calls.append(("take", number, by, address))
        self.changes.append({"action": "taken"})
        return self.also

    def undo(self, by: str, address: str) -> tuple[str, ...]:
        self._refuse_change()
        self.calls.append(("undo", by, address))
        self.changes.append({"action": "undone"})
        return ()

    def _refuse(self) -> None:
        if self.fault:
            raise InputError(self.fault)

    def _refuse_change(self) -> None:
        if self.change_fault:
            raise InputError(self.change_fault)
