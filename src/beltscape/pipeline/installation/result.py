"""The result of one check of the installation."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class InstallationCheck:
    """One line of ``beltscape doctor``."""

    name: str
    found: str
    """What is there, in one line."""
    fix: str = ""
    """What to do; empty: it is good as it is."""

    @property
    def state(self) -> str:
        """Either "ok", or "warning" where there is something to do."""
        return "warning" if self.fix else "ok"
